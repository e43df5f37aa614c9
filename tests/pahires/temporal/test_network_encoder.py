"""Training any network, and a trained network as a motion encoder: the contract of the motion field interface."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch

from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.features.rotations import rows_of_poses
from motionkit.fields.motion_field import BatchEncoder, MotionEncoder, MotionField, Observation, Poses
from motionkit.training.config import apply_overrides
from motionkit.training.loop import CheckpointError, save_tensors
from motionkit.training.run import RunError, RunFolder
from pahires.temporal.encoder import NetworkEncoder
from pahires.temporal.training import TrainedNetwork
from tests.helpers.nerm_corpus import analytic_positions
from tests.helpers.small_network import SmallConfig, load, train

CPU = torch.device("cpu")
EXACT = SmallConfig(
    training=apply_overrides(
        replace(SmallConfig().training, mirrored=True), ["answer.form=exact", "answer.base=cubic", "loss.balanced=true"]
    )
)


@pytest.fixture(scope="module")
def exact(tmp_path_factory: pytest.TempPathFactory) -> TrainedNetwork:
    return load(train(tmp_path_factory.mktemp("temporal"), EXACT))


def capture(seconds: float = 5.0, fps: int = 30, start: float = 2.0) -> Motion:
    grid = TimeGrid(Fraction(fps), int(seconds * fps) + 1, start_seconds=start)
    return Motion(analytic_positions(grid.seconds() - start, 1), SMPL22, grid)


@pytest.fixture
def field(exact: TrainedNetwork) -> MotionField:
    encoder = NetworkEncoder(exact, window_frames=16)
    assert isinstance(encoder, MotionEncoder)
    field = encoder.encode(Observation.of(capture()), before_seconds=0.3, after_seconds=0.2)
    assert isinstance(field, MotionField) and len(field.window_starts) > 10
    return field


def test_answers_depend_neither_on_order_nor_on_company(field: MotionField) -> None:
    times = np.random.default_rng(0).uniform(field.start_seconds, field.end_seconds, 700)
    whole = field.query(times).joint_positions
    order = np.random.default_rng(1).permutation(len(times))
    np.testing.assert_allclose(field.query(times[order]).joint_positions, whole[order], atol=2e-5)
    for some in (slice(0, 1), slice(5, 12)):
        np.testing.assert_allclose(field.query(times[some]).joint_positions, whole[some], atol=2e-5)
    assert len(field.query(np.zeros(0)).joint_positions) == 0


@pytest.mark.parametrize("frames", [9, 40])
def test_many_motions_at_once_are_each_as_alone(exact: TrainedNetwork, frames: int) -> None:
    encoder = NetworkEncoder(exact, window_frames=16)
    assert isinstance(encoder, BatchEncoder)
    kept = np.sort(np.random.default_rng(2).choice(140, frames, replace=False))
    whole = [Observation.of(capture()), Observation.of(capture(start=2.0))]
    whole[1] = replace(whole[1], poses=rows_of_poses(whole[1].poses, SMPL22).poses())
    observations = [observation.rows(kept) for observation in whole]
    times = np.random.default_rng(4).uniform(1.5, 8.0, 50)
    together = encoder.query_many(observations, times)
    for observation, found in zip(observations, together, strict=True):
        expected = encoder.encode(observation, before_seconds=2.0, after_seconds=9.0).query(times)
        assert (found.local_rotations is None) == (expected.local_rotations is None)
        np.testing.assert_allclose(found.joint_positions, expected.joint_positions, atol=2e-5)
    with pytest.raises(ValueError, match="motion 1 of 2 is not observed at the times of the first"):
        encoder.query_many([observations[0], observations[1].rows(slice(0, -1))], times)


def test_beyond_what_training_saw(exact: TrainedNetwork) -> None:
    observation = Observation.of(capture())
    reach = exact.reach_seconds
    assert reach == pytest.approx(8 / 30) and exact.longest_gap_seconds == pytest.approx(10 / 30)
    clamped = NetworkEncoder(exact).encode(observation, after_seconds=2.0).query(7.0 + np.array([reach, 1.0, 2.0]))
    np.testing.assert_allclose(clamped.joint_positions[1:], clamped.joint_positions[:1].repeat(2, 0), atol=1e-5)
    with pytest.raises(ValueError, match=r"trained up to 0\.27 s beyond"):
        NetworkEncoder(exact, extrapolation="error").encode(observation, after_seconds=2.0)
    NetworkEncoder(exact, extrapolation="error").encode(observation, after_seconds=reach)
    allowed = NetworkEncoder(exact, extrapolation="allow").encode(observation, after_seconds=2.0)
    assert np.isfinite(allowed.query(np.array([9.0])).joint_positions).all()


def test_true_rotations_come_back_as_rotations(exact: TrainedNetwork) -> None:
    motion = capture()
    rows = rows_of_poses(Poses.of(motion), SMPL22)
    poses = rows.poses()
    root = motion.joint_positions[:, 0] - SMPL22.offsets[0] + np.float32(0.25)
    given = Poses(poses.joint_positions, poses.local_rotations, root)
    observation = Observation(motion.timegrid.seconds(), given, SMPL22)
    made = NetworkEncoder(exact).encode(observation).query(observation.times_seconds)
    assert made.local_rotations is not None and made.root_translation is not None and given.local_rotations is not None
    np.testing.assert_allclose(np.abs(np.sum(made.local_rotations * given.local_rotations, -1)), 1.0, atol=1e-5)
    np.testing.assert_allclose(made.root_translation, root, atol=2e-5)
    signs = np.sum(made.local_rotations[1:] * made.local_rotations[:-1], axis=-1)
    assert signs.min() > 0


def test_a_model_that_is_missing_or_another_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="is not trained"):
        load(RunFolder(tmp_path))
    save_tensors(RunFolder(tmp_path).stage("small").model_path, {}, {"format": "nerm-field"})
    with pytest.raises(CheckpointError, match="train it again"):
        load(RunFolder(tmp_path))
