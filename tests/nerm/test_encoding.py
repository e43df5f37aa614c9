"""NeRM as an encoder of whole motions: windows, each in its own frame, assembled without a seam."""

from fractions import Fraction

import numpy as np
import pytest
import torch

from motionkit.core.motion import Motion
from motionkit.core.skeleton import KIT21, SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.data.windows import FrameValues, WindowPoses, cut_windows
from motionkit.features.field import FIELD_VECTORS, decode
from motionkit.fields.motion_field import MotionEncoder, Observation, Poses, to_motion
from nerm.encoding import NermEncoder, encode_by_optimisation, encode_varied, minimise_each, vary
from nerm.field_training import FieldTraining
from nerm.model import TrainedField
from tests.helpers.completing import complete
from tests.helpers.nerm_corpus import analytic_positions, analytic_source
from tests.helpers.velocities import joint_velocities, observed_errors
from tests.nerm.small_fields import SMALL, error_mm, finished, losses_of, small_poses

SECONDS = 11.0


@pytest.fixture(scope="module")
def trained() -> TrainedField:
    """Trained on overlapping windows of one long motion, so that windows anywhere in it are known ground."""
    source = analytic_source(rates=(60,), seconds=SECONDS)
    windows = cut_windows(source, max_duration_seconds=SMALL.windows.max_duration_seconds, stride_seconds=0.5)
    poses = WindowPoses(windows, FrameValues(source.positions, FIELD_VECTORS))
    training = FieldTraining(poses, SMALL, codebook=None, seed=3, device=torch.device("cpu"))
    losses_of(training, training.steps)
    return finished(training)


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


def test_encoding_by_optimisation_finds_a_training_window_again(small_field: TrainedField) -> None:
    batch = small_poses().evenly(np.arange(4), 61)
    latents = encode_by_optimisation(small_field, batch)
    assert max(error_mm(small_field, latents[window], window, 120) for window in range(4)) < 5.0


def test_varied_windows_are_the_corpus_mirrored_moved_and_at_another_tempo(small_field: TrainedField) -> None:
    source = analytic_source(rates=(120, 30), seconds=9.0)
    windows = cut_windows(source, max_duration_seconds=4.0, stride_seconds=2.0)
    many = windows.select(np.repeat(np.arange(len(windows)), 50))
    varied, at_own_tempo = vary(many, source, np.random.default_rng(0))
    tempo = varied.fps / at_own_tempo.fps
    assert 0.9 <= tempo.min() < 0.92 and 1.08 < tempo.max() <= 1.1
    assert varied.duration_seconds.max() <= 4.0 and varied.duration_seconds.min() > 3.9
    assert (varied.start_frame + varied.num_frames <= source.num_frames[many.sequence_index]).all()
    moved = at_own_tempo.start_seconds - many.start_seconds
    assert (np.abs(moved) <= 1.0 + 1e-9).all() and len(np.unique(moved.round(2))) > 5
    assert 0.4 < varied.mirrored.mean() < 0.6
    # In its own frame every window begins at the origin and faces Z.
    frames = FrameValues(source.positions, FIELD_VECTORS)
    batch = WindowPoses(varied, frames).evenly(np.arange(len(varied)), 33)
    assert np.abs(batch.vectors[:, 0, [0, 2]]).max() < 1e-5
    assert small_field.linear_model is not None
    latents = encode_varied(small_field.linear_model, varied, frames)
    with torch.no_grad():
        fps = torch.from_numpy(batch.fps)
        encoded = small_field.network.encode_coordinates(torch.from_numpy(batch.coordinates), fps)
        decoded = small_field.scaling.invert(small_field.network.decode(latents, encoded, fps))
    errors = np.linalg.norm(decode(decoded.numpy()) - decode(batch.vectors), axis=-1).mean(axis=(1, 2))
    # Four motions say nothing of their mirror images.
    assert np.median(errors[~varied.mirrored]) < 0.03


def test_each_row_is_minimised_by_itself() -> None:
    """Rosenbrock's valley, a stretched parabola, and one that is at its minimum from the start."""
    stretch = torch.tensor([1.0, 1e3], dtype=torch.float64)

    def objective(x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        valley = 100.0 * (x[:, 1] - x[:, 0] ** 2) ** 2 + (1.0 - x[:, 0]) ** 2
        slope = -400.0 * x[:, 0] * (x[:, 1] - x[:, 0] ** 2) - 2.0 * (1.0 - x[:, 0])
        parabola = (stretch * (x - 1.0) ** 2).sum(dim=1)
        is_valley = torch.arange(len(x)) == 0
        gradient = torch.stack((slope, 200.0 * (x[:, 1] - x[:, 0] ** 2)), dim=1)
        return (
            torch.where(is_valley, valley, parabola),
            torch.where(is_valley[:, None], gradient, 2.0 * stretch * (x - 1.0)),
        )

    start = torch.tensor([[-1.2, 1.0], [30.0, -7.0], [1.0, 1.0]], dtype=torch.float64)
    found = minimise_each(objective, start, 80)
    torch.testing.assert_close(found, torch.ones_like(start), atol=1e-6, rtol=0.0)
    assert torch.equal(minimise_each(objective, start[:1], 80), found[:1])
