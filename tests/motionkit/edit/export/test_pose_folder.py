"""HumanML3D and KIT folders out of a store: what the published pipeline gives, and back in again."""

import json
from fractions import Fraction

import numpy as np
import pytest

from motionkit.core.framerate import format_fps
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import map_joints
from motionkit.core.timegrid import TimeGrid
from motionkit.features import humanml3d
from motionkit.fields.resample import resample
from motionkit.io.humanml3d import KIT
from motionkit.store import Store, StoreWriter


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
    assert (stated["fps"], stated["published_fps"]) == (format_fps(fps), format_fps(fps))
    assert (out / "train.txt").read_text() == "take 0\n"
    assert (out / "all.txt").read_text().split("\n") == ["take 0", "take 1", "take 2", ""]
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
        assert not any("mirrored" in line for line in after.provenance.operations)
        assert 1.2 < np.ptp(after.joint_positions[:, :, 1], axis=1).max() < 2.4


def test_without_the_table_the_folder_still_says_its_framerate(store, export_as, ingest_again):
    out = export_as(store, "humanml3d", Fraction(60)).folder
    (out / "motions.csv").unlink()
    again = ingest_again(out)
    assert {motion.fps for motion in again} == {Fraction(60)}
    assert {motion.provenance.stated_fps for motion in again} == {"60.0"}
    assert [caption.text for caption in again[0].captions] == ["a person walks, then waves", "waves"]


def test_what_is_too_short_or_has_no_legs_is_left_out(tmp_path, export_as):
    with StoreWriter.create(tmp_path / "store") as writer:
        good = np.random.default_rng(0).normal(size=(60, 22, 3)).astype(np.float32)
        for name, positions in (("good", good), ("blink", good[:4]), ("point", np.zeros_like(good))):
            writer.add(Motion(positions, SMPL22, TimeGrid(Fraction(120), len(positions)), sequence_id=name))
    report = export_as(Store.open(tmp_path / "store"), "humanml3d")
    assert {outcome.sequence_id: outcome.reason for outcome in report.left_out} == {
        "blink": "too-short",
        "point": "degenerate",
    }
    assert (report.folder / "all.txt").read_text() == "good\n"
    assert report.missing == {what: ["good"] for what in ("captions", "split", "length")}
    assert "1 of 1 motions have no caption" in (report.folder / "README.md").read_text()
    np.testing.assert_equal(np.isfinite(np.load(report.folder / "Mean.npy")), True)


def test_the_published_clip_gives_the_published_vectors(golden_humanml3d, tmp_path, export_as):
    from motionkit.store.ingest import ingest

    ingest([golden_humanml3d], tmp_path / "golden", num_workers=1)
    out = export_as(Store.open(tmp_path / "golden"), "humanml3d").folder
    (ours,) = (np.load(path) for path in (out / "new_joint_vecs").glob("*.npy"))
    (theirs,) = (np.load(path) for path in (golden_humanml3d / "new_joint_vecs").glob("*.npy"))
    # The published joints are one pose shorter than the raw ones; smoothing looks 80 frames ahead.
    rows = len(ours) - 80
    assert np.abs(ours[:rows] - theirs[:rows]).max() < 1e-3
