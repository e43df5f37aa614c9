"""Parquet with a card: what `datasets`, pandas, polars and duckdb make of it, without the network."""

import re
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import yaml

from motionkit.core.errors import UsageError
from motionkit.core.motion import Motion, Provenance
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.edit.export import parquet as export_parquet
from motionkit.io import parquet as parquet_schema
from motionkit.io.scan import scan
from motionkit.store import Store, StoreWriter


@pytest.fixture
def folder(store, export_as):
    return export_as(store, "parquet").folder


def test_a_file_for_each_split(folder):
    names = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    files = [f"data/{split}-00000-of-00001.parquet" for split in ("test", "train", "validation")]
    assert names == ["README.md", "checksums.json", *files]


def test_a_changed_byte_costs_its_file_and_is_named(folder):
    path = folder / "data" / "train-00000-of-00001.parquet"
    whole, whole_scan = path.read_bytes(), scan([folder])
    assert whole_scan.ignored == ()
    for place in (len(whole) // 2, len(whole) - 40):  # in a page, in the footer
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        found = scan([folder])
        assert [(problem.path, problem.reason) for problem in found.problems] == [(path, "damaged")]
        assert len(found.items) == len(whole_scan.items) - 1
    path.write_bytes(whole)
    record = folder / "checksums.json"
    record.write_text(record.read_text().replace("a", "b"))
    assert {problem.reason for problem in scan([folder]).problems} == {"damaged"}


def test_pandas_has_every_motion_to_the_last_bit(store, folder):
    rows = pd.concat([pd.read_parquet(path) for path in sorted(folder.glob("data/*"))]).set_index("sequence_id")
    for motion in store.read_many(range(3)):
        row = rows.loc[motion.sequence_id]
        shape = (row["num_frames"], row["num_joints"])
        np.testing.assert_array_equal(row["joint_positions"].reshape(*shape, 3), motion.joint_positions)
        np.testing.assert_array_equal(row["local_rotations"].reshape(*shape, 4), motion.local_rotations)
        np.testing.assert_array_equal(row["root_translation"].reshape(-1, 3), motion.root_translation)
        assert Fraction(int(row["fps_numerator"]), int(row["fps_denominator"])) == motion.fps
        assert [caption["text"] for caption in row["captions"]] == [caption.text for caption in motion.captions]
        assert [caption["end_seconds"] for caption in row["captions"]] == [None, 2.25]
        assert tuple(row["joint_names"]) == motion.skeleton.joint_names
        assert tuple(row["parents"]) == motion.skeleton.parents
        assert (row["licence"], row["stated_fps"]) == (motion.provenance.licence, motion.provenance.stated_fps)


def test_datasets_reads_the_folder_by_its_card(store, folder, tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    datasets = pytest.importorskip("datasets")
    monkeypatch.setattr(datasets.config, "HF_DATASETS_OFFLINE", True)
    loaded = datasets.load_dataset(str(folder), cache_dir=str(tmp_path / "cache"))
    assert {split: len(rows) for split, rows in loaded.items()} == {"train": 1, "validation": 1, "test": 1}
    row = loaded["validation"].with_format("numpy")[0]
    motion = store.read(row["sequence_id"])
    joints = row["joint_positions"].reshape(row["num_frames"], row["num_joints"], 3)
    np.testing.assert_array_equal(joints, motion.joint_positions)
    assert row["fps"] == float(motion.fps)
    assert loaded["validation"][0]["captions"][1]["end_seconds"] == 2.25
    plain = datasets.load_dataset(
        "parquet", data_files=str(folder / "data" / "train-*.parquet"), cache_dir=str(tmp_path / "plain")
    )
    assert plain["train"].features.keys() == loaded["train"].features.keys()


def test_duckdb_and_polars_read_the_files_as_they_are(folder):
    duckdb, polars = pytest.importorskip("duckdb"), pytest.importorskip("polars")
    fast = duckdb.sql(f"SELECT sequence_id FROM '{folder}/data/*.parquet' WHERE fps >= 60 ORDER BY fps").fetchall()
    assert fast == [("lab/take 2",)]
    [(length,)] = duckdb.sql(f"SELECT len(joint_positions) FROM '{folder}/data/train-*.parquet'").fetchall()
    frame = polars.read_parquet(f"{folder}/data/train-*.parquet")
    assert frame["joint_positions"].list.len().to_list() == [length]
    assert frame["captions"].list.get(1).struct.field("start_seconds").to_list() == [1.5]


def test_the_card_says_what_is_there(folder):
    _, header, text = (folder / "README.md").read_text().split("---\n", 2)
    head = yaml.safe_load(header)
    assert head["license"] == "cc-by-4.0"
    assert [each["split"] for each in head["configs"][0]["data_files"]] == ["train", "validation", "test"]
    assert [split["num_examples"] for split in head["dataset_info"]["splits"]] == [1, 1, 1]
    features = {feature["name"]: feature for feature in head["dataset_info"]["features"]}
    assert list(features) == parquet_schema.SCHEMA.names
    assert features["joint_positions"]["list"] == "float32"
    assert "| 59.9401 (60000/1001) | 1 | 0.00 |" in text
    assert "| lab | CC-BY-4.0 | 3 |" in text
    assert "3 sequences" in text


def still(name, split="", num_frames=100, **said):
    return Motion(
        np.zeros((num_frames, 22, 3), np.float32),
        SMPL22,
        TimeGrid(Fraction(30), num_frames),
        split=split,
        sequence_id=name,
        provenance=Provenance(**said),
    )


def write(path, motions):
    with StoreWriter.create(path) as writer:
        for motion in motions:
            writer.add(motion)
    return Store.open(path)


def test_shards_and_row_groups_are_bounded(tmp_path, export_as, monkeypatch):
    monkeypatch.setattr(export_parquet, "SHARD_BYTES", 100_000)
    monkeypatch.setattr(export_parquet, "ROW_GROUP_BYTES", 50_000)
    folder = export_as(write(tmp_path / "many", [still(f"m{i}") for i in range(10)]), "parquet").folder
    files = sorted(folder.glob("data/*"))
    assert [path.name for path in files][::3] == [
        "unassigned-00000-of-00004.parquet",
        "unassigned-00003-of-00004.parquet",
    ]
    shapes = [(pq.ParquetFile(path).metadata.num_rows, pq.ParquetFile(path).num_row_groups) for path in files]
    assert shapes == [(3, 2), (3, 2), (3, 2), (1, 1)]
    rows = pd.concat([pd.read_parquet(path) for path in files])
    assert rows["sequence_id"].tolist() == [f"m{i}" for i in range(10)]
    assert rows["local_rotations"].isna().all()


def test_several_licences(tmp_path, export_as):
    said = [{"licence": "MIT", "source": "a"}, {"licence": "my | own", "source": "b"}, {}]
    motions = [still(f"m{i}", **each) for i, each in enumerate(said)]
    _, header, text = (
        (export_as(write(tmp_path / "some", motions), "parquet").folder / "README.md").read_text().split("---\n", 2)
    )
    head = yaml.safe_load(header)
    assert (head["license"], head["license_name"]) == ("other", "MIT; my | own; not stated")
    assert "| b | my \\| own | 1 |" in text
    assert "| (unnamed) | not stated | 1 |" in text


def test_names_in_the_card_are_text(tmp_path, export_as):
    name = "<img src=x>[a](http://b) `c` | d\n# e"
    motion = replace(still("m", source=name, licence=name), skeleton=replace(SMPL22, name=name))
    text = (export_as(write(tmp_path / "some", [motion]), "parquet").folder / "README.md").read_text()
    shown = [line for line in text.splitlines() if "img" in line and line.startswith("|")]
    assert len(shown) == 2
    for line in shown:
        assert re.sub(r"\\.", "", line).count("|") == 4
        assert not re.search(r"(?<!\\)[<`\[]", line)


def test_a_split_that_is_no_file_name(tmp_path, export_as):
    motions = [replace(still("a"), split="../up")]
    with pytest.raises(UsageError, match="cannot be a file's name"):
        export_as(write(tmp_path / "odd", motions), "parquet")
    assert not list(tmp_path.glob("out*"))


def test_ingested_again_as_it_was(store, folder, ingest_again):
    again = {motion.sequence_id: motion for motion in ingest_again(folder)}
    for before in store.read_many(range(3)):
        after = again[f"out/{before.sequence_id}"]
        for name in ("timegrid", "captions", "action", "style", "split", "skeleton"):
            assert getattr(after, name) == getattr(before, name), name
        for name in ("source", "subset", "licence", "subject", "stated_fps", "operations"):
            assert getattr(after.provenance, name) == getattr(before.provenance, name), name
        for name in ("joint_positions", "local_rotations", "root_translation"):
            np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
