"""Every kind of damage is found, and told in one line."""

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest

from motionkit.core.errors import StoreError
from motionkit.store import StoreWriter
from motionkit.store.life.rewrite import compact, remove
from motionkit.store.validate import faults
from tests.helpers.signed_again import rewrite, sign, with_broken_text, with_number, with_value

PART = "segments/part-00000.parquet"


def test_an_intact_store_has_no_faults(small_store, make_motion):
    with StoreWriter.append(small_store) as writer:
        writer.add(make_motion("later", 300, rotations=True))
    seen: list[str] = []
    assert list(faults(small_store, seen.append)) == []
    assert seen == ["sequences.parquet", "skeletons.parquet", PART, "segments/part-00001.parquet"]


def test_what_a_writer_deletes_meanwhile_is_no_fault(small_store, make_motion):
    with StoreWriter.append(small_store) as writer:
        writer.add(make_motion("later", 300))
    remove(small_store, ["later"])
    with StoreWriter.append(small_store) as writer:
        writer.add(make_motion("last", 300))

    def compact_meanwhile(name: str) -> None:
        if name == PART:
            compact(small_store)

    with pytest.raises(StoreError, match="was written to while it was checked: check it again"):
        list(faults(small_store, compact_meanwhile))
    assert list(faults(small_store)) == []


@pytest.mark.parametrize("name", ["sequences.parquet", "skeletons.parquet", PART])
@pytest.mark.parametrize("damage", ["flip", "cut", "remove"])
def test_damaged_files(small_store, name, damage):
    path = small_store / name
    content = bytearray(path.read_bytes())
    if damage == "remove":
        path.unlink()
    elif damage == "cut":
        path.write_bytes(content[:-100])
    else:
        content[50] ^= 4
        path.write_bytes(content)
    says = "it is missing" if damage == "remove" else "its sha256 is not the manifest's"
    assert list(faults(small_store)) == [f"{name}: {says}"]


@pytest.mark.parametrize(
    ("name", "edit", "expected"),
    [
        (
            PART,
            with_number("joint_positions", 4, np.nan),
            [r"joint_positions of sequence 3 is not finite .* frame 256"],
        ),
        (PART, with_number("joint_rotations", 0, np.inf), ["joint_rotations of sequence 0 is not finite"]),
        (PART, with_value("joint_positions", 1, [1.0]), ["joint_positions of sequence 1, frame 0 holds 1 numbers"]),
        (PART, with_value("joint_rotations", 0, None), ["joint_rotations of sequence 0, frame 0 holds 0 numbers"]),
        (PART, with_value("start_frame", 4, 128), ["row 4 is .*'start_frame': 128.* expected .*'start_frame': 256"]),
        (PART, with_value("sequence_index", 7, 4), ["row 7 is .*'sequence_index': 4.* expected .*'sequence_index': 5"]),
        (PART, with_value("num_frames", 0, 41), ["row 0 is .*'num_frames': 41"]),
        (
            PART,
            lambda table: table.slice(0, 7),
            [
                "'take-5': its segments do not lie inside",
                "counts 8 .*, the parts hold 7",
                "holds 7 segments, .* says 8",
            ],
        ),
        ("sequences.parquet", with_value("skeleton", 2, "feed"), ["'take-2': its skeleton is not in"]),
        ("sequences.parquet", with_value("sequence_id", 1, "take-0"), ["id 'take-0' occurs more than once"]),
        ("sequences.parquet", with_value("fps", 0, 25.0), ["'take-0': fps is not fps_numerator / fps_denominator"]),
        ("sequences.parquet", with_value("duration_seconds", 0, 9.0), ["'take-0': duration_seconds is not"]),
        ("sequences.parquet", with_value("part", 5, 3), ["part-00003.parquet is referred to", "holds 8 .* says 7"]),
        ("sequences.parquet", with_value("first_row", 5, 6), ["do not follow each other"]),
        ("sequences.parquet", with_value("sequence_index", 5, 6), ["does not ascend from 0 to below 6", "row 7 is"]),
        (
            "sequences.parquet",
            with_value("num_joints", 0, 21),
            ["'take-0': num_joints is not its skeleton's", "joint_positions of .* 0, .* expected 2520", "rotations"],
        ),
        ("skeletons.parquet", lambda table: table.drop_columns("feet"), ["its columns are not those"]),
        ("skeletons.parquet", with_broken_text("name"), ["cannot be read as Parquet .*UTF8"]),
    ],
)
def test_damage_that_a_checksum_cannot_see(small_store, name, edit, expected):
    rewrite(small_store, name, edit)
    found = list(faults(small_store))
    assert len(found) == len(expected)
    for fault, pattern in zip(found, expected, strict=True):
        assert pc.match_substring_regex(pa.array([fault]), pattern)[0].as_py(), f"{fault!r} does not say {pattern!r}"
        assert "\n" not in fault


@pytest.mark.parametrize("removed", ["take-1", "take-3", "take-5"])
def test_segments_of_removed_sequences_are_no_fault(small_store, removed):
    remove(small_store, [removed])
    assert list(faults(small_store)) == []


def test_a_segment_too_many_is_one(small_store):
    """Where a sequence was removed, a row may lie between two sequences, but not of one that is there."""
    remove(small_store, ["take-1"])
    rewrite(small_store, PART, with_value("sequence_index", 1, 4))
    assert list(faults(small_store)) == [f"{PART}: row 1 is an extra segment of sequence 4"]


@pytest.mark.parametrize(
    ("place", "value", "says"),
    [
        (("counts", "frames"), 813, "counts 813 frames, sequences.parquet says 812"),
        (("counts", "skeletons"), 2, "counts 2 skeletons, skeletons.parquet says 1"),
        (("counts", "segments"), 7, "counts 7 segments"),
        (("files", PART, "num_bytes"), 7, r"part-00000\.parquet: it has \d+ bytes, the manifest says 7"),
        (("files", PART, "num_rows"), 9, "counts 8 segments, the parts hold 9"),
        (("files", PART, "footer_sha256"), "0" * 64, "the sha256 of its footer is not the manifest's"),
        (("files", "sequences.parquet", "num_bytes"), 7, "sequences.parquet: its sha256 is not the manifest's"),
        (("files", "skeletons.parquet", "num_rows"), 7, "skeletons.parquet: it has 1 rows, the manifest says 7"),
    ],
)
def test_a_manifest_that_was_changed_and_signed_again(small_store, place, value, says):
    def edit(document):
        *folders, name = place
        for folder in folders:
            document = document[folder]
        document[name] = value

    sign(small_store, edit)
    assert any(pc.match_substring_regex(pa.array([fault]), says)[0].as_py() for fault in faults(small_store))


def test_no_store_is_an_error(tmp_path):
    with pytest.raises(StoreError, match="there is no store"):
        list(faults(tmp_path))
