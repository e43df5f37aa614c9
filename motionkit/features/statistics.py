"""Mean and standard deviation of pose vectors, with their convention."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from motionkit.core.shapes import Float, Float32, Float64
from motionkit.features.layout import layout_of

Signature = Literal["published", "evaluator"]

# Root speed and joint speeds vary alike (0.87 for HumanML3D). The published evaluators divide four root numbers and
# four contacts by feat_bias = 5, in place, twice: 25 times less (0.035; KIT 0.040).
_ROOT_TO_JOINT_SPEED = 0.17


@dataclass(frozen=True, eq=False)
class Statistics:
    """Mean and std for standardising pose vectors; `convention` is `humanml3d`, `native` or `field`."""

    convention: str
    mean: Float64[np.ndarray, "numbers"]
    std: Float64[np.ndarray, "numbers"]

    def __post_init__(self) -> None:
        if self.mean.shape != self.std.shape:
            raise ValueError(f"mean has {self.mean.size} numbers, std {self.std.size}")
        if not (np.isfinite(self.mean).all() and np.isfinite(self.std).all() and (self.std > 0).all()):
            raise ValueError(f"{self.convention} statistics must be finite, and every std above 0")

    def standardise(self, rows: Float[np.ndarray, "*rows numbers"]) -> Float32[np.ndarray, "*rows numbers"]:
        """(rows − mean) / std."""
        return np.asarray((rows - self.mean) / self.std, dtype=np.float32)

    def restore(self, rows: Float[np.ndarray, "*rows numbers"]) -> Float32[np.ndarray, "*rows numbers"]:
        """The inverse of `standardise`."""
        return np.asarray(rows * self.std + self.mean, dtype=np.float32)


def check_statistics(statistics: Statistics, num_joints: int, expected: Signature) -> None:
    """Raise `ValueError` unless statistics have the expected signature.

    `published` is Mean.npy and Std.npy of HumanML3D and KIT; `evaluator` is that of Guo's evaluators, with root and
    contacts weighted 25-fold. Both have one std per block; the ratio of root speed to joint speed distinguishes them.
    The wrong file changes every FID without an error, so nothing is guessed.
    """
    layout = layout_of(num_joints).vector
    if statistics.mean.size != layout.size:
        raise ValueError(
            f"vectors of {num_joints} joints have {layout.size} numbers, these have {statistics.mean.size}"
        )
    uneven = [block for block in layout.blocks if np.ptp(statistics.std[block]) > 1e-4 * statistics.std[block].mean()]
    if uneven:
        raise ValueError(
            f"the std varies inside numbers {uneven[0].start} to {uneven[0].stop - 1}, so this is not a file of "
            "HumanML3D's convention, which has one std per block"
        )
    ratio = float(statistics.std[layout.root_velocity].mean() / statistics.std[layout.joint_velocities].mean())
    signature: Signature = "published" if ratio > _ROOT_TO_JOINT_SPEED else "evaluator"
    if signature != expected:
        raise ValueError(
            f"these are {signature} statistics (std of root speed is {ratio:.3f} of the joints'), but {expected} ones "
            "are needed: the evaluator's weight root and contacts 25 times as much as Std.npy does"
        )
