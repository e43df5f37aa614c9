"""The published evaluators of text-to-motion: networks, statistics, and their files.

Guo et al. 2022 trained one on HumanML3D and one on KIT; MARDM (Meng et al. 2024) retrained the same networks on the
numbers that a model generates. The movement encoder's input size distinguishes the four.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError, MotionkitError
from motionkit.core.shapes import Float64
from motionkit.features.layout import pose_layout
from motionkit.features.statistics import Statistics, check_statistics
from motionkit.io import npy, source_file
from motionkit.io.humanml3d import KIT

STATISTICS_NAMES = (("mean.npy", "std.npy"), ("eval_mean.npy", "eval_std.npy"))
SIGNATURE_TOLERANCE = 0.01
"""Relative: Std.npy divided by 25 is within 0.4 % of the evaluator's; Mean.npy's root height is 2.3 % from it."""


class GuoError(MotionkitError):
    """Files that are not a published evaluator's, or invalid motions and captions."""


@dataclass(frozen=True)
class GuoKind:
    """A published evaluator that reads the first `num_inputs` numbers of a `layout`'s pose vector at `fps`.

    `statistics_name` is MDM's name of the data set in its copies of the files. `root_height` is the mean of the root's
    height, `block_std` the std of each of the vector's blocks, in the files that belong to these weights.
    """

    name: str
    dataset: str
    statistics_name: str
    layout: str
    fps: Fraction
    num_inputs: int
    num_statistics: int
    root_height: float
    block_std: tuple[float, ...]

    @property
    def vector_size(self) -> int:
        """Size of a whole pose vector."""
        return pose_layout(self.layout).vector.size

    @property
    def unit_metres(self) -> float:
        """The length unit of the data set's files in metres: 1, or a thousandth of KIT-ML's body of 1.7 m."""
        return KIT.unit_metres if self.layout == KIT.skeleton.name else 1.0

    @property
    def is_weighted(self) -> bool:
        """Whether root and contacts weigh 25 times as much as in the data set's own Std.npy."""
        return self.name == "guo"


# Sizes: text-to-motion, evaluator_wrapper.py; MARDM, utils/evaluators.py. Figures: the files of text-to-motion's
# checkpoints (Comp_v6_KLD01/meta, Comp_v6_KLD005/meta) and MARDM's utils/eval_mean_std.
KINDS: Mapping[int, GuoKind] = {
    kind.num_inputs: kind
    for kind in (
        GuoKind(
            *("guo", "HumanML3D", "t2m", "smpl22", Fraction(20), 259, 263, 0.91752),
            (5.1467e-4, 6.7693e-4, 6.1208e-3, 0.122555, 0.300386, 0.0195406, 0.0140949),
        ),
        GuoKind(
            *("guo", "KIT", "kit", "kit21", Fraction(25, 2), 247, 251, 559.62),
            (9.9157e-4, 1.172767, 4.58643, 93.6202, 0.342471, 29.1116, 5.26644e-3),
        ),
        GuoKind(
            *("mardm", "HumanML3D", "t2m", "smpl22", Fraction(20), 67, 67, 0.93862),
            (0.01283, 0.01693, 0.15378, 0.12224),
        ),
        GuoKind(
            *("mardm", "KIT", "kit", "kit21", Fraction(25, 2), 64, 64, 559.62),
            (0.02479, 29.3192, 114.661, 93.6202),
        ),
    )
}


def read_statistics(folder: Path, kind: GuoKind) -> Statistics:
    """mean.npy and std.npy that belong to an evaluator's weights.

    Raises `GuoError` if they are missing, of another size, or of another convention: a wrong file changes every
    number without any other error, so nothing is guessed or repaired.
    """
    names = (*STATISTICS_NAMES, (f"{kind.statistics_name}_mean.npy", f"{kind.statistics_name}_std.npy"))
    found = next((pair for pair in names if all((folder / name).is_file() for name in pair)), None)
    if found is None:
        expected = ", or ".join(" and ".join(pair) for pair in names)
        raise GuoError(f"{folder}: there is no {expected}; they come with the evaluator (docs/evaluators.md)")
    mean, std = (_read_array(folder / name, kind.num_statistics) for name in found)
    try:
        statistics = Statistics("humanml3d", mean, std)
        if kind.is_weighted:
            check_statistics(statistics, pose_layout(kind.layout).num_joints, "evaluator")
    except ValueError as error:
        raise GuoError(f"{folder}: {error}") from None
    _check_signature(statistics, kind, folder)
    return statistics


def _read_array(path: Path, size: int) -> Float64[np.ndarray, "numbers"]:
    try:
        return npy.parse_npy(path, source_file.read_bytes(path), (size,)).astype(np.float64)
    except FormatError as error:
        raise GuoError(str(error)) from None


def _check_signature(found: Statistics, kind: GuoKind, folder: Path) -> None:
    part = pose_layout(kind.layout).vector
    height = float(found.mean[part.root_height].item())
    if abs(height - kind.root_height) > SIGNATURE_TOLERANCE * kind.root_height:
        raise GuoError(
            f"{folder}: the mean root height is {height:.4f}, {kind.root_height:.4f} in the statistics that belong to "
            f"{_title(kind)}; this mean is another file's, such as the data set's own Mean.npy"
        )
    for block, expected in zip(part.blocks, kind.block_std, strict=False):
        std = found.std[block]
        if np.abs(std - expected).max() > SIGNATURE_TOLERANCE * expected:
            raise GuoError(
                f"{folder}: the std of numbers {block.start} to {block.stop - 1} is {std.mean():.3g}, {expected:.3g} "
                f"in the statistics that belong to {_title(kind)}"
            )


def _title(kind: GuoKind) -> str:
    return f"the {kind.name} evaluator of {kind.dataset}"


@dataclass(frozen=True)
class GuoFiles:
    """What `eval.text_motion.guo.evaluator.load_guo` loads: `statistics` None means those beside the weights."""

    weights: Path
    glove: Path | None = None
    statistics: Path | None = None
