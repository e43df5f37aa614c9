"""Observations that are not in memory: the same poses as those in memory, in whatever order they are asked for."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motionkit.core.kinematics import inverse_kinematics_in_time
from motionkit.core.motion import Motion
from motionkit.fields import long_observation
from motionkit.fields.anchoring import Anchored
from motionkit.fields.interpolation.interpolators import INTERPOLATORS, Settling
from motionkit.fields.interpolation.joints import with_rotations
from motionkit.fields.long_observation import LongObservation
from motionkit.fields.motion_field import MotionEncoder, Observation, Observed, Poses, continuous_rotations
from motionkit.fields.transfer import Transferred, canonical_observation
from tests.helpers.turning_body import random_motion


def both(motion: Motion) -> tuple[Observation, LongObservation]:
    """The same motion in memory and as it would be taken from a file."""
    held = Observation.of(motion)
    return held, LongObservation(held.times_seconds, lambda rows: held.poses.rows(rows), held.skeleton)


def assert_same(found: Poses, expected: Poses, tolerance: float) -> None:
    for name in ("joint_positions", "local_rotations", "root_translation"):
        made, wanted = getattr(found, name), getattr(expected, name)
        assert (made is None) == (wanted is None)
        if made is not None:
            np.testing.assert_allclose(made, wanted, atol=tolerance, err_msg=name)


def flipped(motion: Motion) -> Motion:
    """The same rotations, half of the quaternions with the opposite sign."""
    assert motion.local_rotations is not None
    signs = np.random.default_rng(0).choice([-1, 1], motion.local_rotations.shape[:2]).astype(np.float32)
    return replace(motion, local_rotations=motion.local_rotations * signs[..., None])


@settings(max_examples=25)
@given(st.integers(1, 24), st.lists(st.slices(50), min_size=1, max_size=4), st.sampled_from(["signs", "ik", "22"]))
def test_poses_that_go_on_from_block_to_block(frames_at_once: int, asked: list[slice], kind: str) -> None:
    motion = random_motion(3, num_frames=50, rotations=kind == "signs")
    held, long = both(flipped(motion) if kind == "signs" else motion)

    def remade(observed: Observed) -> Observed:
        if kind == "signs":
            return observed.remade(continuous_rotations, observed.skeleton)
        return with_rotations(observed) if kind == "ik" else canonical_observation(observed)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(long_observation, "FRAMES_AT_ONCE", frames_at_once)
        expected, found = remade(held), remade(long)
        assert len(found) == 50 and found.end_seconds == held.end_seconds
        for rows in asked:
            rows = slice(*sorted([rows.start or 0, 50 if rows.stop is None else rows.stop]), abs(rows.step or 1))
            if len(range(*rows.indices(50))):
                assert_same(found.rows(rows).poses, expected.rows(rows).poses, 2e-6)


def test_kinematics_go_on_from_a_known_pose() -> None:
    motion = random_motion(1, num_frames=40)
    whole = inverse_kinematics_in_time(motion.joint_positions, motion.skeleton)
    rest = inverse_kinematics_in_time(motion.joint_positions[17:], motion.skeleton, whole[17])
    np.testing.assert_allclose(rest, whole[17:], atol=1e-6)
    # Without it the twist of bones begins anew.
    assert np.abs(inverse_kinematics_in_time(motion.joint_positions[17:], motion.skeleton) - whole[17:]).max() > 0.01


@pytest.mark.parametrize("rotations", [True, False])
@pytest.mark.parametrize(
    "encoder",
    [
        *INTERPOLATORS.values(),
        Settling(INTERPOLATORS["rotation-cubic"]),
        Transferred(Anchored(INTERPOLATORS["slerp"])),
    ],
    ids=lambda encoder: f"{type(encoder).__name__}-{encoder.name}",
)
def test_fields_are_those_of_the_observation_in_memory(
    encoder: MotionEncoder, rotations: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    held, long = both(random_motion(5, num_frames=60, rotations=rotations))
    reach = {"before_seconds": 0.3, "after_seconds": 0.2}
    expected = encoder.encode(held, **reach)
    times = np.linspace(expected.start_seconds, expected.end_seconds, 201)
    wanted = expected.query(times)
    for module in ("long_observation", "interpolation.interpolators", "anchoring"):
        name = "_FRAMES_AT_ONCE" if module == "anchoring" else "FRAMES_AT_ONCE"
        monkeypatch.setattr(f"motionkit.fields.{module}.{name}", 20)
    field = encoder.encode(long, **reach)
    assert_same(field.query(times), wanted, 5e-6)
    some = np.random.default_rng(0).permutation(len(times))[:40]
    assert_same(field.query(times[some]), wanted.rows(some), 5e-6)
