"""Plausibility checks of joint positions: units, axes, joint order, padding."""

from dataclasses import dataclass

import numpy as np

from eval.sample_folder.folder import SampleFolder, SampleFolderError
from eval.sample_folder.manifest import MANIFEST
from motionkit.core.shapes import Float, Float32, Int64
from motionkit.core.skeleton import KIT21, SMPL22, Skeleton
from motionkit.io.body_frame import PLAUSIBLE_FACTOR, TRUNK_AND_LEGS, TYPICAL_HEIGHT_METRES, UNITS, log_lines, to_y_up
from motionkit.io.humanml3d import KIT

KIT_TRUNK_AND_LEGS = (
    *(("LA", "LK"), ("LK", "LH"), ("root", "BP"), ("BP", "BT"), ("BT", "BLN"), ("BLN", "BUN")),
    *(("RA", "RK"), ("RK", "RH")),
)
# Limb proportions are similar for all people: real median lengths are within a factor of 1.3 of the layout's, those of
# reversed joints off by 3 and more.
LIMBS = tuple(
    (f"{side}_{joint}", f"{side}_{end}")
    for side in ("left", "right")
    for joint, end in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
)
POSES_PER_MOTION = 8
MOST_BONE_VARIATION = 0.25
STILL_METRES = 1e-4
PADDED_SECONDS = 0.5


def _chain(skeleton: Skeleton, bones: tuple[tuple[str, str], ...]) -> list[tuple[int, int]]:
    return [(skeleton.index(a), skeleton.index(b)) for a, b in bones]


CHAINS = {SMPL22.num_joints: _chain(SMPL22, TRUNK_AND_LEGS), KIT21.num_joints: _chain(KIT21, KIT_TRUNK_AND_LEGS)}


def _bones(joints: Float[np.ndarray, "poses joints 3"]) -> Float[np.ndarray, "poses bones"]:
    first, second = np.array(CHAINS[joints.shape[1]]).T
    lengths: Float[np.ndarray, "poses bones"] = np.linalg.norm(joints[:, first] - joints[:, second], axis=-1)
    return lengths


def standing_metres(joints: Float[np.ndarray, "poses joints 3"]) -> float:
    """Median length from ankle to head along the bones; of KIT's 21 joints, to the neck with both legs averaged."""
    lengths = _bones(joints)
    if joints.shape[1] == KIT21.num_joints:
        lengths = lengths * np.array([0.5, 0.5, 1, 1, 1, 1, 0.5, 0.5])
    return float(np.median(lengths.sum(axis=1)))


def bone_variation(joints: Float[np.ndarray, "poses joints 3"]) -> float:
    """Median over the bones of std ÷ mean of a bone's length; 0 for a rigid body."""
    lengths = _bones(joints)
    return float(np.median(lengths.std(axis=0) / np.maximum(lengths.mean(axis=0), 1e-9)))


def is_body(joints: Float[np.ndarray, "poses joints 3"]) -> bool:
    """Whether the typical pose has a person's size in metres, within a factor of 2.2."""
    return _factor(standing_metres(joints)) <= PLAUSIBLE_FACTOR


def _factor(metres: float) -> float:
    return max(metres / TYPICAL_HEIGHT_METRES, TYPICAL_HEIGHT_METRES / metres) if metres > 0 else np.inf


def some_poses(folder: SampleFolder) -> Float32[np.ndarray, "motions poses joints 3"]:
    """A few poses of each motion, evenly spaced."""
    share = np.linspace(0, 1, POSES_PER_MOTION)
    motions = folder.sequences
    rows = motions.start_row[:, None] + np.rint(share * (motions.num_frames[:, None] - 1)).astype(np.int64)
    poses: Float32[np.ndarray, "motions poses joints 3"] = motions.values[rows]
    return poses


@dataclass(frozen=True)
class BodyFault:
    """Why a motion's body is none: a short slug as in `FormatError`, and a message."""

    reason: str
    message: str


def body_faults(folder: SampleFolder, up_is_stated: bool) -> dict[int, BodyFault]:
    """The motions whose bodies are none, by index: of another unit, or lying in most of their poses.

    Poses that lie are accepted if the folder states which way is up. Raises `SampleFolderError` if most bodies are of
    another unit.
    """
    poses = some_poses(folder)
    lengths = _bones(poses.reshape(-1, SMPL22.num_joints, 3)).reshape(*poses.shape[:2], -1)
    metres = np.median(lengths.sum(axis=2), axis=1)
    wrong = [index for index, each in enumerate(metres.tolist()) if _factor(each) > PLAUSIBLE_FACTOR]
    if 2 * len(wrong) > folder.num_motions:
        advice = "write unit_metres = {:.6g} into " + MANIFEST
        raise SampleFolderError(f"--samples {folder.name}: {_size_message(float(np.median(metres[wrong])), advice)}")
    advice = "multiply them by {:.6g}"
    faults = {index: BodyFault("body-size", _size_message(float(metres[index]), advice)) for index in wrong}
    lying = [] if up_is_stated else [index for index, motion in enumerate(poses) if _lies(motion)]
    message = (
        "in most poses the head is beside or below the feet: turn the motion so that y is up, or write "
        f'up = "y" into {MANIFEST} if the body is meant to lie'
    )
    return {index: BodyFault("lying", message) for index in lying} | faults


def _lies(poses: Float[np.ndarray, "poses 22 3"]) -> bool:
    """Whether the head is above the feet by less than half their horizontal distance in most poses."""
    x, y, z = _upward(poses).T
    return bool(2 * np.count_nonzero(2 * y < np.hypot(x, z)) > len(poses))


def _upward(poses: Float[np.ndarray, "poses 22 3"]) -> Float[np.ndarray, "poses 3"]:
    """From the middle of the ankles to the head."""
    head, ankles = SMPL22.index("head"), [SMPL22.index("left_ankle"), SMPL22.index("right_ankle")]
    upward: Float[np.ndarray, "poses 3"] = poses[:, head] - poses[:, ankles].mean(axis=1)
    return upward


def check_joints(folder: SampleFolder) -> None:
    """Raise `SampleFolderError` if bones do not keep their lengths, or have other proportions than people's."""
    poses = some_poses(folder)
    lengths = _bones(poses.reshape(-1, SMPL22.num_joints, 3)).reshape(*poses.shape[:2], -1)
    variation = float(np.median(lengths.std(axis=1) / np.maximum(lengths.mean(axis=1), 1e-9)))
    if variation > MOST_BONE_VARIATION:
        raise SampleFolderError(
            f"--samples {folder.name}: the bones' lengths vary by {100 * variation:.0f} % within a motion, so these "
            "are no positions of the 22 SMPL (or 21 KIT) joints in their order"
        )
    order = _limb_factor(poses.reshape(-1, SMPL22.num_joints, 3))
    if order > PLAUSIBLE_FACTOR:
        raise SampleFolderError(
            f"--samples {folder.name}: a bone of an arm or a leg is {order:.1f} times too long or too short beside the "
            "others, so these are no positions of the 22 SMPL (or 21 KIT) joints in their order (docs/samples.md)"
        )


def _limb_factor(joints: Float[np.ndarray, "poses joints 3"]) -> float:
    """The largest deviation of a limb from the layout's proportions, as a factor."""
    first, second = np.array(_chain(SMPL22, LIMBS)).T
    lengths = np.median(np.linalg.norm(joints[:, first] - joints[:, second], axis=-1), axis=0)
    shares = lengths / np.linalg.norm(SMPL22.offsets[second], axis=-1)
    shares = np.maximum(shares / np.maximum(np.median(shares), 1e-9), 1e-9)
    return float(max(shares.max(), 1 / shares.min()))


def _size_message(metres: float, advice: str) -> str:
    """What is wrong with a body's size; `advice` is what to do with the unit's metres."""
    found = f"a body measures {metres:.3g} m from ankle to head, people {TYPICAL_HEIGHT_METRES} m"
    units = {**UNITS, "KIT-ML's unit": KIT.unit_metres}
    name, unit = min(units.items(), key=lambda entry: _factor(metres * entry[1]))
    if _factor(metres * unit) > PLAUSIBLE_FACTOR:
        needed = TYPICAL_HEIGHT_METRES / metres if metres > 0 else np.inf
        return (
            f"{found}, which no usual unit explains (a unit of {needed:.3g} m would): are these positions of the 22 "
            "SMPL joints?"
        )
    return f"{found}; {advice.format(unit)} if the positions are in {name} ({metres * unit:.2f} m)"


def turn_upright(positions: Float32[np.ndarray, "rows joints 3"], starts: Int64[np.ndarray, "motions"], up: str) -> str:
    """Rotate motions in place so that most bodies stand along +y, with a remark; `up` is the axis, or "" to detect it.

    All motions are rotated alike, since a lying body does not show the axes.
    """
    if not len(starts):
        return ""
    if not up:
        _, y, z = _upward(positions[starts]).T
        if 2 * np.count_nonzero(z > 2 * np.abs(y)) > len(starts):
            up = "z"
        elif 2 * np.count_nonzero(-y > 2 * np.abs(z)) > len(starts):
            up = "-y"
        else:
            return ""
    if up == "y":
        return ""
    positions[...] = to_y_up(positions, up)
    return log_lines(up)[0]


def padding_remark(folder: SampleFolder) -> tuple[str, ...]:
    """A remark if motions end in a pose that is frozen for half a second or more, which may be padding."""
    seconds = []
    for sequence, fps in zip(folder.sequences, folder.fps, strict=True):
        still = _still_frames(sequence)
        if PADDED_SECONDS * fps <= still < len(sequence) - 1:
            seconds.append(still / float(fps))
    if not seconds:
        return ()
    return (
        f"{len(seconds):,} motions end in a frozen pose ({np.median(seconds):.1f} s in the median): if that is "
        "padding, state their num_frames in a CSV beside them",
    )


def _still_frames(sequence: Float32[np.ndarray, "frames joints 3"]) -> int:
    """Number of last steps in which only the root moves."""
    tail = len(sequence)
    for length in (3, 32, tail):
        poses = sequence[-length:]
        relative = poses - poses[:, :1]
        moved = np.abs(np.diff(relative, axis=0)).max(axis=(1, 2)) > STILL_METRES
        if moved.any():
            return int(len(moved) - 1 - np.flatnonzero(moved)[-1])
    return max(0, tail - 1)
