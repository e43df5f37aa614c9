"""NeRM as an encoder of whole motions: windows, each in its own frame, assembled without a seam."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch

from motionkit.core.motion import Motion
from motionkit.core.skeleton import KIT21, SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.data.corpus import FrameValues
from motionkit.data.poses import WindowPoses
from motionkit.data.windows import cut_windows
from motionkit.fields.completion import complete
from motionkit.fields.motion_field import MotionEncoder, Observation, Poses, to_motion
from motionkit.training.loop import step_generator
from motionkit.training.run import RunError
from nerm.field.motion_encoder import NermEncoder, load
from nerm.field.trained import TrainedField
from nerm.field.training import FieldTraining
from tests.helpers.nerm_corpus import analytic_positions, analytic_source
from tests.helpers.observed_errors import observed_errors
from tests.helpers.velocities import joint_velocities
from tests.nerm.field.test_field_training import SMALL

SECONDS = 11.0


@pytest.fixture(scope="module")
def trained() -> TrainedField:
    """Trained on overlapping windows of one long motion, so that windows anywhere in it are known ground."""
    source = analytic_source(rates=(60,), seconds=SECONDS)
    windows = cut_windows(source, max_duration_seconds=SMALL.windows.max_duration_seconds, stride_seconds=0.5)
    poses = WindowPoses(windows, FrameValues.of_positions(source))
    training = FieldTraining(poses, SMALL, codebook=None, seed=3, device=torch.device("cpu"))
    for step in range(training.steps):
        training.step(step, step_generator(3, "field", step))
    return TrainedField(
        network=training.network.eval().requires_grad_(False),
        scaling=training.scaling,
        components=training.components,
        posterior_mean=training.mean.table,
        posterior_log_variance=training.log_variance.table,
        windows=windows,
        store_fingerprint="analytic",
    )


def capture(fps: int = 60, kind: int = 0) -> Motion:
    grid = TimeGrid(Fraction(fps), int(SECONDS * fps) + 1, start_seconds=2.0)
    return Motion(analytic_positions(grid.seconds() - 2.0, kind), SMPL22, grid)


def test_a_long_capture_is_reconstructed_at_any_framerate_without_a_seam(trained: TrainedField) -> None:
    encoder = NermEncoder(trained)
    assert isinstance(encoder, MotionEncoder)
    motion = capture()
    field = encoder.encode(Observation.of(motion))
    assert (field.start_seconds, field.end_seconds) == pytest.approx((2.0, 2.0 + SECONDS))
    assert len(field.pieces) == 4 and all(piece.field.end_seconds == 4.0 for piece in field.pieces)
    fast = to_motion(field, Fraction(120))
    truth = analytic_positions(fast.timegrid.seconds() - 2.0, 0)
    assert np.linalg.norm(fast.joint_positions - truth, axis=-1).mean() < 0.02
    # The frames of the pieces differ: without placing them the windows lie metres apart.
    assert np.ptp([piece.origin[1] for piece in field.pieces]) > 3.0
    joins = np.concatenate((field.fade_start, field.fade_end))
    sides = [joint_velocities(field, joins + side, step_seconds=5e-4) for side in (-1e-3, 1e-3)]
    assert np.abs(sides[1] - sides[0]).max() < 0.15


def test_gaps_and_uneven_times_are_fitted_like_any_other(trained: TrainedField) -> None:
    motion = capture()
    observed = np.random.default_rng(0).uniform(size=motion.num_frames) < 0.3
    observed[200:230] = False
    field = NermEncoder(trained).encode(Observation.of(motion, observed))
    assert observed_errors(field, Observation.of(motion.frames(200, 230))).mean() < 0.05
    done = complete(motion, NermEncoder(trained), fps=Fraction(30), observed=observed, after_seconds=0.2)
    assert np.isfinite(done.joint_positions).all() and done.num_frames == int(SECONDS * 30) + 1 + 6


def test_what_cannot_be_encoded_is_named(trained: TrainedField) -> None:
    motion = capture()
    observed = np.ones(motion.num_frames, dtype=np.bool_)
    observed[60:-60] = False
    with pytest.raises(ValueError, match=r"no pose is observed between 4\.33 and 8\.33 s"):
        NermEncoder(trained).encode(Observation.of(motion, observed))
    kit = Observation(np.zeros(1), Poses(np.zeros((1, 21, 3), np.float32)), KIT21)
    with pytest.raises(ValueError, match="map the motion first"):
        NermEncoder(trained).encode(kit)
    others = replace(SMPL22, name="lafan1", joint_names=tuple(f"joint {number}" for number in range(22)))
    with pytest.raises(ValueError, match="not those of Skeleton\\('lafan1', 22 joints"):
        NermEncoder(trained).encode(Observation(np.zeros(1), Poses(np.zeros((1, 22, 3), np.float32)), others))
    with pytest.raises(ValueError, match="between 0 and 4 s"):
        NermEncoder(trained, overlap_seconds=4.0).encode(Observation.of(motion))


def test_a_run_without_a_field_is_named(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="stage 'field'"):
        load(tmp_path)
