"""Every kind of damage is found, in one line; and a store of a stranger's making is refused, not believed."""

import re
from collections.abc import Callable

import numpy as np
import pytest

from motionkit.core.errors import StoreError
from motionkit.store import Store, StoreWriter
from motionkit.store.cache import open_cache
from motionkit.store.life import compact, merge, remove
from motionkit.store.validate import faults
from tests.helpers.signed_again import rewrite, sign, with_broken_text, with_column, with_number, with_value

SEQUENCES, SKELETONS, PART = "sequences.parquet", "skeletons.parquet", "motions/part-00000.parquet"


def test_an_intact_store_has_no_faults(small_store, make_motion):
    with StoreWriter.append(small_store) as writer:
        writer.add(make_motion("later", 300, rotations=True))
    seen: list[str] = []
    assert list(faults(small_store, seen.append)) == []
    assert seen == [SEQUENCES, SKELETONS, PART, "motions/part-00001.parquet"]
    remove(small_store, ["take-3"])
    assert list(faults(small_store)) == []


def test_what_a_writer_deletes_meanwhile_is_no_fault(small_store, make_motion):
    with StoreWriter.append(small_store) as writer:
        writer.add(make_motion("later", 300))

    def compact_meanwhile(name: str) -> None:
        if name == PART:
            compact(small_store)

    with pytest.raises(StoreError, match=str(small_store)):
        list(faults(small_store, compact_meanwhile))
    assert list(faults(small_store)) == []


@pytest.mark.parametrize("name", [SEQUENCES, SKELETONS, PART])
@pytest.mark.parametrize("damage", ["flip", "cut", "remove"])
def test_damaged_files(small_store, name, damage):
    path = small_store / name
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4 * (damage == "flip")
    path.write_bytes(content[:-100] if damage == "cut" else content)
    if damage == "remove":
        path.unlink()
    (fault,) = faults(small_store)
    assert fault.startswith(f"{name}: ")
    for use in (
        lambda: Store.open(small_store).read(0),
        lambda: Store.open(small_store).query("FROM motions"),
        lambda: open_cache(Store.open(small_store)),
        lambda: merge(small_store.parent / "merged", [small_store]),
    ):
        with pytest.raises(StoreError, match="--store"):
            use()


@pytest.mark.parametrize(
    ("name", "edit", "says"),
    [
        (SEQUENCES, with_value("sequence_index", 2, 1), "sequence_index"),
        (SEQUENCES, with_value("sequence_index", 5, 2**31 - 1), "sequence_index"),
        (SEQUENCES, with_value("sequence_id", 1, "take-0"), "'take-0'"),
        (SEQUENCES, with_value("fps_numerator", 0, 0), "'take-0': its framerate"),
        (SEQUENCES, with_value("num_frames", 0, 0), "'take-0': it has no frames"),
        (SEQUENCES, with_value("start_seconds", 0, np.nan), "'take-0': its start_seconds"),
        (SEQUENCES, with_value("part", 0, 2**31 - 1), "'take-0': the manifest does not name its part"),
        (SEQUENCES, with_value("skeleton", 0, "\x1b[2J"), "'take-0': its skeleton"),
        (SEQUENCES, with_value("num_joints", 0, 21), "'take-0': num_joints"),
        (SEQUENCES, lambda table: table.drop_columns("style"), "columns"),
        (SKELETONS, with_value("parents", 0, [-1]), "parents"),
        (SKELETONS, with_number("offsets", 0, np.nan), "offsets"),
        (SKELETONS, with_number("offsets", 0, 9.0), "joints"),
        (SKELETONS, with_value("layout_map", 0, "{"), "layout map"),
        (SKELETONS, lambda table: table.slice(0, 0), "skeletons.parquet"),
        (SKELETONS, with_broken_text("name"), "Parquet"),
    ],
)
def test_tables_that_make_no_sense(small_store, name, edit, says):
    rewrite(small_store, name, edit)
    assert any(fault.startswith(f"{name}: ") or says in fault for fault in faults(small_store))
    with pytest.raises(StoreError, match=re.escape(says)) as caught:
        Store.open(small_store)
    assert "\n" not in str(caught.value) and "\x1b" not in str(caught.value)


@pytest.mark.parametrize(
    "edit",
    [
        with_value("num_frames", 0, 39),
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
        with pytest.raises(StoreError, match="store"):
            use()


def test_frames_that_are_not_finite(small_store):
    rewrite(small_store, PART, with_number("joint_positions", 3, np.nan))
    (fault,) = faults(small_store)
    assert fault.startswith(f"{PART}: ") and "'take-3'" in fault and "frame 5" in fault


@pytest.mark.parametrize(("start", "end"), [(1.0, 0.5), (np.nan, None), (0.3, 9.0), (0.7, None)])
def test_captions_that_are_not_about_their_motion(small_store, start, end):
    """They are found, and stop nobody: tables of captions that people wrote have such."""

    def change(column):
        rows = column.to_pylist()
        rows[4][1] |= {"start_seconds": start, "end_seconds": end}
        return rows

    rewrite(small_store, SEQUENCES, with_column("captions", change))
    (fault,) = faults(small_store)
    assert fault.startswith(f"{SEQUENCES}: sequence 'take-4': a caption")
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
        (put("format_version", 7), "format version 7"),
        (put("format", "lerobot"), "manifest"),
        (put("next", {"part": 0, "sequence_index": 6}), r"next\.part"),
        (put("next", {"part": 1, "sequence_index": 5}), r"next\.sequence_index"),
        (put("next", {"part": 1}), "'sequence_index'"),
        (put("files", []), "manifest"),
        (put("files", PART, "num_rows", -1), "num_rows"),
        (put("files", PART, "sha256", "../../etc"), "sha256 of .*part-00000"),
        (put("files", "../outside.parquet", {}), r"'\.\./outside\.parquet'"),
        (put("files", "motions/part-000007.parquet", {}), "part-000007"),
        (put("tool", "\x1b[2J"), r"tool is '\\x1b\[2J'"),
    ],
)
def test_a_manifest_with_wild_numbers_and_names(small_store, edit, says):
    sign(small_store, edit)
    for use in (Store.open, lambda path: list(faults(path)), lambda path: StoreWriter.append(path).__enter__()):
        with pytest.raises(StoreError, match=says) as caught:
            use(small_store)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["{", "[" * 100_000, "[]"])
def test_a_damaged_manifest(small_store, text):
    (small_store / "manifest.json").write_text(text)
    with pytest.raises(StoreError, match=r"manifest\.json"):
        Store.open(small_store)
