"""What goes into a store comes out of it, bit by bit; and other tools can read it."""

import json
import tempfile
from fractions import Fraction
from pathlib import Path

import duckdb
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from motionkit.core.errors import StoreError
from motionkit.core.motion import Motion
from motionkit.core.skeleton import KIT21, SMPL22, Feet, Skeleton
from motionkit.store import RefusedMotion, Store, StoreWriter, codec, parts
from motionkit.store.schema import FLOAT_COLUMNS, KEY_COLUMNS


def assert_same(found: Motion, expected: Motion) -> None:
    assert found.sequence_id == expected.sequence_id
    assert found.timegrid == expected.timegrid
    assert found.skeleton == expected.skeleton
    assert found.captions == expected.captions
    assert found.provenance == expected.provenance
    assert (found.action, found.split) == (expected.action, expected.split)
    np.testing.assert_array_equal(found.joint_positions, expected.joint_positions)
    for name in ("local_rotations", "root_translation"):
        ours, theirs = getattr(found, name), getattr(expected, name)
        assert (ours is None) == (theirs is None)
        if ours is not None:
            np.testing.assert_array_equal(ours, theirs)


frame_counts = st.lists(
    st.one_of(st.integers(1, 40), st.sampled_from([255, 256, 257, 511, 512, 513, 1300])), min_size=1, max_size=12
)


@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(counts=frame_counts, cut=st.integers(0, 12), rates=st.data())
def test_any_lengths_come_back(counts, cut, rates, make_motion, monkeypatch):
    """Whatever the lengths, however they fall on segments, pages, row groups, parts and appends."""
    monkeypatch.setattr(codec, "RUN_FRAMES", 2 * 256)
    monkeypatch.setattr(parts, "ROW_GROUP_SEGMENTS", 3)
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
        assert store.num_sequences == len(motions)
        for found, expected in zip(store.read_many(range(len(motions))), motions, strict=True):
            assert_same(found, expected)
        for i in reversed(range(len(motions))):
            assert_same(store.read(f"m{i}"), motions[i])


def test_positions_can_be_read_alone(small_store):
    store = Store.open(small_store)
    whole, positions_only = store.read(0), store.read(0, rotations=False)
    assert whole.local_rotations is not None
    assert positions_only.local_rotations is None
    assert positions_only.root_translation is None
    np.testing.assert_array_equal(whole.joint_positions, positions_only.joint_positions)


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
    with StoreWriter.create(tmp_path / "store") as writer:
        writer.add(make_motion("a", skeleton=skeleton))
        writer.add(make_motion("b", skeleton=KIT21))
        writer.add(make_motion("c", skeleton=skeleton))
    skeletons = Store.open(tmp_path / "store").skeletons
    assert set(skeletons) == {skeleton.fingerprint, KIT21.fingerprint}
    found = skeletons[skeleton.fingerprint]
    assert found == skeleton
    assert (found.name, found.feet, found.end_sites) == (skeleton.name, skeleton.feet, skeleton.end_sites)


def test_the_table_of_sequences(small_store):
    frame = Store.open(small_store).sequences
    assert list(frame["sequence_index"]) == list(range(6))
    third = frame.iloc[2]
    assert Fraction(int(third["fps_numerator"]), int(third["fps_denominator"])) == Fraction(30000, 1001)
    assert third["fps"] == pytest.approx(29.97002997)
    assert third["duration_seconds"] == pytest.approx(42 * 1001 / 30000)
    assert third["start_seconds"] == 0.25
    assert third["seconds_between_frames"] == pytest.approx(1001 / 30000)
    assert third["stated_fps"] == "0.033333"
    assert list(third["operations"]) == ["read", "units: centimetres"]
    assert third["captions"][1] == {
        "text": "ends",
        "start_seconds": 0.3,
        "end_seconds": 0.5,
        "tokens": "ends/VERB",
    }
    assert third["captions"][0]["end_seconds"] is None


def test_quality_is_measured_in_metres_and_seconds(tmp_path, make_motion):
    """A joint that moves 0.5 m in one frame at 120 fps moves at 60 m/s."""
    still = np.full((10, 22, 3), 0.75, np.float32)
    still[:, 4, 1] = -0.5
    glitch = still.copy()
    glitch[6:, 21, 0] += 0.5
    with StoreWriter.create(tmp_path / "store") as writer:
        for sequence_id, positions in (("still", still), ("glitch", glitch)):
            base = make_motion(sequence_id, 10, fps=Fraction(120))
            writer.add(Motion(positions, SMPL22, base.timegrid, sequence_id=sequence_id))
        writer.add(make_motion("one", 1))
    frame = Store.open(tmp_path / "store").sequences
    assert list(frame["max_joint_speed_metres_per_second"][:2]) == [0.0, pytest.approx(60.0)]
    assert list(frame["floor_height_metres"][:2]) == [-0.5, -0.5]
    assert list(frame["num_teleports"][:2]) == [0, 1]
    assert frame["first_teleport_seconds"][1] == pytest.approx(6 / 120)
    assert list(frame["quality_flags"][0]) == ["floor_height"]
    assert {"joint_speed", "teleport", "floor_height"} <= set(frame["quality_flags"][1])
    assert "single_frame" in frame["quality_flags"][2]


def test_the_same_motions_make_the_same_bytes(tmp_path, make_motion):
    for name in ("one", "two"):
        with StoreWriter.create(tmp_path / name) as writer:
            for i in range(4):
                writer.add(make_motion(f"m{i}", 300, rotations=True))
    assert Store.open(tmp_path / "one").fingerprint == Store.open(tmp_path / "two").fingerprint


def test_an_append_leaves_old_parts_alone(small_store, make_motion):
    before = Store.open(small_store)
    old = {name: (small_store / name).read_bytes() for name in before.manifest.parts}
    with StoreWriter.append(small_store) as writer:
        assert writer.add(make_motion("new")) == 6
    after = Store.open(small_store)
    assert after.fingerprint != before.fingerprint
    assert after.num_sequences == 7
    assert len(after.manifest.parts) == 2
    assert {name: (small_store / name).read_bytes() for name in old} == old
    assert_same(before.read(3), after.read(3))


def test_an_append_of_nothing_changes_nothing(small_store):
    before = Store.open(small_store).fingerprint
    with StoreWriter.append(small_store):
        pass
    assert Store.open(small_store).fingerprint == before


def test_an_overwrite_replaces_everything(small_store, make_motion):
    with StoreWriter.create(small_store, overwrite=True) as writer:
        writer.add(make_motion("only"))
    store = Store.open(small_store)
    assert list(store.sequences["sequence_id"]) == ["only"]
    assert len(list((small_store / "segments").iterdir())) == 1
    assert_same(store.read("only"), make_motion("only"))


def test_motions_that_may_not_enter(tmp_path, make_motion):
    bad = make_motion("bad")
    bad.joint_positions[7, 3, 1] = np.nan
    nameless = make_motion("")
    with StoreWriter.create(tmp_path / "store") as writer:
        writer.add(make_motion("a"))
        for motion, reason in ((bad, "nan"), (nameless, "no-id"), (make_motion("a"), "duplicate-id")):
            with pytest.raises(RefusedMotion) as refused:
                writer.add(motion)
            assert refused.value.reason == reason
        writer.add(make_motion("b"))
    store = Store.open(tmp_path / "store")
    assert list(store.sequences["sequence_id"]) == ["a", "b"]
    assert_same(store.read("b"), make_motion("b"))
    with StoreWriter.append(tmp_path / "store") as writer, pytest.raises(RefusedMotion, match="'a'"):
        writer.add(make_motion("a"))


def test_a_sequence_that_is_not_there(small_store):
    store = Store.open(small_store)
    with pytest.raises(StoreError, match="no sequence 'nobody'"):
        store.read("nobody")
    with pytest.raises(StoreError, match="no sequence 6: its indices are from 0 to 5"):
        store.read(6)


def test_parquet_is_laid_out_as_documented(small_store):
    """Channel-major, zstd, byte stream split, no dictionary, statistics on the keys alone."""
    store = Store.open(small_store)
    part = pq.ParquetFile(small_store / store.manifest.parts[0])
    row_group = part.metadata.row_group(0)
    for i in range(row_group.num_columns):
        column = row_group.column(i)
        assert column.compression == "ZSTD"
        assert not column.has_dictionary_page
        name = column.path_in_schema.split(".")[0]
        assert column.is_stats_set == (name in KEY_COLUMNS)
        assert ("BYTE_STREAM_SPLIT" in column.encodings) == (name in FLOAT_COLUMNS)
    rows = part.read().to_pylist()
    assert [row["num_frames"] for row in rows if row["sequence_index"] == 3] == [256, 256, 88]
    joints = store.read(0).joint_positions
    np.testing.assert_array_equal(np.float32(rows[0]["joint_positions"]).reshape(66, 40), joints.reshape(40, 66).T)
    assert rows[1]["joint_rotations"] is None


def test_other_tools_read_the_store_without_us(small_store):
    frame = pd.read_parquet(small_store / "sequences.parquet")
    assert frame["num_frames"].sum() == 600 + 40 + 41 + 42 + 44 + 45
    hours = duckdb.sql(
        f"SELECT split, count(*) FROM '{small_store}/sequences.parquet' GROUP BY 1 ORDER BY 1"
    ).fetchall()
    assert hours == [("test", 1), ("train", 5)]
    height = duckdb.sql(
        f"SELECT max(list_max(joint_positions)) FROM '{small_store}/segments/*.parquet' WHERE sequence_index = 3"
    ).fetchall()
    assert height == [(Store.open(small_store).read(3).joint_positions.max(),)]
    polars = pytest.importorskip("polars", reason="polars is not installed")
    assert polars.read_parquet(small_store / "segments" / "*.parquet").height == 8


def test_the_manifest_names_every_file(small_store):
    document = json.loads((small_store / "manifest.json").read_text())
    on_disk = {
        str(path.relative_to(small_store)) for path in small_store.rglob("*.parquet") if not path.name.startswith(".")
    }
    assert set(document["files"]) == on_disk
    assert document["counts"] == {"sequences": 6, "segments": 8, "frames": 812, "skeletons": 1}
