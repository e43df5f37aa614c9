"""What is no human body: joint positions of another unit or order, padding, pose vectors of other statistics."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eval.sample_folder.folder import SampleFolderError, SampleMotion
from eval.sample_folder.manifest import MANIFEST, NORMALISED
from motionkit.core.shapes import Float, Float32
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import joint_map
from motionkit.features.layout import layout_of
from motionkit.io import humanml3d
from motionkit.io.body_frame import (
    TRUNK_AND_LEGS,
    TYPICAL_HEIGHT_METRES,
    UNITS,
    infer_up,
    is_plausible,
    log_lines,
    to_y_up,
)

POSES_PER_MOTION = 8
MOST_BONE_VARIATION = 0.25
STILL_METRES, PADDED_SECONDS = 1e-4, 0.5
# Smaller variations of the root's velocity (metres per frame) are not used for the check.
LEAST_STEP_METRES = 0.004
MOST_DISAGREEMENT = 4.0
STATE_STATISTICS = (
    f'write into {MANIFEST} either statistics = "raw", or statistics = "normalised" with mean = "mean.npy" and std = '
    '"std.npy", copies of the files that the model was trained with'
)


def some_poses(
    sequences: Sequence[Float32[np.ndarray, "_frames joints 3"]],
) -> Float32[np.ndarray, "motions poses joints 3"]:
    """A few poses of each motion, evenly spaced."""
    share = np.linspace(0, 1, POSES_PER_MOTION)
    return np.stack([each[np.rint(share * (len(each) - 1)).astype(np.int64)] for each in sequences])


def bone_lengths(joints: Float[np.ndarray, "*batch 22 3"]) -> Float[np.ndarray, "*batch bones"]:
    """Lengths of the bones from the ankles to the head; their sum is 1.45 m for an average person."""
    first, second = np.array([(SMPL22.index(a), SMPL22.index(b)) for a, b in TRUNK_AND_LEGS]).T
    return np.asarray(np.linalg.norm(joints[..., first, :] - joints[..., second, :], axis=-1))


def _variation(bones: Float[np.ndarray, "*batch poses bones"]) -> float:
    """Median over the bones of std ÷ mean of a bone's length; 0 for a rigid body."""
    return float(np.median(bones.std(axis=-2) / np.maximum(bones.mean(axis=-2), 1e-9)))


def body_faults(name: str, motions: Sequence[SampleMotion]) -> dict[int, str]:
    """A message for each motion whose body is not of a person's size.

    Raises `SampleFolderError` if the bones of the others do not keep their lengths.
    """
    bones = bone_lengths(some_poses([motion.positions for motion in motions]))
    sizes = np.median(bones.sum(axis=-1), axis=1).tolist()
    faults = {index: _size_message(metres) for index, metres in enumerate(sizes) if not is_plausible(metres)}
    kept = np.delete(bones, list(faults), axis=0)
    if len(kept) and (variation := _variation(kept)) > MOST_BONE_VARIATION:
        raise SampleFolderError(
            f"--samples {name}: the bones' lengths vary by {100 * variation:.0f} % within a motion, so these are no "
            "positions of the 22 SMPL (or 21 KIT) joints in their order (docs/samples.md)"
        )
    return faults


def _size_message(metres: float) -> str:
    units = {**UNITS, "KIT-ML's unit": humanml3d.KIT.unit_metres}
    name = min(units, key=lambda name: abs(np.log(max(metres * units[name], 1e-30) / TYPICAL_HEIGHT_METRES)))
    in_unit, advice = metres * units[name], f"unit_metres = {units[name]:.6g} in {MANIFEST}"
    return f"a body measures {metres:.3g} m from ankle to head, people {TYPICAL_HEIGHT_METRES} m; " + (
        f"in {name} it would be {in_unit:.2f} m: {advice}" if is_plausible(in_unit) else "no usual unit explains it"
    )


def upright(motions: Sequence[SampleMotion], up: str) -> tuple[list[SampleMotion], str]:
    """Motions rotated so that most bodies stand along +y, with a remark; `up` is the axis, or "" to infer it.

    All motions are rotated alike, since a lying body does not show the axes. Rotated ones lose their pose vectors and
    KIT joints, which have y up by definition.
    """
    if motions and not up:
        poses = some_poses([motion.positions for motion in motions]).reshape(-1, SMPL22.num_joints, 3)
        up = infer_up(SMPL22, poses, ("y", "z", "-y"))
    if up in ("", "y"):
        return list(motions), ""
    turned = [
        replace(motion, positions=to_y_up(motion.positions, up).astype(np.float32), vectors=None, kit_joints=None)
        for motion in motions
    ]
    return turned, log_lines(up)[0]


def padding_remark(motions: Sequence[SampleMotion]) -> tuple[str, ...]:
    """A remark if motions end in a pose that is frozen for half a second or more, which may be padding."""
    frozen = []
    for motion in motions:
        steps = np.abs(np.diff(motion.positions - motion.positions[:, :1], axis=0)).max(axis=(1, 2))
        moved = np.flatnonzero(steps > STILL_METRES)
        seconds = (len(steps) - 1 - moved[-1]) / float(motion.fps) if len(moved) else 0.0
        if seconds >= PADDED_SECONDS:
            frozen.append(seconds)
    if not frozen:
        return ()
    return (
        f"{len(frozen):,} motions end in a frozen pose ({np.median(frozen):.1f} s in the median): if that is "
        "padding, state their num_frames in a CSV beside them",
    )


def published_layout(num_values: int) -> humanml3d.Layout:
    """HumanML3D's layout for 263 numbers, KIT-ML's for 251."""
    return next(layout for layout in humanml3d.LAYOUTS.values() if layout.num_values == num_values)


def check_vectors(
    name: str, stored: Float[np.ndarray, "rows numbers"], restored: Float[np.ndarray, "rows numbers"], statistics: str
) -> None:
    """Raise `SampleFolderError` if the stated statistics contradict pose vectors as stored and as restored.

    Raw vectors that are said to be normalised, or the reverse, make no body. Statistics of another convention (the
    published evaluators weight root numbers 25-fold) make the root's own velocity disagree with its joint's.
    """
    what = f"--samples {name}: {stored.shape[1]}-number pose vectors are said to be {statistics}, but"

    def makes_body(vectors: Float[np.ndarray, "rows numbers"]) -> bool:
        bones = bone_lengths(_local_joints(vectors))
        return is_plausible(float(np.median(bones.sum(axis=-1)))) and _variation(bones) <= MOST_BONE_VARIATION

    if statistics == NORMALISED and makes_body(stored):
        raise SampleFolderError(f"{what} as they are they make a body, so they look raw; {STATE_STATISTICS}")
    if not makes_body(restored):
        raise SampleFolderError(
            f"{what} they make no body: they are of another dataset or convention; {STATE_STATISTICS}"
        )
    layout = published_layout(stored.shape[1])
    slices = layout_of(layout.skeleton.num_joints).vector
    first = slices.joint_velocities.start
    own, joint = (
        float(np.linalg.norm(restored[:, columns].std(axis=0, dtype=np.float64))) * layout.unit_metres
        for columns in (slices.root_velocity, [first, first + 2])
    )
    if max(own, joint) > LEAST_STEP_METRES and not joint / MOST_DISAGREEMENT < own < joint * MOST_DISAGREEMENT:
        raise SampleFolderError(
            f"{what} the root's own velocity varies {own:.2g} m a frame, and its joint's {joint:.2g}. The published "
            "evaluators' statistics weight root numbers 25-fold, those of Mean.npy and Std.npy do not: normalise and "
            "restore with the same files"
        )


def _local_joints(vectors: Float[np.ndarray, "rows numbers"]) -> Float32[np.ndarray, "rows 22 3"]:
    """Poses in metres, without their path."""
    layout = published_layout(vectors.shape[1])
    slices = layout_of(layout.skeleton.num_joints).vector
    joints = np.zeros((len(vectors), layout.skeleton.num_joints, 3), dtype=np.float32)
    joints[:, 1:] = vectors[:, slices.joint_positions].reshape(len(vectors), -1, 3)
    joints[:, 0, 1] = vectors[:, slices.root_height][:, 0]
    return np.asarray(joint_map(layout.skeleton, SMPL22.name).weights @ joints * np.float32(layout.unit_metres))
