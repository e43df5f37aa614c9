"""Fields led through the observed frames, without a jump."""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest

from motionkit.core.skeleton import KIT21
from motionkit.fields.anchoring import Anchored, anchored
from motionkit.fields.completion import complete
from motionkit.fields.interpolation import INTERPOLATORS, InterpolatedField, Method
from motionkit.fields.motion_field import MotionEncoder, Observation
from tests.helpers.observed_errors import observed_errors
from tests.helpers.turning_body import random_motion


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

    def jump(step: float) -> float:
        times = np.concatenate([observation.times_seconds + count * step for count in (-2, -1, 1, 2)])
        before, left, right, after = np.split(field.query(times).joint_positions.astype(np.float64), 4)
        return float(np.abs((after - right) - (left - before)).max() / step)

    assert jump(1e-3) < 0.2 * jump(1e-2) + 0.1


def test_given_frames_join_without_a_jump_at_higher_framerates() -> None:
    motion = random_motion(1)
    loose = complete(motion, Forgetful("cubic"), fps=Fraction(240)).joint_positions
    led = complete(motion, Anchored(Forgetful("cubic")), fps=Fraction(240)).joint_positions
    assert np.array_equal(led[::8], motion.joint_positions)
    largest = [np.abs(np.diff(positions, 2, axis=0)).max() for positions in (loose, led)]
    assert largest[1] < 0.2 * largest[0]


def test_a_field_is_led_through_frames_of_its_own_joints_only() -> None:
    field = INTERPOLATORS["slerp"].encode(Observation.of(random_motion(2)))
    with pytest.raises(ValueError, match=r"'smpl22' \(22 joints\), the observation of 'kit21' \(21\)"):
        anchored(field, Observation.of(random_motion(2, skeleton=KIT21)))


def test_one_observed_frame_moves_the_whole_field() -> None:
    motion = random_motion(2, num_frames=1)
    field = Anchored(INTERPOLATORS["slerp"]).encode(Observation.of(motion), after_seconds=0.5)
    assert np.allclose(field.query(np.array([1.25, 1.75])).joint_positions, motion.joint_positions, atol=1e-5)
    assert field.at_fps(Fraction(60)).end_seconds == 1.75
