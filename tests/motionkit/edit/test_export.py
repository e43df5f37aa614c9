"""What comes out of a store: files that are ingested again, the published folders, and a store with a card."""

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import yaml

import motionkit as mk
from motionkit.core.motion import Caption, Motion, Provenance
from motionkit.core.skeletons.mapping import map_joints
from motionkit.edit.export import ExportReport, Selection, export, export_kinds
from motionkit.features import humanml3d
from motionkit.fields.motion_field import to_motion
from motionkit.fields.resample import resample
from motionkit.io.humanml3d import KIT
from motionkit.store.ingest import ingest
from motionkit.store.validate import faults
from tests.helpers.analytic import analytic_motion

RATES = (Fraction(30), Fraction(60000, 1001), Fraction(120))


def performance(index: int, fps: Fraction, seconds: float = 4.0) -> Motion:
    """A body that walks, with rotations, captions and a history."""
    motion = to_motion(analytic_motion("walk", seconds, index), fps)
    return replace(
        motion,
        captions=(Caption("a person walks, then waves"), Caption("waves", 1.5, 2.25, "wave/VERB")),
        action="walk",
        style="old" if index else "",
        split=("train", "val", "test")[index % 3],
        sequence_id=f"lab/take {index}",
        provenance=Provenance(source="lab", licence="CC-BY-4.0", subject=f"S{index}", stated_fps=f"{float(fps):.2f}"),
    )


@pytest.fixture(scope="session")
def store(tmp_path_factory: pytest.TempPathFactory) -> mk.Store:
    """Three performances at 30, 59.94 and 120 fps."""
    path = tmp_path_factory.mktemp("corpus") / "store"
    with mk.StoreWriter.create(path) as writer:
        for index, fps in enumerate(RATES):
            writer.add(performance(index, fps))
    return mk.Store.open(path)


@pytest.fixture
def export_as(tmp_path: Path) -> Callable[..., ExportReport]:
    """`export_as(store, "bvh", fps=…)` into `tmp_path/out`."""

    def run(store: mk.Store, name: str, fps: Fraction | None = None, where: str | None = None) -> ExportReport:
        kind = export_kinds()[name]
        return export(Selection(store, store.select(where), fps or kind.fps), tmp_path / "out", kind)

    return run


@pytest.fixture
def ingest_again(tmp_path: Path) -> Callable[[Path], list[Motion]]:
    """The motions of a folder after a journey through ingest and a store; any warning is a fault."""

    def run(folder: Path) -> list[Motion]:
        report = ingest([folder], tmp_path / "again", num_workers=1)
        assert not report.problems and not report.warnings
        again = mk.Store.open(tmp_path / "again")
        return list(again.read_many(range(again.num_sequences)))

    return run


def test_no_cell_is_a_formula(tmp_path, export_as, ingest_again):
    formula = "=cmd|'/c calc'!A1"
    with mk.StoreWriter.create(tmp_path / "hostile") as writer:
        motion = Motion(
            np.zeros((4, 22, 3), np.float32), mk.SMPL22, mk.TimeGrid(Fraction(30), 4), sequence_id=f"{formula}/-x"
        )
        provenance = Provenance(source=formula, subset="@x", licence="+1", subject="\tx")
        writer.add(replace(motion, action=formula, style="-x", provenance=provenance))
    folder = export_as(mk.Store.open(tmp_path / "hostile"), "npz").folder
    [row] = csv.DictReader((folder / "motions.csv").read_text(encoding="utf-8").splitlines())
    assert [cell for cell in row.values() if cell.startswith(("=", "+", "-", "@", "\t"))] == []
    assert (folder / row["file"]).is_file() and row["action"] == f"'{formula}"
    assert len(ingest_again(folder)) == 1


@pytest.fixture
def folder(store, export_as):
    return export_as(store, "parquet").folder


def test_it_is_a_store_of_what_was_chosen(store, folder):
    names = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    parts = ["motions/part-00000.parquet", "sequences.parquet", "skeletons.parquet"]
    assert names == ["README.md", "manifest.json", *parts]
    assert list(faults(folder)) == []
    with mk.StoreWriter.append(folder) as writer:
        writer.add(replace(store.read(0), sequence_id="more"))
    exported = mk.Store.open(folder)
    assert list(exported) == [*store, "more"]
    assert exported["lab/take 1"].captions == store["lab/take 1"].captions
    assert exported["lab/take 1"].fps == Fraction(60000, 1001)


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


def test_the_card_of_several_licences(store, export_as, tmp_path):
    with mk.StoreWriter.create(tmp_path / "some") as writer:
        for number, licence in enumerate(("MIT", "my | own", "")):
            motion = store.read(0)
            provenance = replace(motion.provenance, licence=licence, source=f"source {number}")
            writer.add(replace(motion, sequence_id=f"m{number}", provenance=provenance))
    card = (export_as(mk.Store.open(tmp_path / "some"), "parquet").folder / "README.md").read_text()
    head = yaml.safe_load(card.split("---\n", 2)[1])
    assert (head["license"], head["license_name"]) == ("other", "MIT; my | own; not stated")
    assert "my \\| own" in card


@pytest.mark.parametrize(("name", "joints", "size"), [("humanml3d", 22, 263), ("kit", 21, 251)])
def test_the_folder_is_the_published_pipeline(store, export_as, name, joints, size):
    report = export_as(store, name)
    fps = Fraction(20) if name == "humanml3d" else Fraction(25, 2)
    assert (report.num_sequences, report.left_out) == (3, ())
    out = report.folder
    for index, sequence in enumerate(("take 0", "take 1", "take 2")):
        motion = resample(store.read(index), fps)
        layout = "smpl22" if joints == 22 else "kit21"
        target = humanml3d.standard_bone_lengths(layout) * np.float32(1 if joints == 22 else 1000)
        expected = humanml3d.vectors(humanml3d.process(map_joints(motion, layout), layout, target), layout)
        vectors = np.load(out / "new_joint_vecs" / f"{sequence}.npy")
        assert vectors.shape == (motion.num_frames - 1, size)
        np.testing.assert_array_equal(vectors, expected)
        np.testing.assert_array_equal(
            np.load(out / "new_joints" / f"{sequence}.npy"), humanml3d.positions(vectors, layout)
        )
    stated = json.loads((out / "motions.json").read_text())
    assert (stated["fps"], stated["published_fps"]) == (str(fps), str(fps))
    assert (out / "train.txt").read_text() == "take 0\n"
    assert (out / "train_val.txt").read_text() == "take 0\ntake 1\n"
    if name == "kit":
        assert stated["unit_metres"] == KIT.unit_metres
        assert 480 < np.median(vectors[:, 3]) < 600  # thousandths of a body; the published mean is 559.6
    mean, std = np.load(out / "Mean.npy"), np.load(out / "Std.npy")
    train = np.load(out / "new_joint_vecs" / "take 0.npy").astype(np.float64)
    np.testing.assert_allclose(mean, train.mean(axis=0), rtol=1e-4, atol=1e-5)
    # The published Std has one number a group: the mean of its columns' standard deviations.
    groups = np.split(np.arange(size), [1, 3, 4, 4 + 3 * (joints - 1), 4 + 9 * (joints - 1), size - 4])
    expected = np.concatenate([np.full(len(group), train.std(axis=0)[group].mean()) for group in groups])
    np.testing.assert_allclose(std, expected, rtol=1e-4, atol=1e-6)
    texts = (out / "texts" / "take 0.txt").read_text().splitlines()
    assert texts[1] == "waves#wave/VERB#1.5#2.25"


@pytest.mark.parametrize("name", ["humanml3d", "kit"])
@pytest.mark.parametrize("fps", [None, Fraction(30000, 1001)])
def test_ingested_again(store, export_as, ingest_again, name, fps):
    out = export_as(store, name, fps).folder
    again = ingest_again(out)
    rate = fps or (Fraction(20) if name == "humanml3d" else Fraction(25, 2))
    assert [motion.fps for motion in again] == [rate] * 3
    for before, after in zip(store.read_many(range(3)), again, strict=True):
        assert after.captions == before.captions
        assert (after.action, after.style, after.split) == (before.action, before.style, before.split)
        assert after.provenance.licence == before.provenance.licence
        assert after.provenance.stated_fps == before.provenance.stated_fps
        assert after.provenance.source_format == name
        assert 1.2 < np.ptp(after.joint_positions[:, :, 1], axis=1).max() < 2.4


def test_what_is_too_short_or_has_no_legs_is_left_out(tmp_path, export_as):
    with mk.StoreWriter.create(tmp_path / "store") as writer:
        good = np.random.default_rng(0).normal(size=(60, 22, 3)).astype(np.float32)
        for name, positions in (("good", good), ("blink", good[:4]), ("point", np.zeros_like(good))):
            writer.add(Motion(positions, mk.SMPL22, mk.TimeGrid(Fraction(120), len(positions)), sequence_id=name))
    report = export_as(mk.Store.open(tmp_path / "store"), "humanml3d")
    assert {outcome.sequence_id: outcome.reason for outcome in report.left_out} == {
        "blink": "too-short",
        "point": "degenerate",
    }
    assert (report.folder / "all.txt").read_text() == "good\n"
    np.testing.assert_equal(np.isfinite(np.load(report.folder / "Mean.npy")), True)
