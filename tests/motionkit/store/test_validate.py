"""Every kind of damage is found, in one line; and a store of a stranger's making is refused, not believed."""

import os
import re
from collections.abc import Callable

import numpy as np
import pytest

from motionkit.core.errors import MotionkitError, StoreError
from motionkit.store import Store, StoreWriter
from motionkit.store.cache import open_cache
from motionkit.store.life import compact, merge, remove
from motionkit.store.validate import faults
from tests.helpers.signed_again import describe, rewrite, sign, with_broken_text, with_column, with_number, with_value

SEQUENCES, SKELETONS, PART = "sequences.parquet", "skeletons.parquet", "motions/part-00000.parquet"


def test_an_intact_store_has_no_faults(small_store, make_motion):
    with StoreWriter.append(small_store) as writer:
        writer.add(make_motion("later", 300, rotations=True))
    seen: list[str] = []
    assert list(faults(small_store, seen.append)) == []
    assert seen == [SEQUENCES, SKELETONS, PART, "motions/part-00001.parquet"]
    remove(small_store, ["take-3"])
    assert list(faults(small_store)) == []


def test_no_store_is_an_error(tmp_path):
    with pytest.raises(StoreError, match="there is no store"):
        list(faults(tmp_path))


def test_what_a_writer_deletes_meanwhile_is_no_fault(small_store, make_motion):
    with StoreWriter.append(small_store) as writer:
        writer.add(make_motion("later", 300))

    def compact_meanwhile(name: str) -> None:
        if name == PART:
            compact(small_store)

    with pytest.raises(StoreError, match="was written to while it was checked: check it again"):
        list(faults(small_store, compact_meanwhile))
    assert list(faults(small_store)) == []


@pytest.mark.parametrize("name", [SEQUENCES, SKELETONS, PART])
@pytest.mark.parametrize("damage", ["first", "middle", "footer", "cut", "remove"])
def test_damaged_files(small_store, name, damage):
    path = small_store / name
    content = bytearray(path.read_bytes())
    if damage == "remove":
        path.unlink()
    elif damage == "cut":
        path.write_bytes(content[:-100])
    else:
        content[{"first": 50, "middle": len(content) // 2, "footer": len(content) - 100}[damage]] ^= 4
        path.write_bytes(content)
    says = "it is missing" if damage == "remove" else "its sha256 is not the manifest's"
    assert list(faults(small_store)) == [f"{name}: {says}"]
    for use in (
        lambda: Store.open(small_store).read(0),
        lambda: Store.open(small_store).query("FROM motions"),
        lambda: open_cache(Store.open(small_store)),
        lambda: merge(small_store.parent / "merged", [small_store]),
    ):
        with pytest.raises(StoreError, match="validate") as caught:
            use()
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["manifest.json", SEQUENCES, SKELETONS, PART])
@pytest.mark.parametrize("kind", ["pipe", "zeros", "folder"])
def test_what_never_ends_is_not_read(small_store, kind, name):
    """A pipe would wait for ever, /dev/zero fill the memory."""
    (small_store / name).unlink()
    if kind == "pipe":
        os.mkfifo(small_store / name)
    elif kind == "zeros":
        (small_store / name).symlink_to("/dev/zero")
    else:
        (small_store / name).mkdir()
    uses: list[Callable[[], object]] = [
        lambda: Store.open(small_store).read(0),
        lambda: Store.open(small_store).query("FROM motions"),
        lambda: merge(small_store.parent / "out", [small_store]),
    ]
    if name == "manifest.json":
        uses.append(lambda: list(faults(small_store)))
    else:
        assert any(fault.startswith(f"{name}: ") for fault in faults(small_store))
    for use in uses:
        with pytest.raises((MotionkitError, OSError)) as caught:
            use()
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "edit", "says"),
    [
        (SEQUENCES, with_value("sequence_index", 2, 1), "sequence_index does not ascend from 0 to below 6"),
        (SEQUENCES, with_value("sequence_index", 5, 2**31 - 1), "sequence_index does not ascend"),
        (SEQUENCES, with_value("sequence_id", 1, "take-0"), "the id 'take-0' occurs more than once"),
        (SEQUENCES, with_value("fps_numerator", 0, 0), "'take-0': its framerate is not positive"),
        (SEQUENCES, with_value("fps_denominator", 0, -1), "'take-0': its framerate is not positive"),
        (SEQUENCES, with_value("num_frames", 0, 0), "'take-0': it has no frames"),
        (SEQUENCES, with_value("start_seconds", 0, np.nan), "'take-0': its start_seconds are not finite"),
        (SEQUENCES, with_value("part", 0, 2**31 - 1), "'take-0': the manifest does not name its part"),
        (SEQUENCES, with_value("skeleton", 0, "\x1b[2J"), "'take-0': its skeleton is not in skeletons.parquet"),
        (SEQUENCES, with_value("num_joints", 0, 21), "'take-0': num_joints is not its skeleton's"),
        (SEQUENCES, lambda table: table.drop_columns("style"), "its columns are not those of this format version"),
        (SKELETONS, with_value("parents", 0, [-1]), "22 names, 1 parents"),
        (SKELETONS, with_number("offsets", 0, np.nan), "its offsets are not finite"),
        (SKELETONS, with_number("offsets", 0, 9.0), "its joints are those of "),
        (SKELETONS, with_value("offsets", 0, [0.0] * 65), "cannot reshape"),
        (SKELETONS, with_value("left_right_pairs", 0, [{"left": 1, "right": 22}]), "name a joint that is none of its"),
        (SKELETONS, with_value("layout_map", 0, "{"), "the layout map of a skeleton cannot be read"),
        (SKELETONS, lambda table: table.slice(0, 0), "its skeleton is not in skeletons.parquet"),
        (SKELETONS, with_broken_text("name"), "it cannot be read as Parquet"),
    ],
)
def test_tables_that_make_no_sense(small_store, name, edit, says):
    rewrite(small_store, name, edit)
    assert any(says in fault for fault in faults(small_store))
    with pytest.raises(StoreError, match=re.escape(says)) as caught:
        Store.open(small_store)
    assert "\n" not in str(caught.value) and "\x1b" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"PAR1", b"PAR1" + b"\xff" * 60 + b"PAR1", b"no table at all"])
@pytest.mark.parametrize("name", [SEQUENCES, SKELETONS, PART])
def test_files_that_are_no_parquet(small_store, name, content):
    (small_store / name).write_bytes(content)
    describe(small_store, name, 6)
    found = list(faults(small_store))
    assert found and all(fault.startswith(f"{name}: ") and "\n" not in fault for fault in found)
    with pytest.raises(StoreError, match="validate") as caught:
        Store.open(small_store).read(0)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "edit",
    [
        with_value("num_frames", 0, 39),
        with_value("sequence_index", 0, 1),
        with_value("sequence_id", 0, "take-1"),
        with_value("joint_positions", 0, [1.0]),
        with_value("local_rotations", 0, None),
        lambda table: table.slice(0, 0),
        lambda table: table.drop_columns("root_translation"),
    ],
)
def test_parts_whose_rows_are_others(small_store, edit):
    rewrite(small_store, PART, edit)
    assert list(faults(small_store)) != []
    for use in (lambda: Store.open(small_store).read(0), lambda: list(Store.open(small_store).read_many(range(6)))):
        with pytest.raises(StoreError, match="validate") as caught:
            use()
        assert "\n" not in str(caught.value)


def test_frames_that_are_not_finite(small_store):
    rewrite(small_store, PART, with_number("joint_positions", 3, np.nan))
    expected = f"{PART}: joint_positions of sequence 'take-3' are not finite in frame 5"
    assert list(faults(small_store)) == [expected]


def test_a_sequence_longer_than_its_row_needs_no_memory(small_store):
    """2^31 − 1 frames of 22 joints would be 567 GB."""
    rewrite(small_store, SEQUENCES, with_value("num_frames", 0, 2**31 - 1))
    with pytest.raises(StoreError, match="its num_frames is not what the table of sequences says"):
        Store.open(small_store).read(0)


@pytest.mark.parametrize(
    ("start", "end", "says"),
    [
        (1.0, 0.5, "from 1 to 0.5 s"),
        (np.nan, None, "from nan to inf s"),
        (0.0, np.nan, "from 0 to nan s"),
        (0.3, 9.0, "from 0.3 to 9 s"),
        (2.0, 3.0, "from 2 to 3 s"),
        (0.7, None, "from 0.7 to inf s"),
    ],
)
def test_captions_that_are_not_about_their_motion(small_store, start, end, says):
    """They are found, and stop nobody: tables of captions that people wrote have such."""

    def change(column):
        rows = column.to_pylist()
        rows[4][1] |= {"start_seconds": start, "end_seconds": end}
        return rows

    rewrite(small_store, SEQUENCES, with_column("captions", change))
    expected = f"{SEQUENCES}: sequence 'take-4': a caption lasts {says}, the motion ends at 0.616667 s"
    assert list(faults(small_store)) == [expected]
    assert Store.open(small_store).read("take-4").captions[1].text == "ends"


def put(*place: object) -> Callable[[dict], None]:
    """An edit of the manifest: the last of `place` is put where the others lead."""

    def edit(document):
        *folders, name, value = place
        for folder in folders:
            document = document[folder]
        document[name] = value

    return edit


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        (put("format_version", 7), r"format version 7 and was written by 'motionkit .* ingest the sources again"),
        (put("format", "lerobot"), "not the manifest of a store"),
        (put("next", {"part": 0, "sequence_index": 6}), r"next\.part is not above motions/part-00000"),
        (put("next", {"part": 2**31 + 1, "sequence_index": 6}), r"next\.part is not above"),
        (put("next", {"part": 1, "sequence_index": 5}), r"next\.sequence_index is below its 6 sequences"),
        (put("next", {"part": 1}), "no 'sequence_index'"),
        (put("files", []), "is damaged"),
        (put("files", PART, 7), "is damaged"),
        (put("files", PART, "num_rows", "8"), "num_rows is '8'"),
        (put("files", PART, "num_rows", -1), "num_rows is -1"),
        (put("files", PART, "num_bytes", True), "num_bytes is True"),
        (put("files", PART, "sha256", "../../etc"), "sha256 of .*part-00000.* is '../../etc'"),
        (put("files", "../outside.parquet", {}), r"names '\.\./outside\.parquet', which is no file of a store"),
        (put("files", "motions/../sequences.parquet", {}), "which is no file of a store"),
        (put("files", "motions/part-000007.parquet", {}), "which is no file of a store"),
        (put("tool", "\x1b[2J"), r"tool is '\\x1b\[2J'"),
    ],
)
def test_a_manifest_with_wild_numbers_and_names(small_store, edit, says):
    sign(small_store, edit)
    for use in (Store.open, lambda path: list(faults(path)), lambda path: StoreWriter.append(path).__enter__()):
        with pytest.raises(StoreError, match=says) as caught:
            use(small_store)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["{", "[" * 100_000, "[]", '{"format": "motionkit-store", "format_version": 3}'])
def test_a_damaged_manifest(small_store, text):
    (small_store / "manifest.json").write_text(text)
    with pytest.raises(StoreError, match=r"manifest\.json is damaged"):
        Store.open(small_store)
