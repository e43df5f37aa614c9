"""Completion: given frames stay, times are exact, and what comes beyond is the encoder's."""

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motionkit.core.timegrid import TimeGrid
from motionkit.fields.anchoring import Anchored
from motionkit.fields.interpolation import INTERPOLATORS, InterpolatedField, Method, interpolate
from motionkit.fields.motion_field import MotionEncoder, Observation, to_motion
from motionkit.fields.resample import upsample
from tests.helpers.completing import complete
from tests.helpers.turning_body import random_motion
from tests.helpers.velocities import observed_errors

METHODS: list[Method] = list(INTERPOLATORS)


@pytest.mark.parametrize("method", METHODS)
def test_upsampling_keeps_frames_captions_and_logs(method: Method) -> None:
    motion = random_motion(9)
    faster = upsample(motion, Fraction(120), INTERPOLATORS[method])
    assert faster.fps == 120 and faster.num_frames == 4 * 19 + 1 and faster.timegrid.start_seconds == 1.25
    assert np.array_equal(faster.joint_positions[::4], motion.joint_positions)
    assert faster.captions == motion.captions and faster.sequence_id == "turn"
    between = to_motion(interpolate(motion, method), Fraction(120))
    assert np.allclose(between.joint_positions, faster.joint_positions, atol=1e-6)
    assert upsample(motion, Fraction(30)) is motion
    with pytest.raises(ValueError, match="resample"):
        upsample(motion, Fraction(20), INTERPOLATORS[method])


@settings(max_examples=25)
@given(
    st.integers(1, 30),
    st.sampled_from([Fraction(24), Fraction(30), Fraction(30000, 1001)]),
    st.sampled_from([Fraction(24), Fraction(60), Fraction(120000, 1001), Fraction(50)]),
    st.floats(0, 0.5),
    st.floats(0, 0.5),
)
def test_given_frames_are_found_on_every_grid(frames, fps_from, fps_to, before, after):
    motion = random_motion(3, num_frames=frames, fps=fps_from)
    done = complete(motion, INTERPOLATORS["slerp"], fps=fps_to, before_seconds=before, after_seconds=after)
    times = done.timegrid.seconds()
    assert 1.25 - before - 1e-6 <= times[0] and times[-1] <= 1.25 + motion.timegrid.span_seconds + after + 1e-6
    near = np.abs(times[:, None] - motion.timegrid.seconds()[None]) < 1e-7
    shared, which = np.nonzero(near)
    assert len(shared) >= 1
    assert np.array_equal(done.joint_positions[shared], motion.joint_positions[which])
    assert done.local_rotations is not None and motion.local_rotations is not None
    assert np.array_equal(np.abs(done.local_rotations[shared]), np.abs(motion.local_rotations[which]))


@pytest.mark.parametrize("method", METHODS)
def test_a_gap_is_filled_and_the_rest_is_left(method: Method) -> None:
    motion = random_motion(4, num_frames=40)
    observed = np.ones(40, dtype=np.bool_)
    observed[10:25] = False
    filled = complete(motion, INTERPOLATORS[method], observed=observed)
    assert np.array_equal(filled.joint_positions[observed], motion.joint_positions[observed])
    assert not np.allclose(filled.joint_positions[~observed], motion.joint_positions[~observed], atol=1e-2)
    expected = INTERPOLATORS[method].encode(Observation.of(motion, observed)).query(motion.timegrid.seconds())
    assert np.allclose(filled.joint_positions, expected.joint_positions, atol=1e-6)
    # What was to be filled is not read.
    spoilt = motion.joint_positions.copy()
    spoilt[~observed] += 9.0
    again = complete(replace(motion, joint_positions=spoilt), INTERPOLATORS[method], observed=observed)
    assert np.array_equal(again.joint_positions, filled.joint_positions)


def test_extrapolation_adds_whole_frames() -> None:
    motion = random_motion(6, num_frames=10)
    longer = complete(motion, INTERPOLATORS["linear"], before_seconds=0.05, after_seconds=0.1)
    assert longer.timegrid == TimeGrid(Fraction(30), 14, 1.25 - 1 / 30)
    assert np.array_equal(longer.joint_positions[1:11], motion.joint_positions)
    step = motion.joint_positions[-1] - motion.joint_positions[-2]
    assert np.allclose(longer.joint_positions[-1], motion.joint_positions[-1] + 3 * step, atol=1e-5)
    step = motion.joint_positions[1] - motion.joint_positions[0]
    assert np.allclose(longer.joint_positions[0], motion.joint_positions[0] - step, atol=1e-5)
    still = complete(motion, INTERPOLATORS["hold"], after_seconds=1.0)
    assert still.num_frames == 40 and np.array_equal(still.joint_positions[-1], motion.joint_positions[-1])


@dataclass(frozen=True)
class Forgetful:
    """An encoder that looks at every third frame only, so that it misses the others."""

    method: Method
    name: str = "forgetful"

    def encode(
        self, observation: Observation, *, before_seconds: float = 0.0, after_seconds: float = 0.0
    ) -> InterpolatedField:
        seen = np.arange(len(observation)) % 3 == 0
        seen[-1] = True
        few = Observation(observation.times_seconds[seen], observation.poses.rows(seen), observation.skeleton)
        return INTERPOLATORS[self.method].encode(few, before_seconds=before_seconds, after_seconds=after_seconds)


@pytest.mark.parametrize("method", ["rotation-cubic", "cubic"])
@pytest.mark.parametrize("rotations", [True, False])
def test_an_anchored_field_passes_through_every_observed_frame(method: Method, rotations: bool) -> None:
    observation = Observation.of(random_motion(0, rotations=rotations), np.arange(20) % 7 != 3)
    encoder = Forgetful(method)
    assert observed_errors(encoder.encode(observation), observation).max() > 1e-3
    anchored = Anchored(encoder)
    assert isinstance(anchored, MotionEncoder) and anchored.name == "forgetful, anchored"
    field = anchored.encode(observation, before_seconds=0.2, after_seconds=0.2)
    assert observed_errors(field, observation).max() < 1e-5
    poses = field.query(observation.times_seconds)
    if rotations and method == "rotation-cubic":
        given = observation.poses
        assert poses.local_rotations is not None and given.local_rotations is not None
        assert np.allclose(np.abs(np.sum(poses.local_rotations * given.local_rotations, axis=-1)), 1.0, atol=1e-5)
        assert poses.root_translation is not None and given.root_translation is not None
        assert np.allclose(poses.root_translation, given.root_translation, atol=1e-5)
    else:
        assert poses.local_rotations is None
