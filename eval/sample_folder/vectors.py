"""Pose vectors of samples: converted to metres with the stated statistics, which are checked and never guessed.

A vector contains the root's motion twice, as its own velocity and as its joint's. Statistics of another convention (the
published evaluators weight root numbers 25-fold) make the two disagree; raw numbers taken for normalised ones, or the
reverse, give no human body.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eval.sample_folder.bodies import bone_variation, is_body, standing_metres
from eval.sample_folder.folder import SampleFolderError
from eval.sample_folder.manifest import MANIFEST, NORMALISED, RAW, Manifest
from motionkit.core.errors import FormatError
from motionkit.core.shapes import Float, Float32
from motionkit.features.layout import layout_of
from motionkit.features.statistics import Statistics
from motionkit.io import humanml3d, npy, source_file

JOINTS_BY_WIDTH = {12 * layout.skeleton.num_joints - 1: layout for layout in humanml3d.LAYOUTS.values()}
# Smaller variations of the root's velocity (metres per frame) are not used for the check.
LEAST_STEP_METRES = 0.004
MOST_DISAGREEMENT = 4.0
# Normalised numbers have means near 0 and spreads near 1, whatever the model.
NORMALISED_MEAN, NORMALISED_SPREAD = 1.0, (0.2, 4.0)
ASK = (
    f'write into {MANIFEST} either statistics = "raw", or statistics = "normalised" with mean = "mean.npy" and std = '
    '"std.npy", copies of the files that the model was trained with'
)


@dataclass(frozen=True)
class VectorLook:
    """What pose vectors look like: `metres` from ankle to head if raw, or None; mean and spread."""

    makes_body: bool
    metres: float
    mean: float
    spread: float

    @property
    def seems(self) -> str:
        """`raw`, `normalised`, or empty if they look like neither."""
        if self.makes_body:
            return RAW
        low, high = NORMALISED_SPREAD
        return NORMALISED if self.mean < NORMALISED_MEAN and low < self.spread < high else ""

    def __str__(self) -> str:
        if self.makes_body:
            return f"they look raw (taken as they are, a body measures {self.metres:.2f} m from ankle to head)"
        numbers = f"the numbers' means are within {self.mean:.2f} of 0 and their spreads near {self.spread:.2f}"
        return f"they look normalised ({numbers})" if self.seems else f"they look like neither ({numbers})"


def look_at(vectors: Float[np.ndarray, "rows numbers"]) -> VectorLook:
    """What rows of pose vectors, of any motions, look like."""
    joints = _local_joints(vectors)
    column_mean, column_spread = np.abs(vectors.mean(axis=0)), vectors.std(axis=0)
    makes_body = is_body(joints) and bone_variation(joints) < 0.25
    return VectorLook(
        makes_body, standing_metres(joints), float(np.median(column_mean)), float(np.median(column_spread))
    )


def load_statistics(manifest: Manifest, width: int) -> Statistics | None:
    """The statistics that a manifest names; None for raw vectors. Raises `FormatError` for files of another size."""
    if manifest.statistics != NORMALISED:
        return None
    assert manifest.mean is not None
    assert manifest.std is not None
    mean, std = (_numbers(path, width) for path in (manifest.mean, manifest.std))
    try:
        return Statistics("humanml3d", mean, std)
    except ValueError as error:
        raise FormatError(str(error), path=manifest.std, reason="statistics") from None


def check_vectors(
    name: str, vectors: Float[np.ndarray, "rows numbers"], manifest: Manifest, statistics: Statistics | None
) -> None:
    """Raise `SampleFolderError` if the statistics are not stated, or contradict the vectors."""
    look = look_at(vectors)
    what = f"--samples {name}: {vectors.shape[1]}-number pose vectors"
    if not manifest.statistics:
        raise SampleFolderError(f"{what}, and it is not stated whether they are normalised: {look}; {ASK}")
    if look.seems and look.seems != manifest.statistics:
        raise SampleFolderError(f"{what} are said to be {manifest.statistics}, but {look}; {ASK}")
    restored = vectors if statistics is None else statistics.restore(vectors)
    joints = _local_joints(restored)
    if not is_body(joints) or bone_variation(joints) > 0.25:
        raise SampleFolderError(
            f"{what} make no body with these statistics (from ankle to head {standing_metres(joints):.3g} m, bones "
            f"vary by {100 * bone_variation(joints):.0f} %): they are of another dataset or convention; {ASK}"
        )
    ratio = root_disagreement(restored)
    if not 1 / MOST_DISAGREEMENT < ratio < MOST_DISAGREEMENT:
        raise SampleFolderError(
            f"{what}: with these statistics the root's own velocity varies {ratio:.2g} times as much as its joint's. "
            "The published evaluators' statistics weight root numbers 25-fold, those of Mean.npy and Std.npy do not: "
            "normalise and restore with the same files"
        )


def root_disagreement(vectors: Float[np.ndarray, "rows numbers"]) -> float:
    """The variation of the root's own horizontal velocity relative to its joint's.

    1 for vectors in the right units, and if both vary too little to tell.
    """
    part = layout_of(_num_joints(vectors)).vector
    unit = JOINTS_BY_WIDTH[vectors.shape[1]].unit_metres
    first = part.joint_velocities.start
    own = float(np.linalg.norm(vectors[:, part.root_velocity].std(axis=0, dtype=np.float64))) * unit
    joint = float(np.linalg.norm(vectors[:, [first, first + 2]].std(axis=0, dtype=np.float64))) * unit
    return own / joint if max(own, joint) > LEAST_STEP_METRES and joint > 0 else 1.0


def positions_of(
    vectors: Float[np.ndarray, "frames numbers"], unit_metres: float | None = None
) -> Float32[np.ndarray, "frames joints 3"]:
    """Joint positions in metres, in the vectors' own layout: 22 joints for 263 numbers, 21 for 251 in KIT-ML's unit."""
    layout = JOINTS_BY_WIDTH[vectors.shape[1]]
    positions = humanml3d.recover_positions(vectors, layout.skeleton.num_joints)
    unit = unit_metres or layout.unit_metres
    return positions if unit == 1.0 else positions * np.float32(unit)


def _local_joints(vectors: Float[np.ndarray, "rows numbers"]) -> Float32[np.ndarray, "rows joints 3"]:
    """Poses in metres, without their path."""
    layout = JOINTS_BY_WIDTH[vectors.shape[1]]
    joints = np.zeros((len(vectors), layout.skeleton.num_joints, 3), dtype=np.float32)
    part = layout_of(layout.skeleton.num_joints).vector
    joints[:, 1:] = vectors[:, part.joint_positions].reshape(len(vectors), -1, 3)
    joints[:, 0, 1] = vectors[:, part.root_height][:, 0]
    return joints * np.float32(layout.unit_metres)


def _num_joints(vectors: np.ndarray) -> int:
    return JOINTS_BY_WIDTH[vectors.shape[1]].skeleton.num_joints


def _numbers(path: Path, width: int) -> np.ndarray:
    numbers = npy.read_npy(path, source_file.read_bytes(path), (None,)).astype(np.float64)
    if numbers.size != width:
        raise FormatError(
            f"{numbers.size} numbers for pose vectors of {width}; copy the statistics of the right dataset",
            path=path,
            reason="statistics",
        )
    return numbers
