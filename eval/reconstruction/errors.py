"""A reconstructed window's errors, and the table cells that windows make together."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

from eval.report.results import Cell

if TYPE_CHECKING:
    from eval.reconstruction.windows import Reconstruction

GLOBAL = "global MPJPE, mm"
DISTANCE = "L2 norm of the whole vector"
COUNT = "windows"


@dataclass(frozen=True)
class WindowErrors:
    """Root-aligned and global MPJPE in millimetres; MRE and mean distance of `native` vectors in their raw units."""

    aligned_mm: float
    global_mm: float
    mre: float
    vector_distance: float
    seconds: float


def window_errors(window: "Reconstruction", fps: Fraction) -> WindowErrors:
    """The errors of one window that was decoded at `fps`."""
    from eval.metrics.reconstruction import mean_vector_distance, mpjpe_global, mpjpe_root_aligned, mre
    from motionkit.features.native import vectors

    found, truth = (vectors(positions, "smpl22", fps) for positions in (window.found, window.truth))
    return WindowErrors(
        aligned_mm=1000.0 * mpjpe_root_aligned(window.found, window.truth),
        global_mm=1000.0 * mpjpe_global(window.found, window.truth),
        mre=mre(found, truth),
        vector_distance=mean_vector_distance(found, truth),
        seconds=window.seconds,
    )


def mpjpe_cell(windows: Sequence[WindowErrors]) -> Cell | None:
    """Root-aligned MPJPE in millimetres, windows weighing by duration; None where there is no window."""
    if not windows:
        return None
    aligned = _mean(windows, (window.aligned_mm for window in windows))
    whole = _mean(windows, (window.global_mm for window in windows))
    return Cell(aligned, None, {GLOBAL: whole, COUNT: float(len(windows))})


def mre_cell(windows: Sequence[WindowErrors]) -> Cell | None:
    """MRE of `native` vectors, windows weighing by duration; None where there is no window."""
    if not windows:
        return None
    distance = _mean(windows, (window.vector_distance for window in windows))
    return Cell(_mean(windows, (window.mre for window in windows)), None, {DISTANCE: distance})


def _mean(windows: Sequence[WindowErrors], values: Iterable[float]) -> float:
    seconds = sum(window.seconds for window in windows)
    return sum(window.seconds * value for window, value in zip(windows, values, strict=True)) / seconds
