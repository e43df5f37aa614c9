"""What is no human body: joint positions of another unit or axis, padding, pose vectors of other statistics.

A pose vector contains the root's motion twice, as its own velocity and as its joint's. Statistics of another convention
(the published evaluators weight root numbers 25-fold) make the two disagree; raw numbers taken for normalised ones, or
the reverse, give no body.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import ceil

import numpy as np

from eval.sample_folder.folder import SampleFolderError, SampleMotion
from eval.sample_folder.manifest import MANIFEST, NORMALISED
from motionkit.core.shapes import Float, Float32
from motionkit.core.skeleton import KIT21, SMPL22
from motionkit.features.layout import layout_of
from motionkit.io import humanml3d
from motionkit.io.body_frame import TRUNK_AND_LEGS, TYPICAL_HEIGHT_METRES, UNITS, is_plausible, log_lines, to_y_up

KIT_TRUNK_AND_LEGS = (
    *(("LA", "LK"), ("LK", "LH"), ("root", "BP"), ("BP", "BT"), ("BT", "BLN"), ("BLN", "BUN")),
    *(("RA", "RK"), ("RK", "RH")),
)
CHAINS = {
    skeleton.num_joints: np.array([(skeleton.index(a), skeleton.index(b)) for a, b in bones]).T
    for skeleton, bones in ((SMPL22, TRUNK_AND_LEGS), (KIT21, KIT_TRUNK_AND_LEGS))
}
HEAD, ANKLES = SMPL22.index("head"), [SMPL22.index("left_ankle"), SMPL22.index("right_ankle")]
LAYOUT_BY_WIDTH = {12 * layout.skeleton.num_joints - 1: layout for layout in humanml3d.LAYOUTS.values()}
"""HumanML3D's layout of 263 numbers, KIT-ML's of 251."""
POSES_PER_MOTION = 8
MOST_BONE_VARIATION = 0.25
STILL_METRES = 1e-4
PADDED_SECONDS = 0.5
# Smaller variations of the root's velocity (metres per frame) are not used for the check.
LEAST_STEP_METRES = 0.004
MOST_DISAGREEMENT = 4.0
STATE_STATISTICS = (
    f'write into {MANIFEST} either statistics = "raw", or statistics = "normalised" with mean = "mean.npy" and std = '
    '"std.npy", copies of the files that the model was trained with'
)


def _bones(joints: Float[np.ndarray, "*batch joints 3"]) -> Float[np.ndarray, "*batch bones"]:
    """Lengths of the bones from the ankles to the head."""
    first, second = CHAINS[joints.shape[-2]]
    lengths: Float[np.ndarray, "*batch bones"] = np.linalg.norm(joints[..., first, :] - joints[..., second, :], axis=-1)
    return lengths


def standing_metres(joints: Float[np.ndarray, "*batch joints 3"]) -> float:
    """Median length from ankle to head along the bones; of KIT's 21 joints, to the neck with both legs averaged."""
    lengths = _bones(joints)
    if joints.shape[-2] == KIT21.num_joints:
        lengths = lengths * np.array([0.5, 0.5, 1, 1, 1, 1, 0.5, 0.5])
    return float(np.median(lengths.sum(axis=-1)))


def _variation(bones: Float[np.ndarray, "*batch poses bones"]) -> float:
    """Median over the bones of std ÷ mean of a bone's length; 0 for a rigid body."""
    return float(np.median(bones.std(axis=-2) / np.maximum(bones.mean(axis=-2), 1e-9)))


def _makes_body(joints: Float[np.ndarray, "rows joints 3"]) -> bool:
    return is_plausible(standing_metres(joints)) and _variation(_bones(joints)) <= MOST_BONE_VARIATION


def some_poses(
    sequences: Sequence[Float32[np.ndarray, "_frames joints 3"]],
) -> Float32[np.ndarray, "motions poses joints 3"]:
    """A few poses of each motion, evenly spaced."""
    share = np.linspace(0, 1, POSES_PER_MOTION)
    return np.stack([each[np.rint(share * (len(each) - 1)).astype(np.int64)] for each in sequences])


def body_faults(name: str, motions: Sequence[SampleMotion], up_is_stated: bool) -> dict[int, tuple[str, str]]:
    """Reason (as in `FormatError`) and message for each motion that is no body: of another unit, or lying most of it.

    Lying is accepted if the folder states which way is up. Raises `SampleFolderError` if most bodies are of another
    unit, or if bones do not keep their lengths.
    """
    poses = some_poses([motion.positions for motion in motions])
    bones = _bones(poses)
    metres = np.median(bones.sum(axis=-1), axis=1)
    wrong = [index for index, each in enumerate(metres.tolist()) if not is_plausible(each)]
    if 2 * len(wrong) > len(motions):
        advice = "write unit_metres = {:.6g} into " + MANIFEST
        raise SampleFolderError(f"--samples {name}: {_size_message(float(np.median(metres[wrong])), advice)}")
    kept = np.setdiff1d(np.arange(len(motions)), wrong)
    if (variation := _variation(bones[kept])) > MOST_BONE_VARIATION:
        raise SampleFolderError(
            f"--samples {name}: the bones' lengths vary by {100 * variation:.0f} % within a motion, so these are no "
            "positions of the 22 SMPL (or 21 KIT) joints in their order (docs/samples.md)"
        )
    message = (
        "in most poses the head is beside or below the feet: turn the motion so that y is up, or write "
        f'up = "y" into {MANIFEST} if the body is meant to lie'
    )
    x, y, z = np.moveaxis(_upward(poses), -1, 0)
    lies = np.mean(2 * y < np.hypot(x, z), axis=1) > 0.5
    faults = {} if up_is_stated else dict.fromkeys(np.flatnonzero(lies).tolist(), ("lying", message))
    advice = "multiply them by {:.6g}"
    return faults | {index: ("body-size", _size_message(float(metres[index]), advice)) for index in wrong}


def _upward(poses: Float[np.ndarray, "*batch 22 3"]) -> Float[np.ndarray, "*batch 3"]:
    """From the middle of the ankles to the head."""
    return np.asarray(poses[..., HEAD, :] - poses[..., ANKLES, :].mean(axis=-2))


def _size_message(metres: float, advice: str) -> str:
    """What is wrong with a body's size; `advice` is what to do with the unit's metres."""
    measured = f"a body measures {metres:.3g} m from ankle to head, people {TYPICAL_HEIGHT_METRES} m"
    units = {**UNITS, "KIT-ML's unit": humanml3d.KIT.unit_metres}
    fitting = [(name, unit) for name, unit in units.items() if is_plausible(metres * unit)]
    if not fitting:
        needed = TYPICAL_HEIGHT_METRES / metres if metres > 0 else np.inf
        return (
            f"{measured}, which no usual unit explains (a unit of {needed:.3g} m would): are these positions of the 22 "
            "SMPL joints?"
        )
    name, unit = min(fitting, key=lambda entry: abs(np.log(metres * entry[1] / TYPICAL_HEIGHT_METRES)))
    return f"{measured}; {advice.format(unit)} if the positions are in {name} ({metres * unit:.2f} m)"


def upright(motions: Sequence[SampleMotion], up: str) -> tuple[list[SampleMotion], str]:
    """Motions rotated so that most bodies stand along +y, with a remark; `up` is the axis, or "" to detect it.

    All motions are rotated alike, since a lying body does not show the axes. Rotated ones lose their pose vectors and
    KIT joints, which have y up by definition.
    """
    if motions and not up:
        _, y, z = _upward(np.stack([motion.positions[0] for motion in motions])).T
        if np.mean(z > 2 * np.abs(y)) > 0.5:
            up = "z"
        elif np.mean(-y > 2 * np.abs(z)) > 0.5:
            up = "-y"
    if not motions or up in ("", "y"):
        return list(motions), ""
    turned = [
        replace(motion, positions=to_y_up(motion.positions, up).astype(np.float32), vectors=None, kit_joints=None)
        for motion in motions
    ]
    return turned, log_lines(up)[0]


def padding_remark(motions: Sequence[SampleMotion]) -> tuple[str, ...]:
    """A remark if motions end in a pose that is frozen for half a second or more, which may be padding."""
    seconds = []
    for motion in motions:
        end = motion.positions[-1 - ceil(PADDED_SECONDS * motion.fps) :]
        if np.abs(np.diff(end - end[:, :1], axis=0)).max(initial=0.0) > STILL_METRES:
            continue
        relative = motion.positions - motion.positions[:, :1]
        moved = np.flatnonzero(np.abs(np.diff(relative, axis=0)).max(axis=(1, 2)) > STILL_METRES)
        if len(moved):
            seconds.append((len(relative) - 2 - moved[-1]) / float(motion.fps))
    if not seconds:
        return ()
    return (
        f"{len(seconds):,} motions end in a frozen pose ({np.median(seconds):.1f} s in the median): if that is "
        "padding, state their num_frames in a CSV beside them",
    )


def check_vectors(
    name: str, stored: Float[np.ndarray, "rows numbers"], restored: Float[np.ndarray, "rows numbers"], statistics: str
) -> None:
    """Raise `SampleFolderError` if the stated statistics contradict pose vectors as stored and as restored."""
    what = f"--samples {name}: {stored.shape[1]}-number pose vectors are said to be {statistics}, but"
    if statistics == NORMALISED and _makes_body(_local_joints(stored)):
        raise SampleFolderError(f"{what} as they are they make a body, so they look raw; {STATE_STATISTICS}")
    joints = _local_joints(restored)
    if not _makes_body(joints):
        raise SampleFolderError(
            f"{what} they make no body (from ankle to head {standing_metres(joints):.3g} m, bones vary by "
            f"{100 * _variation(_bones(joints)):.0f} %): they are of another dataset or convention; {STATE_STATISTICS}"
        )
    ratio = root_disagreement(restored)
    if not 1 / MOST_DISAGREEMENT < ratio < MOST_DISAGREEMENT:
        raise SampleFolderError(
            f"{what} the root's own velocity varies {ratio:.2g} times as much as its joint's. The published "
            "evaluators' statistics weight root numbers 25-fold, those of Mean.npy and Std.npy do not: normalise and "
            "restore with the same files"
        )


def root_disagreement(vectors: Float[np.ndarray, "rows numbers"]) -> float:
    """The variation of the root's own horizontal velocity relative to its joint's.

    1 for vectors in the right units, and if both vary too little to tell.
    """
    layout = LAYOUT_BY_WIDTH[vectors.shape[1]]
    slices = layout_of(layout.skeleton.num_joints).vector
    first = slices.joint_velocities.start
    own, joint = (
        float(np.linalg.norm(vectors[:, columns].std(axis=0, dtype=np.float64))) * layout.unit_metres
        for columns in (slices.root_velocity, [first, first + 2])
    )
    return own / joint if max(own, joint) > LEAST_STEP_METRES and joint > 0 else 1.0


def _local_joints(vectors: Float[np.ndarray, "rows numbers"]) -> Float32[np.ndarray, "rows joints 3"]:
    """Poses in metres, without their path."""
    layout = LAYOUT_BY_WIDTH[vectors.shape[1]]
    joints = np.zeros((len(vectors), layout.skeleton.num_joints, 3), dtype=np.float32)
    slices = layout_of(layout.skeleton.num_joints).vector
    joints[:, 1:] = vectors[:, slices.joint_positions].reshape(len(vectors), -1, 3)
    joints[:, 0, 1] = vectors[:, slices.root_height][:, 0]
    return joints * np.float32(layout.unit_metres)
