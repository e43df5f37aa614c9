"""Euler angles of rotations that lie between known ones: of all angles that mean the same, those that go on smoothly.

Each rotation has two triples of angles, (a, b, c) and (a + π, π − b, c + π) (with −b where the first axis is the third,
too), each up to whole turns. Known angles, the anchors, are never changed; what comes after one starts from it.
"""

import numpy as np
from jaxtyping import Bool, Float64, Int64

from motionkit.kinematics import euler_to_quaternion, quaternion_conjugate, quaternion_multiply

# Nearer to the pole than this cosine, the first and the last angle cannot be told apart from their sum.
_POLE_COSINE = 1e-5
# Angles that turn by less than this from what is wanted are as good: quaternions are float32.
_SAME_RADIANS = 2e-6


def anchored_angles(
    rotations: Float64[np.ndarray, "times joints 4"],
    order: str,
    expected: Float64[np.ndarray, "times joints axes"],
    anchors: Float64[np.ndarray, "anchors joints axes"],
    after: Int64[np.ndarray, "times"],
) -> Float64[np.ndarray, "times joints axes"]:
    """Angles in degrees about the axes of `order` (one to three), whose product is each rotation.

    Row t follows row t − 1 where both come after the same anchor, else the anchor `after[t]` itself (degrees). Where
    the `expected` angles turn as wanted, they are the answer, so a channel that rests stays as it is to the last digit.
    An order of fewer than three axes gives the angles whose rotation is nearest in those axes.
    """
    axes = order + "".join(axis for axis in "XYZ" if axis not in order) if len(order) < 3 else order
    pad = ((0, 0), (0, 0), (0, 3 - len(order)))
    expected, anchors = np.radians(np.pad(expected, pad)), np.radians(np.pad(anchors, pad))
    found = _principal(rotations, axes, expected)
    angles = _followed(found, anchors, after, is_proper=axes[0] == axes[2])
    same = _angle_between(euler_to_quaternion(expected, axes), rotations) < _SAME_RADIANS
    return np.degrees(np.where(same[..., None], expected, angles))[..., : len(order)]


def _principal(
    rotations: Float64[np.ndarray, "times joints 4"], axes: str, expected: Float64[np.ndarray, "times joints 3"]
) -> Float64[np.ndarray, "times joints 3"]:
    # One triple for each rotation; at the pole the one with the expected last angle.
    import warnings

    from scipy.spatial.transform import Rotation

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about the pole, of which we know
        found = Rotation.from_quat(rotations.reshape(-1, 4), scalar_first=True).as_euler(axes)  # type: ignore[call-overload]
    angles = np.asarray(found).reshape(expected.shape)
    second = angles[..., 1]
    pole = np.abs(np.sin(second) if axes[0] == axes[2] else np.cos(second)) < _POLE_COSINE
    if pole.any():
        last_two = np.stack((second[pole], expected[pole][:, 2]), axis=-1)
        rest = quaternion_conjugate(euler_to_quaternion(last_two, axes[1:]))
        first = quaternion_multiply(rotations[pole], rest)
        angles[pole, 0] = 2 * np.arctan2(first[:, "XYZ".index(axes[0]) + 1], first[:, 0])
        angles[pole, 2] = expected[pole][:, 2]
    return angles


def _followed(
    found: Float64[np.ndarray, "times joints 3"],
    anchors: Float64[np.ndarray, "anchors joints 3"],
    after: Int64[np.ndarray, "times"],
    *,
    is_proper: bool,
) -> Float64[np.ndarray, "times joints 3"]:
    # Steps between consecutive rows are taken in either triple; they differ in the sign of the second angle alone.
    first_of_run = np.concatenate(([True], after[1:] != after[:-1]))
    start = anchors[after]
    before = np.where(first_of_run[:, None, None], start, np.concatenate((start[:1], found[:-1])))
    straight, crossed = _turned(found - before), _turned(_other(found, is_proper) - before)
    crosses = np.abs(crossed).sum(axis=-1) < np.abs(straight).sum(axis=-1)
    # Which triple a row is in: what its run has crossed so far. Counted over all runs, less what was before the run.
    total = np.cumsum(crosses, axis=0)
    run_start = np.maximum.accumulate(np.where(first_of_run, np.arange(len(after)), 0))
    counted = total - total[run_start] + crosses[run_start]
    other: Bool[np.ndarray, "times joints"] = counted % 2 == 1
    chosen = np.where(other[..., None], _other(found, is_proper), found)
    previous = np.where(first_of_run[:, None, None], start, np.concatenate((start[:1], chosen[:-1])))
    steps = np.cumsum(_turned(chosen - previous), axis=0)
    unwound = start + steps - np.where(run_start[:, None, None] > 0, steps[run_start - 1], 0.0)
    # The sum says how many whole turns; the angle itself is not summed up.
    turns = np.rint((unwound - chosen) / (2 * np.pi))
    return np.asarray(chosen + 2 * np.pi * turns)


def _other(angles: Float64[np.ndarray, "times joints 3"], is_proper: bool) -> Float64[np.ndarray, "times joints 3"]:
    a, b, c = np.moveaxis(angles, -1, 0)
    return np.stack((a + np.pi, -b if is_proper else np.pi - b, c + np.pi), axis=-1)


def _turned(angles: Float64[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
    # Into [−π, π].
    return np.asarray(angles - 2 * np.pi * np.rint(angles / (2 * np.pi)))


def _angle_between(
    a: Float64[np.ndarray, "times joints 4"], b: Float64[np.ndarray, "times joints 4"]
) -> Float64[np.ndarray, "times joints"]:
    between = quaternion_multiply(quaternion_conjugate(a), b)
    return np.asarray(2 * np.arctan2(np.linalg.norm(between[..., 1:], axis=-1), np.abs(between[..., 0])))
