"""Stores whose tables make no sense, though every checksum agrees: `validate` and whoever opens them say the same."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motionkit.core.errors import MotionkitError, StoreError
from motionkit.store import Store, StoreWriter
from motionkit.store.cache import open_cache
from motionkit.store.life.rewrite import compact, merge, remove
from motionkit.store.validate import faults
from tests.helpers.signed_again import describe, rewrite, sign, with_column, with_number, with_value

SEQUENCES, SKELETONS, PART = "sequences.parquet", "skeletons.parquet", "segments/part-00000.parquet"
USES: dict[str, Callable[[Path], object]] = {
    "open": Store.open,
    "append": lambda store: StoreWriter.append(store).__enter__(),
    "remove": lambda store: remove(store, ["take-1"]),
    "merge": lambda store: merge(store.parent / "merged", [store]),
}


def in_list(column: str, row: int, place: int, value: object) -> Any:
    """An edit of one element of a row's list."""

    def change(values: Any) -> list[object]:
        rows = values.to_pylist()
        rows[row][place] = value
        return rows

    return with_column(column, change)


@pytest.mark.parametrize(
    ("name", "edit", "says"),
    [
        (SEQUENCES, with_value("sequence_index", 2, 1), "sequence_index does not ascend from 0 to below 6"),
        (SEQUENCES, with_value("sequence_index", 0, -1), "sequence_index does not ascend"),
        (SEQUENCES, with_value("sequence_index", 5, 2**31 - 1), "sequence_index does not ascend"),
        (SEQUENCES, with_value("sequence_id", 1, "take-0"), "the id 'take-0' occurs more than once"),
        (SEQUENCES, with_value("fps_numerator", 0, -30), "'take-0': fps is not positive"),
        (SEQUENCES, with_value("fps_numerator", 0, 0), "'take-0': fps is not positive"),
        (SEQUENCES, with_value("fps_denominator", 0, 0), "'take-0': fps is not positive"),
        (SEQUENCES, with_value("fps", 0, -30.0), "'take-0': fps is not fps_numerator / fps_denominator"),
        (SEQUENCES, with_value("fps", 0, np.nan), "'take-0': fps is not fps_numerator / fps_denominator"),
        (SEQUENCES, with_value("num_frames", 0, -1), "'take-0': it has no frames"),
        (SEQUENCES, with_value("num_frames", 0, 0), "'take-0': it has no frames"),
        (SEQUENCES, with_value("num_frames", 0, 2**31 - 1), "'take-0': duration_seconds is not num_frames / fps"),
        (SEQUENCES, with_value("duration_seconds", 0, np.inf), "'take-0': duration_seconds is not num_frames / fps"),
        (SEQUENCES, with_value("seconds_between_frames", 0, 1.0), "'take-0': seconds_between_frames is not 1 / fps"),
        (SEQUENCES, with_value("start_seconds", 0, np.nan), "'take-0': start_seconds is not finite"),
        (SEQUENCES, with_value("num_segments", 0, -5), "'take-0': num_segments does not fit num_frames"),
        (SEQUENCES, with_value("num_segments", 0, 2**31 - 1), "'take-0': num_segments does not fit num_frames"),
        (SEQUENCES, with_value("first_row", 0, -1), "'take-0': its segments do not lie inside of its part"),
        (SEQUENCES, with_value("first_row", 0, 2**31 - 1), "'take-0': its segments do not lie inside of its part"),
        (SEQUENCES, with_value("part", 0, 2**31 - 1), "part-2147483647.parquet is referred to"),
        (SEQUENCES, with_value("part", 0, -7), "is referred to, but the manifest does not name it"),
        (SEQUENCES, with_value("skeleton", 0, "\x1b[2J"), "'take-0': its skeleton is not in skeletons.parquet"),
        (SEQUENCES, with_value("num_joints", 0, 21), "'take-0': num_joints is not its skeleton's"),
        (SEQUENCES, with_value("num_joints", 0, -1), "'take-0': num_joints is not its skeleton's"),
        (SEQUENCES, lambda table: table.drop_columns("style"), "its columns are not those of this format version"),
        (SKELETONS, in_list("joint_names", 0, 1, "pelvis"), "repeats a joint name"),
        (SKELETONS, in_list("parents", 0, 1, 5), "parents must precede children"),
        (SKELETONS, in_list("parents", 0, 0, 0), "joint 0 must be the only root"),
        (SKELETONS, in_list("parents", 0, 4, -1), "joint 0 must be the only root"),
        (SKELETONS, with_number("offsets", 0, np.nan), "its offsets are not finite"),
        (SKELETONS, with_number("offsets", 0, 9.0), "its joints are those of "),
        (SKELETONS, with_value("offsets", 0, [0.0] * 65), "it has 22 joints, but 65 numbers of offsets"),
        (SKELETONS, with_value("offsets", 0, []), "it has 22 joints, but 0 numbers of offsets"),
        (SKELETONS, with_value("joint_names", 0, []), "it has 0 joints"),
        (SKELETONS, with_value("joint_names", 0, ["a"]), "it has 1 joints, but 66 numbers of offsets"),
        (SKELETONS, with_value("parents", 0, [-1]), "22 names, 1 parents"),
        (SKELETONS, with_value("left_right_pairs", 0, [{"left": 1, "right": 22}]), "name joint 22 of 22"),
        (SKELETONS, with_value("end_sites", 0, [{"joint": -1, "x": 0.0, "y": 0.0, "z": 0.0}]), "name joint -1 of 22"),
        (SKELETONS, with_value("layout_map", 0, "{"), "the layout map of a skeleton cannot be read"),
        (SKELETONS, with_value("skeleton", 0, "0" * 16), "its joints are those of "),
        (SKELETONS, lambda table: table.slice(0, 0), "its skeleton is not in skeletons.parquet"),
        (SKELETONS, lambda table: table.take([0, 0]), "occurs more than once"),
    ],
)
def test_tables_that_make_no_sense(small_store, name, edit, says):
    rewrite(small_store, name, edit)
    found = list(faults(small_store))
    assert any(says in fault for fault in found), found
    assert all("\n" not in fault and "\x1b" not in fault for fault in found)
    for use in USES.values():
        with pytest.raises(StoreError, match=re.escape(says)) as caught:
            use(small_store)
        assert "\n" not in str(caught.value) and "\x1b" not in str(caught.value)
    assert not (small_store.parent / "merged" / "manifest.json").exists()


@pytest.mark.parametrize("name", [SEQUENCES, SKELETONS])
@pytest.mark.parametrize("content", [b"", b"PAR1", b"PAR1" + b"\xff" * 60 + b"PAR1", b"no table at all"])
def test_tables_that_are_no_parquet(small_store, name, content):
    (small_store / name).write_bytes(content)
    describe(small_store, name, 6)
    assert any(fault.startswith(f"{name}: it cannot be read as Parquet") for fault in faults(small_store))
    for use in USES.values():
        with pytest.raises(StoreError, match="it cannot be read as Parquet") as caught:
            use(small_store)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"PAR1", b"PAR1" + b"\xff" * 60 + b"PAR1", b"no part at all"])
def test_parts_that_are_no_parquet(small_store, content):
    (small_store / PART).write_bytes(content)
    describe(small_store, PART, 8)
    (fault,) = faults(small_store)
    assert fault.startswith(f"{PART}: it cannot be read") and "\n" not in fault
    for use in (lambda: Store.open(small_store).read(0), lambda: open_cache(Store.open(small_store))):
        with pytest.raises(StoreError, match="validate") as caught:
            use()
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "edit",
    [
        with_value("start_frame", 3, -256),
        with_value("start_frame", 4, 0),
        with_value("num_frames", 0, 39),
        with_value("num_frames", 0, -40),
        with_value("sequence_index", 0, 1),
        with_value("joint_positions", 0, [1.0]),
        with_value("joint_positions", 0, []),
        lambda table: table.slice(1),
        lambda table: table.slice(0, 0),
        lambda table: table.drop_columns("root_translation"),
        lambda table: table.drop_columns("start_frame"),
    ],
)
def test_parts_whose_rows_are_others(small_store, edit):
    rewrite(small_store, PART, edit)
    assert list(faults(small_store)) != []
    for use in (
        lambda: list(Store.open(small_store).read_many(range(6))),
        lambda: list(Store.open(small_store).read_encoded(np.arange(6))),
        lambda: open_cache(Store.open(small_store)),
    ):
        with pytest.raises(MotionkitError, match="validate") as caught:
            use()
        assert "\n" not in str(caught.value)


def test_rotations_that_are_missing(small_store):
    rewrite(small_store, PART, with_value("joint_rotations", 0, None))
    store = Store.open(small_store)
    for use in (lambda: store.read(0), lambda: list(store.read_encoded(np.arange(6)))):
        with pytest.raises(StoreError, match=r"joint_rotations .*validate"):
            use()
    assert len(store.read(0, rotations=False).joint_positions) == 40


def test_a_sequence_longer_than_its_part_asks_for_no_memory(small_store):
    """2^31 − 1 frames of 22 joints would be 567 GB; the manifest is changed with the table."""

    def edit(table: Any) -> Any:
        frames = 2**31 - 1
        for name, value in (
            ("num_frames", frames),
            ("num_segments", -(-frames // 256)),
            ("first_row", 0),
            ("duration_seconds", frames / 30),
        ):
            table = with_value(name, 0, value)(table)
        return table

    rewrite(small_store, SEQUENCES, edit)

    def agree(document: dict[str, Any]) -> None:
        document["counts"]["frames"] += 2**31 - 1 - 40
        document["counts"]["segments"] += 2**23 - 1
        document["files"][PART]["num_rows"] = 2**23 + 7
        del document["files"][PART]["footer_sha256"]

    sign(small_store, agree)
    with pytest.raises(StoreError, match="the part ends before the sequence does"):
        Store.open(small_store).read(0)


@pytest.mark.parametrize(
    ("start", "end", "says"),
    [
        (1.0, 0.5, "from 1 to 0.5 s"),
        (np.nan, None, "from nan to inf s"),
        (0.0, np.nan, "from 0 to nan s"),
        (0.3, 9.0, "from 0.3 to 9 s, the motion ends at 0.616667 s"),
        (2.0, 3.0, "from 2 to 3 s, the motion ends at 0.616667 s"),
        (0.7, None, "from 0.7 to inf s, the motion ends at 0.616667 s"),
    ],
)
def test_captions_that_are_not_about_their_motion(small_store, start, end, says):
    """They are found, and stop nobody: tables of captions that people wrote have such."""

    def change(column: Any) -> list[object]:
        rows = column.to_pylist()
        rows[4][1] |= {"start_seconds": start, "end_seconds": end}
        return rows

    rewrite(small_store, SEQUENCES, with_column("captions", change))
    assert list(faults(small_store)) == [f"{SEQUENCES}: sequence 'take-4': a caption lasts {says}"]
    assert Store.open(small_store).read("take-4").captions[1].text == "ends"
    compact(small_store)
