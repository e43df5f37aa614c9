"""Long motions from pieces: no seam in place or velocity, whatever the pieces disagree about."""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import motionkit as mk
from motionkit.core.kinematics import forward_kinematics
from motionkit.fields.assembly import AssembledField, Piece, assemble, chain, even_starts
from motionkit.fields.interpolation import InterpolatedField, Method, interpolate
from motionkit.fields.motion_field import MotionField, Poses
from tests.helpers.analytic import analytic_motion
from tests.helpers.turning_body import random_motion
from tests.helpers.velocities import joint_velocities


@dataclass(frozen=True, eq=False)
class Shifted:
    """Part of a field as a field of its own, in a frame of its own, and counting what it is asked for."""

    whole: MotionField
    from_seconds: float
    end_seconds: float
    asked: list[int]
    start_seconds: float = 0.0

    @property
    def skeleton(self) -> mk.Skeleton:
        return self.whole.skeleton

    def query(self, times_seconds: np.ndarray) -> Poses:
        self.asked.append(len(times_seconds))
        return self.whole.query(times_seconds + self.from_seconds)


def wandering(seed: int, method: Method = "rotation-cubic", rotations: bool = True) -> InterpolatedField:
    return interpolate(random_motion(seed, num_frames=40, fps=Fraction(20), rotations=rotations), method)


def swaying(seed: int, method: Method, rotations: bool) -> InterpolatedField:
    """Every joint sways by up to half a radian about an axis of its own, 40 frames at 20 fps."""
    rng, joints, seconds = np.random.default_rng(seed), mk.SMPL22.num_joints, np.arange(40)[:, None, None] / 20
    phases = 2 * np.pi * (rng.uniform(0.2, 1.5, (joints, 1)) * seconds + rng.uniform(size=(joints, 1)))
    turns = rng.uniform(-0.3, 0.3, (joints, 3)) * np.sin(phases)
    local = Rotation.from_rotvec(turns.reshape(-1, 3)).as_quat(scalar_first=True).reshape(40, joints, 4)
    root = 0.1 * np.sin(phases[:, 0] * np.array([1.0, 0.5, 0.7]))
    positions = forward_kinematics(local.astype(np.float32), root.astype(np.float32), mk.SMPL22)
    poses = (local.astype(np.float32), root.astype(np.float32)) if rotations else (None, None)
    return interpolate(mk.Motion(positions, mk.SMPL22, mk.TimeGrid(Fraction(20), 40), *poses), method)


def seams(field: AssembledField) -> np.ndarray:
    """Where fades begin and end and where pieces do: every instant at which something could jump."""
    inner = [piece.start_seconds for piece in field.pieces[1:]] + [piece.end_seconds for piece in field.pieces[:-1]]
    return np.concatenate((field.fade_start, field.fade_end, inner))


@settings(max_examples=12)
@given(st.integers(0, 1000), st.lists(st.floats(0.3, 1.5), min_size=1, max_size=4), st.booleans())
def test_velocity_is_continuous_at_every_join(seed: int, overlaps: list[float], rotations: bool) -> None:
    rng = np.random.default_rng(seed)
    method: Method = "rotation-cubic" if rotations else "cubic"
    pieces = [Piece(swaying(seed, method, rotations), 0.0)]
    for number, overlap in enumerate(overlaps, start=1):
        other = swaying(seed + number, method, rotations)
        start = pieces[-1].end_seconds - overlap
        origin = (float(rng.normal()), float(rng.normal()))
        pieces.append(Piece(other, start, float(rng.uniform(-0.5, 0.5)), origin))
    field = assemble(pieces)
    times, step = seams(field), 5e-4

    def jumps(step: float) -> tuple[float, float]:
        offsets = np.concatenate([times + count * step for count in (-2, -1, 1, 2)])
        before, left, right, after = np.split(field.query(offsets).joint_positions.astype(np.float64), 4)
        velocity = np.abs((after - right) - (left - before)).max() / step
        return float(np.abs(right - left).max()), float(velocity)

    place, velocity = jumps(step)
    nearer_place, nearer_velocity = jumps(step / 4)
    # Velocity is finite, and so is acceleration: what changes over a step vanishes with it (a jump of 1 mm or a kink of
    # 0.2 m/s would stay). Pieces differ by less than half a turn: there the shorter way round changes sides.
    assert nearer_place < 0.4 * place + 5e-4
    assert nearer_velocity < 0.4 * velocity + 0.1


@pytest.mark.parametrize("rotations", [True, False])
def test_a_motion_cut_into_overlapping_parts_is_itself_again(rotations: bool) -> None:
    whole = wandering(3, "rotation-cubic" if rotations else "cubic", rotations)
    start, length = whole.start_seconds, 0.7
    starts = start + even_starts(whole.end_seconds - start, length, 0.2)
    asked: list[int] = []
    pieces = [Piece(Shifted(whole, float(at), length, asked), float(at)) for at in starts]
    field = assemble(pieces)
    assert (field.start_seconds, field.end_seconds) == pytest.approx((whole.start_seconds, whole.end_seconds))
    times = np.random.default_rng(0).permutation(np.linspace(whole.start_seconds, whole.end_seconds, 300))
    found, truth = field.query(times), whole.query(times)
    assert np.allclose(found.joint_positions, truth.joint_positions, atol=1e-5)
    assert sum(asked) < 2 * 300 and max(asked) < 300
    if rotations:
        assert found.local_rotations is not None and truth.local_rotations is not None
        same = np.abs(np.sum(found.local_rotations * truth.local_rotations, axis=-1))
        assert np.allclose(same, 1.0, atol=1e-5)
        assert found.root_translation is not None and truth.root_translation is not None
        assert np.allclose(found.root_translation, truth.root_translation, atol=1e-5)
    asked.clear()
    field.query(np.array([field.start_seconds]))
    assert asked == [1]  # the other pieces are not read


def test_a_chain_goes_on_where_the_last_motion_ends() -> None:
    """Parts of one walk, each put elsewhere and turned, are laid back over each other."""
    rng = np.random.default_rng(0)
    walk = analytic_motion("walk", 6.0)
    parts = []
    for first in (0.0, 2.0, 4.0):
        turned = Piece(
            Shifted(walk, first, 2.0 if first == 4.0 else 2.5, []), 0.0, float(rng.uniform(-3, 3)), (5.0, -2.0)
        )
        parts.append(assemble([turned]))
    field = chain(parts, 0.5)
    times = np.linspace(0.0, 5.9, 60)
    first = parts[0].query(np.array([0.0])).joint_positions
    found, truth = field.query(times).joint_positions, walk.query(times).joint_positions
    # The chain lies in the first part's frame: compare distances from the start, and shapes.
    assert np.allclose(found[0], first[0], atol=1e-6)
    travelled = np.linalg.norm(found[:, 0] - found[0, 0], axis=-1), np.linalg.norm(truth[:, 0] - truth[0, 0], axis=-1)
    assert np.allclose(*travelled, atol=1e-3)
    speed = np.linalg.norm(joint_velocities(field, times), axis=-1)
    assert np.allclose(speed, np.linalg.norm(joint_velocities(walk, times), axis=-1), atol=2e-2)
