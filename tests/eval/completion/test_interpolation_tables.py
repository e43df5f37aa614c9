"""Tables 1 and 2 of PA-HiRes: which frames are given, figures held against their definition, data sets and refusals."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from eval.completion.data_sets import data_sets_of, local_rotations, open_clips
from eval.completion.encoders import CUBIC, HOLD, LINEAR, Completer
from eval.completion.interpolation import (
    CLIP_FRAMES,
    INTEGER_SCALES,
    OTHER_SCALES,
    given_frames,
    measure_interpolation,
    measure_scale,
    scale_label,
)
from eval.completion.scores import mean_over_takes
from eval.report.results import to_markdown
from eval.sets.motions import NoRealMotionError
from eval.tables import pahires
from eval.tables.pahires import TABLE_1, TABLE_2, TABLE_EXTRAPOLATION
from eval.tables.pahires import TABLE_3 as INBETWEENING
from eval.tables.table import EvalConfig
from motionkit.core.errors import UsageError
from motionkit.core.motion import Motion, Provenance
from motionkit.core.skeleton import SMPL22
from motionkit.fields.interpolation import INTERPOLATORS
from motionkit.fields.motion_field import BatchEncoder, MotionEncoder, Poses
from motionkit.store.reader import Store
from motionkit.store.writer import StoreWriter
from tests.helpers.table_request import body_of, table_request


def test_frames_given_at_whole_and_other_scales() -> None:
    assert given_frames(Fraction("2.4")).tolist()[:7] == [0, 2, 4, 7, 9, 12, 14]
    for fraction in (*INTEGER_SCALES, *OTHER_SCALES):
        expected = [int(np.floor(i * float(fraction) + 1e-9)) for i in range(16)]
        assert given_frames(fraction).tolist() == expected and expected[-1] < CLIP_FRAMES == 76
    assert [scale_label(scale) for scale in (Fraction(2), Fraction("3.6"))] == ["×2", "×3.6"]


def take(number: int, num_frames: int, fps: int, split: str, source: str = "cmu") -> Motion:
    rng = np.random.default_rng(number)
    time = np.arange(num_frames)[:, None, None] / fps
    turns = 0.5 * rng.normal(size=(1, 22, 3)) * np.sin(2.0 * rng.normal(size=(1, 22, 3)) * time + number)
    turns[:, [10, 11, 15, 20, 21]] = 0.0  # leaves, which no position shows
    root = np.array([0.9, 0.02, 0.3]) * np.sin(time[:, 0] + number) + [0, 0.95, 0]
    about = Provenance(source=source, subject=f"{number % 2}", source_sha256=f"{number:064d}")
    return body_of(turns, root, fps, SMPL22, sequence_id=f"take-{number}", split=split, provenance=about)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("interpolation") / "store"
    with StoreWriter.create(path) as writer:
        for number, num_frames, fps in ((0, 160, 60), (1, 160, 30), (2, 70, 30), (3, 100, 50)):
            writer.add(take(number, num_frames, fps, "test"))
        for number in (4, 6):
            writer.add(take(number, 110, 30, "train"))
        writer.add(take(8, 90, 30, "test", source="studio"))
    return path


def test_clips_are_real_frames_of_whole_multiples(store: Path) -> None:
    opened = Store.open(store)
    cmu = next(each for each in data_sets_of(opened) if each.label == "CMU, 30 fps")
    clips = open_clips(opened, cmu, "test", None, 76, 76)
    # 60 fps: 80 frames at 30, one clip; 160 frames: two; 70 are too few; 50 fps is no multiple.
    assert (len(clips.takes), len(set(clips.takes)), clips.num_short, clips.num_other_fps) == (3, 2, 1, 1)
    _, positions, vectors = next(clips.read(3))
    true = take(0, 160, 60, "test")
    np.testing.assert_allclose(positions[0], true.joint_positions[:152:2], atol=2e-3)
    np.testing.assert_allclose(positions[2], take(1, 160, 30, "").joint_positions[76:152], atol=2e-3)
    turned = np.abs(np.sum(local_rotations(vectors[0]) * np.asarray(true.local_rotations)[:152:2], axis=-1))
    assert turned.min() > 1 - 1e-4
    with pytest.raises(NoRealMotionError, match="a whole multiple of 30 fps and then 500 frames"):
        open_clips(opened, next(each for each in data_sets_of(opened) if each.name == "studio"), "test", None, 500, 76)


def figures(store: Path, encoder: MotionEncoder | BatchEncoder, scale: str) -> dict[str, float]:
    opened = Store.open(store)
    cmu = next(each for each in data_sets_of(opened) if each.label == "CMU, 30 fps")
    clips, train = (open_clips(opened, cmu, split, None, 76, 76) for split in ("test", "train"))
    row = Completer("row", encoder, "")
    found = measure_interpolation(clips, measure_scale(train), (Fraction(scale),), row)
    return {name: mean_over_takes(by_take).value for (name, _), by_take in found.items()}


def test_figures_of_held_poses_are_those_of_their_definition(store: Path) -> None:
    """Everything once more from the motions, with scipy's rotations and loops over clips."""
    found = figures(store, INTERPOLATORS["hold"], "2.4")
    motions = [take(0, 160, 60, "").frames(0, 152), *(take(1, 160, 30, "").frames(k, k + 76) for k in (0, 76))]
    steps = (2, 1, 1)
    training = np.concatenate([numbers(take(number, 110, 30, "").frames(0, 76), 1) for number in (4, 6)])
    mean, std = training.mean(axis=0), training.std(axis=0)
    varies = std > 1e-4
    std[[0, 2]] = np.sqrt((std[[0, 2]] ** 2).mean())
    for group in (slice(1, 2), slice(3, 9), slice(9, 135)):
        floor = 0.25 * np.sqrt((std[group][varies[group]] ** 2).mean())
        std[group] = np.maximum(std[group], floor)
    kept = [int(np.floor(i * 2.4 + 1e-9)) for i in range(16)]
    frames = np.arange(kept[-1] + 1)
    asked = ~np.isin(frames, kept)
    last_kept = [max(k for k in kept if k <= frame) for frame in frames]
    decibels, distances, accelerations = [], [], []
    for motion, step in zip(motions, steps, strict=True):
        true, joints = numbers(motion, step)[frames], motion.joint_positions[::step][frames].astype(float)
        error = ((true[last_kept] - true)[asked] / (4 * std))[:, varies]
        decibels.append(-10 * np.log10((error**2).mean()))
        apart = joints[last_kept] - joints
        distances.append(np.linalg.norm(apart, axis=-1)[asked].mean())
        accelerations.append(np.linalg.norm(np.diff(apart, 2, axis=0) * 900, axis=-1).mean())
    assert mean.shape == (135,) and varies.sum() == 105
    assert found["psnr"] == pytest.approx(np.mean(decibels), abs=0.05)
    assert found["mpjpe_global"] == pytest.approx(np.mean(distances), rel=0.02)
    assert found["acceleration_error"] == pytest.approx(np.mean(accelerations), rel=0.02)


def numbers(motion: Motion, step: int) -> np.ndarray:
    """The 135 numbers of a clip in its own frame, from scipy's matrices."""
    assert motion.local_rotations is not None
    matrices = Rotation.from_quat(motion.local_rotations[::step].reshape(-1, 4), scalar_first=True).as_matrix()
    matrices = matrices.reshape(-1, 22, 3, 3)
    root = motion.joint_positions[::step, 0].astype(float)
    hips = SMPL22.offsets[SMPL22.index("left_hip")] - SMPL22.offsets[SMPL22.index("right_hip")]
    x, _, z = matrices[0, 0] @ (hips / np.linalg.norm(hips))
    turn = Rotation.from_rotvec([0, np.arctan2(z, x), 0]).as_matrix()
    root = (root - [root[0, 0], 0, root[0, 2]]) @ turn.T
    matrices[:, 0] = turn @ matrices[:, 0]
    return np.concatenate((root, matrices[..., :2].swapaxes(-1, -2).reshape(len(root), -1)), axis=1)


def test_smoother_is_better_and_positions_alone_can_be_scored(store: Path) -> None:
    held, line, smooth = (figures(store, encoder, "4") for encoder in (INTERPOLATORS["hold"], LINEAR, CUBIC))
    assert held["psnr"] + 10 < line["psnr"] and line["psnr"] + 10 < smooth["psnr"]
    assert held["ssim"] < line["ssim"] < smooth["ssim"] <= 1
    assert smooth["rotation_angle_error"] < 0.1 < line["rotation_angle_error"] < held["rotation_angle_error"]
    positions = figures(store, INTERPOLATORS["cubic"], "4")
    assert positions["mpjpe_global"] < 0.01 * held["mpjpe_global"]
    # The twist of a bone is in no position: these rotations are others.
    assert positions["rotation_angle_error"] > 10 * smooth["rotation_angle_error"]


def request(store: Path, tmp_path: Path, **more: object) -> EvalConfig:
    return table_request(store, tmp_path / "results", run=tmp_path / "runs" / "nano", **more)


def test_tables_1_and_2_have_all_data_sets_and_the_papers_figures(store: Path, tmp_path: Path) -> None:
    for table, columns in ((TABLE_1, ("×2", "×3", "×4", "×5")), (TABLE_2, ("×1.2", "×2.4", "×3.6", "×4.8"))):
        result = table.build(request(store, tmp_path))
        held = {block.title: block.rows[0].cells[columns[0]].value for block in result.blocks}
        cmu, studio = held["CMU, 30 fps: PSNR (dB)"], held["studio, 30 fps: PSNR (dB)"]
        assert held["all data sets, 30 fps: PSNR (dB)"] == pytest.approx((3 * cmu + studio) / 4)  # 3 clips and 1
        assert {"studio, 30 fps: MPJPE (cm)", "Printed in the PA-HiRes paper, CMU: SSIM"} < held.keys()
        assert all(block.columns == columns for block in result.blocks)
        assert [row.name for row in result.blocks[0].rows] == [
            "hold", "linear", "SLERP", "Catmull-Rom", "SQUAD", "cubic spline",
        ]  # fmt: skip
        assert any(line.startswith("HumanML3D, 20 fps: the store has none of it") for line in result.missing)
        assert any("CMU, 120 fps: " in line and "whole multiple of 120 fps" in line for line in result.missing)
        assert any("**Small scale**" in note for note in result.notes)
        assert "| hold |" in to_markdown(result)


def test_tables_over_windows(store: Path, tmp_path: Path) -> None:
    result = INBETWEENING.build(request(store, tmp_path))
    blocks = {block.title: block for block in result.blocks}
    rows = {row.name: row for row in blocks["CMU, 30 fps: L2P"].rows}
    figures = [rows["zero velocity"].cells[f"{length} frames"].value for length in (5, 15, 30, 45)]
    assert figures == sorted(figures) and figures[0] > 0
    assert rows["interpolation (SLERP)"].cells["5 frames"].value < figures[0]
    printed = {row.name: row for row in blocks["Printed for LaFAN1: NPSS"].rows}
    assert printed["PA-HiRes (PA-HiRes paper)"].cells["30 frames"].value == 0.1055
    assert printed["TS-Former (its authors)"].cells["30 frames"].value == 0.1124
    assert any("LaFAN1, 30 fps: the store has no take of LaFAN1's subject1" in line for line in result.missing)
    further = TABLE_EXTRAPOLATION.build(request(store, tmp_path))
    rows = {row.name: row for row in further.blocks[0].rows}
    assert list(rows) == ["zero velocity", "constant velocity"]
    for column in ("after: 5", "before: 5"):
        assert rows["constant velocity"].cells[column].value < rows["zero velocity"].cells[column].value


def test_what_cannot_be_asked_is_reported_in_a_line(store: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="the condition"):
        TABLE_1.build(request(store, tmp_path, where="no_such_column = 1"))
    with pytest.raises(NoRealMotionError, match=r"no chosen sequence of .* a whole multiple of 7 fps"):
        TABLE_1.build(request(store, tmp_path, fps=(Fraction(7),)))
    with pytest.raises(UsageError, match="squid"):
        TABLE_1.build(request(store, tmp_path, encoders=(("squid", tmp_path / "runs" / "nano"),)))


class Broken:
    def query_many(self, observations: object, times_seconds: object) -> list[Poses]:
        raise ValueError("windows of 5 frames are longer than training saw")


def test_an_encoder_that_fails_is_left_out_and_named(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pahires, "INTERPOLATION", (Completer("broken", Broken(), ""), HOLD))
    result = TABLE_1.build(request(store, tmp_path))
    assert {row.name for block in result.blocks for row in block.rows if row.origin != "paper"} == {"hold"}
    assert "CMU, 30 fps, broken: windows of 5 frames are longer than training saw" in result.missing
