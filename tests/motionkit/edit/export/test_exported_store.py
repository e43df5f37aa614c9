"""A store with a card: what `datasets`, pandas, polars and duckdb make of it, without the network."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pandas as pd
import pytest
import yaml

from motionkit.store import Store, StoreWriter
from motionkit.store.validate import faults


@pytest.fixture
def folder(store, export_as):
    return export_as(store, "parquet").folder


def test_it_is_a_store_of_what_was_chosen(store, folder):
    names = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    parts = ["motions/part-00000.parquet", "sequences.parquet", "skeletons.parquet"]
    assert names == ["README.md", "manifest.json", *parts]
    assert list(faults(folder)) == []
    with StoreWriter.append(folder) as writer:
        writer.add(replace(store.read(0), sequence_id="more"))
    exported = Store.open(folder)
    assert list(exported) == [*store, "more"]
    assert exported["lab/take 1"].captions == store["lab/take 1"].captions
    assert exported["lab/take 1"].fps == Fraction(60000, 1001)


def test_resampled(store, export_as):
    exported = Store.open(export_as(store, "parquet", Fraction(20), "fps > 100").folder)
    assert [motion.fps for motion in exported.read_many(exported.select())] == [Fraction(20)]


def test_datasets_reads_the_folder_by_its_card(store, folder, tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    datasets = pytest.importorskip("datasets")
    monkeypatch.setattr(datasets.config, "HF_DATASETS_OFFLINE", True)
    motions = datasets.load_dataset(str(folder), cache_dir=str(tmp_path / "cache"))["train"]
    row = motions.with_format("numpy")[1]
    motion = store.read(row["sequence_id"])
    joints = row["joint_positions"].reshape(row["num_joints"], 3, row["num_frames"]).transpose(2, 0, 1)
    np.testing.assert_array_equal(joints, motion.joint_positions)
    sequences = datasets.load_dataset(str(folder), "sequences", cache_dir=str(tmp_path / "cache"))["train"]
    assert sequences[1]["fps"] == float(motion.fps)
    assert sequences[1]["captions"][1]["end_seconds"] == 2.25


def test_pandas_duckdb_and_polars_read_the_files_as_they_are(store, folder):
    duckdb, polars = pytest.importorskip("duckdb"), pytest.importorskip("polars")
    fast = duckdb.sql(
        f"SELECT sequence_id, len(joint_positions) FROM '{folder}/sequences.parquet' "
        f"JOIN '{folder}/motions/*.parquet' USING (sequence_id) WHERE fps BETWEEN 59 AND 61"
    ).fetchall()
    assert fast == [("lab/take 1", store.read(1).joint_positions.size)]
    assert polars.read_parquet(f"{folder}/motions/*.parquet")["joint_positions"].list.len().to_list()[1] == fast[0][1]
    row = pd.read_parquet(folder / "motions").iloc[2]
    rotations = row["local_rotations"].reshape(row["num_joints"], 4, row["num_frames"]).transpose(2, 0, 1)
    np.testing.assert_array_equal(rotations, store.read(2).local_rotations)


def test_the_card_of_several_licences(store, export_as, tmp_path):
    with StoreWriter.create(tmp_path / "some") as writer:
        for number, licence in enumerate(("MIT", "my | own", "")):
            motion = store.read(0)
            provenance = replace(motion.provenance, licence=licence, source=f"source {number}")
            writer.add(replace(motion, sequence_id=f"m{number}", provenance=provenance))
    card = (export_as(Store.open(tmp_path / "some"), "parquet").folder / "README.md").read_text()
    head = yaml.safe_load(card.split("---\n", 2)[1])
    assert (head["license"], head["license_name"]) == ("other", "MIT; my | own; not stated")
    assert [each["config_name"] for each in head["configs"]] == ["motions", "sequences", "skeletons"]
    assert "3 sequences" in card and "my \\| own" in card
