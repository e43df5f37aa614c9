"""What goes into a store comes out of it, bit by bit; other tools can read it; statements about it are confined."""

import os
import re
import signal
import tempfile
import threading
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import motionkit as mk
from motionkit.core.skeleton import KIT21, SMPL22, Feet, Skeleton
from motionkit.store import RefusedMotion, Store, StoreWriter, schema
from motionkit.store import writer as writing
from motionkit.store.reader import query
from motionkit.store.schema import FRAME_COLUMNS, KEY_COLUMNS, MOTIONS, RESOLUTION_BITS, SEQUENCES, rounded
from tests.helpers.repository import REPOSITORY

PART = "motions/part-00000.parquet"
PAGE = REPOSITORY / "docs" / "store.md"


def write(path: Path, motions: list[mk.Motion]) -> Store:
    with StoreWriter.create(path) as writer:
        for motion in motions:
            writer.add(motion)
    return Store.open(path)


def assert_same(found: mk.Motion, expected: mk.Motion) -> None:
    assert found.sequence_id == expected.sequence_id
    assert found.timegrid == expected.timegrid
    assert found.skeleton == expected.skeleton
    assert found.captions == expected.captions
    assert found.provenance == expected.provenance
    assert (found.action, found.split) == (expected.action, expected.split)
    for name in FRAME_COLUMNS:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    counts=st.lists(st.one_of(st.integers(1, 40), st.sampled_from([499, 500, 1300])), min_size=1, max_size=12),
    cut=st.integers(0, 12),
    rates=st.data(),
)
def test_any_lengths_come_back(counts, cut, rates, make_motion, monkeypatch):
    """Whatever the lengths, however they fall on row groups, parts and appends."""
    monkeypatch.setattr(writing, "ROW_GROUP_FRAMES", 500)
    fps = rates.draw(st.fractions(min_value=1, max_value=1000, max_denominator=1001))
    motions = [
        make_motion(f"m{i}", count, fps=fps, rotations=i % 3 == 0, skeleton=KIT21 if i % 4 == 1 else SMPL22)
        for i, count in enumerate(counts)
    ]
    with tempfile.TemporaryDirectory() as folder:
        with StoreWriter.create(Path(folder) / "store", part_bytes=200_000) as writer:
            for motion in motions[:cut]:
                writer.add(motion)
        with StoreWriter.append(Path(folder) / "store", part_bytes=200_000) as writer:
            for motion in motions[cut:]:
                writer.add(motion)
        store = Store.open(Path(folder) / "store")
        for found, expected in zip(store.read_many(range(len(motions))), motions, strict=True):
            assert_same(found, expected)
        for i in reversed(range(len(motions))):
            assert_same(store.read(f"m{i}"), motions[i])
        files = [pq.ParquetFile(store.path / name) for name in store.manifest.parts]
        groups = [file.read_row_group(group)["num_frames"] for file in files for group in range(file.num_row_groups)]
        assert [count for group in groups for count in group.to_pylist()] == counts
        assert all(sum(group.to_pylist()[:-1]) < 500 for group in groups)


def test_a_skeleton_comes_back_with_all_it_says(tmp_path, make_motion):
    skeleton = Skeleton(
        name="four",
        joint_names=("hips", "left", "right", "tip"),
        parents=(-1, 0, 0, 1),
        offsets=np.array([[0, 0, 0], [0.1, -1 / 3, 0], [-0.1, -0.4, 0], [0, 0, 1e-7]], np.float32),
        left_right_pairs=((1, 2),),
        feet=Feet(1, 3, 2, 2),
        end_sites=((3, (0.1, 1 / 3, -2.0)), (2, (0.0, 0.0, 1e-30))),
    )
    almost = replace(skeleton, name="almost", offsets=skeleton.offsets + np.float32([[0, 4e-8, 0]]))
    bodies = {"a": skeleton, "b": KIT21, "c": skeleton, "d": almost, "e": skeleton.scaled(1.01)}
    store = write(tmp_path / "store", [make_motion(name, skeleton=each) for name, each in bodies.items()])
    assert set(store.skeletons) == {bodies[name].fingerprint for name in ("a", "b", "e")}
    found = store.skeletons[skeleton.fingerprint]
    assert found == store["d"].skeleton == skeleton
    assert (found.name, found.feet, found.end_sites) == (skeleton.name, skeleton.feet, skeleton.end_sites)


def test_the_table_of_sequences(small_store):
    frame = Store.open(small_store).sequences
    assert list(frame["sequence_index"]) == list(range(6))
    third = frame.iloc[2]
    assert Fraction(int(third["fps_numerator"]), int(third["fps_denominator"])) == Fraction(30000, 1001)
    assert third["duration_seconds"] == pytest.approx(42 * 1001 / 30000)
    assert (third["start_seconds"], third["stated_fps"]) == (0.25, "0.033333")
    assert third["captions"][1] == {"text": "ends", "start_seconds": 0.3, "end_seconds": 0.5, "tokens": "ends/VERB"}
    assert third["captions"][0]["end_seconds"] is None


def test_the_same_motions_make_the_same_bytes_also_read_and_copied(tmp_path, make_motion):
    motions = [make_motion(f"m{i}", count, rotations=i % 2 == 0) for i, count in enumerate((300, 5000, 40, 9000, 256))]
    first = write(tmp_path / "first", motions)
    again = write(tmp_path / "again", list(first.read_many(first.select())))
    with StoreWriter.create(tmp_path / "copied") as writer:
        for motion in first.read_encoded(first.select()):
            writer.add_encoded(motion)
    assert first.fingerprint == again.fingerprint == Store.open(tmp_path / "copied").fingerprint
    groups = pq.ParquetFile(first.path / PART).metadata
    assert [groups.row_group(i).num_rows for i in range(groups.num_row_groups)] == [1, 1, 1, 1, 1]


def test_an_append_leaves_old_parts_alone(small_store, make_motion):
    before = Store.open(small_store)
    old = {name: (small_store / name).read_bytes() for name in before.manifest.parts}
    with StoreWriter.append(small_store) as writer:
        assert writer.add(make_motion("new")) == 6
    after = Store.open(small_store)
    assert after.fingerprint != before.fingerprint
    assert (after.num_sequences, len(after.manifest.parts)) == (7, 2)
    assert {name: (small_store / name).read_bytes() for name in old} == old
    assert_same(before.read(3), after.read(3))
    with StoreWriter.append(small_store):
        pass
    assert Store.open(small_store).fingerprint == after.fingerprint


def test_motions_that_may_not_enter(tmp_path, make_motion, monkeypatch):
    bad = make_motion("bad")
    bad.joint_positions[7, 3, 1] = np.nan
    monkeypatch.setattr(schema, "MAX_VALUES", 60 * 22 * 3)
    refused = [
        (bad, "nan"),
        (make_motion(""), "no-id"),
        (make_motion("a"), "duplicate-id"),
        (replace(make_motion("c"), sequence_id="\udcff"), "not-unicode"),
        (make_motion("long", 90), "too-long"),
    ]
    with StoreWriter.create(tmp_path / "store") as writer:
        writer.add(make_motion("a"))
        for motion, reason in refused:
            with pytest.raises(RefusedMotion) as error:
                writer.add(motion)
            assert error.value.reason == reason
        writer.add(make_motion("b"))
    store = Store.open(tmp_path / "store")
    assert list(store) == ["a", "b"]
    assert_same(store.read("b"), make_motion("b"))
    with StoreWriter.append(tmp_path / "store") as writer, pytest.raises(RefusedMotion, match="'a'"):
        writer.add(make_motion("a"))


def test_parquet_is_laid_out_as_documented(small_store):
    """Channel-major, zstd, byte stream split, no dictionary, statistics on the keys alone, units as metadata."""
    part = pq.ParquetFile(small_store / PART)
    row_group = part.metadata.row_group(0)
    for i in range(row_group.num_columns):
        column = row_group.column(i)
        assert column.compression == "ZSTD"
        assert not column.has_dictionary_page
        name = column.path_in_schema.split(".")[0]
        assert column.is_stats_set == (name in KEY_COLUMNS)
        assert ("BYTE_STREAM_SPLIT" in column.encodings) == (name in FRAME_COLUMNS)
    assert part.schema_arrow.equals(MOTIONS, check_metadata=True)
    assert part.schema_arrow.field("joint_positions").metadata == {b"unit": b"metre", b"resolution": b"2^-22"}
    rows = part.read().to_pylist()
    joints = Store.open(small_store).read(0).joint_positions
    np.testing.assert_array_equal(np.float32(rows[0]["joint_positions"]).reshape(66, 40), joints.reshape(40, 66).T)
    assert rows[1]["local_rotations"] is None


GRID = 2.0**-RESOLUTION_BITS


@given(arrays(np.float32, st.integers(1, 40), elements=st.floats(width=32, allow_nan=False, allow_infinity=False)))
def test_numbers_are_rounded_to_the_nearest_multiple_and_not_again(values):
    found = rounded(values)
    assert (np.abs(found.astype(np.float64) - values) <= GRID / 2).all()
    steps = found.astype(np.float64) / GRID
    np.testing.assert_array_equal(steps, np.rint(steps))
    np.testing.assert_array_equal(rounded(found), found)


@pytest.mark.parametrize(
    ("heading", "table"), [("## sequences.parquet", SEQUENCES), ("## motions/part-NNNNN.parquet", MOTIONS)]
)
def test_the_page_on_the_store_names_every_column(heading, table):
    section = PAGE.read_text(encoding="utf-8").split(heading)[1].split("\n## ")[0]
    first_cells = re.findall(r"^\| (`[^|]*) \|", section, re.MULTILINE)
    assert re.findall(r"`(\w+)`", " ".join(first_cells)) == table.names


def test_the_pages_examples_run(small_store, monkeypatch):
    monkeypatch.chdir(small_store.parent)
    example, reading = (
        re.findall(rf"## {heading}\n\n```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)[0]
        for heading in ("In Python", "Reading it without motionkit")
    )
    names: dict[str, object] = {}
    exec(reading.replace("sequence_index = 7", "sequence_index = 3"), names)
    np.testing.assert_array_equal(names["positions"], Store.open(small_store).read(3).joint_positions)
    motion = replace(Store.open(small_store).read(3), sequence_id="cmu/asfamc/01/01_01", split="train")
    names = {"motion": motion, "sequence": np.zeros(4, np.int64), "start_frame": np.zeros(4, np.int64)}
    exec(example, names)
    assert len(names["store"]) == 7 and "cmu/asfamc/01/01_01" in names["store"]


# Minutes of work.
LONG = "SELECT count(*) FROM range(100000000) a, range(1000) b WHERE a.range * b.range % 7 = 1"


def test_a_statement_is_stopped() -> None:
    query({"sequences": pa.table({"a": [1]})}, "SELECT 1")  # whatever is imported late
    timer = threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        timer.start()
        query({"sequences": pa.table({"a": [1]})}, LONG)
    timer.join()


@pytest.mark.parametrize(
    "sql",
    [
        "EXPLAIN ANALYZE COPY (SELECT 'x' AS a) TO '.tmp/new.csv'",
        "SELECT * FROM read_text('.tmp/there.csv')",
        "SELECT * FROM '.tmp/there.csv'",
    ],
)
def test_a_statement_has_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sql: str) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / ".tmp"  # duckdb's own place for temporary files
    folder.mkdir()
    (folder / "there.csv").write_text("a\nx\n")
    with pytest.raises(mk.UsageError):
        query({}, sql)
    assert [path.name for path in folder.iterdir()] == ["there.csv"]


def test_a_statement_leaves_nothing_to_the_next() -> None:
    assert query({"sequences": pa.table({"a": [1]})}, "SELECT a FROM sequences")["a"].to_pylist() == [1]
    query({}, "EXPLAIN ANALYZE CREATE TABLE sequences AS SELECT 2 AS a")
    for name in ("sequences", "skeletons"):
        with pytest.raises(mk.UsageError, match=name):
            query({}, f"SELECT * FROM {name}")
