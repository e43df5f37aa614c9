"""NeRM's Table 4: how well an encoder reconstructs windows of motion at 20, 40, 60, 100 and 120 fps.

The ground truth at s fps is the capture, low-passed and downsampled if its framerate is higher; sequences slower than s
have none and are left out.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial

import numpy as np

from eval.metrics.motion import mean_vector_distance, mpjpe_global, mpjpe_root_aligned, mre
from eval.report.results import Block, Cell, Row, measure
from eval.tables.systems import COLUMNS, label, reconstructor, trained_reconstructors
from eval.tables.table import Content, EvalConfig, Table, printed_block, reported_figures
from motionkit.core.errors import UsageError
from motionkit.core.mirror import mirror_positions
from motionkit.core.shapes import Bool, Float32, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.data.reconstruction import ReconstructsWindows
from motionkit.data.windows import Windows
from motionkit.edit.encoders import installed_encoders
from motionkit.features import field
from motionkit.features.native import vectors
from motionkit.fields.motion_field import MotionField, to_motion
from motionkit.fields.resample import resample_positions
from motionkit.store.cache import PositionCache
from motionkit.store.reader import Store

VERSION = "reconstruction/2"
TRAINING, HELD_OUT = "training windows", "held-out windows"
MOST_WINDOWS = 384
GLOBAL = "global MPJPE, mm"
DISTANCE = "L2 norm of the whole vector"
COUNT = "windows"


def window_truth(
    source: PositionCache, windows: Windows, row: int, fps: Fraction
) -> Float32[np.ndarray, "poses joints 3"]:
    """A window's own capture at `fps` (not above its native framerate), in the window's frame; metres."""
    start, count = int(windows.start_row[row]), int(windows.num_frames[row])
    positions = np.asarray(source.positions[start : start + count])
    if windows.mirrored[row]:
        positions = mirror_positions(positions, SMPL22.left_right_pairs)
    sampled = resample_positions(positions, windows.exact_fps(row), fps)
    chosen = slice(row, row + 1)
    return np.asarray(field.to_window(sampled[None], windows.yaw[chosen], windows.origin[chosen])[0])


def separate_windows(windows: Windows) -> Int64[np.ndarray, "chosen"]:
    """Rows of windows that do not overlap and are not mirrored: each sequence's first, then the next free one, …"""
    originals = np.flatnonzero(~windows.mirrored)
    order = originals[np.lexsort((windows.start_frame[originals], windows.sequence_index[originals]))]
    chosen: list[int] = []
    sequence, free_from = -1, 0
    for row in order.tolist():
        start = int(windows.start_frame[row])
        if windows.sequence_index[row] != sequence:
            sequence, free_from = int(windows.sequence_index[row]), 0
        # Neighbours share the frame at which one ends and the next begins.
        if start >= free_from:
            chosen.append(row)
            free_from = start + int(windows.num_frames[row]) - 1
    return np.array(chosen, dtype=np.int64)


def comparable(windows: Windows, rates: Sequence[Fraction]) -> Bool[np.ndarray, "windows"]:
    """Mask of windows with a ground truth at every one of the framerates."""
    return np.asarray(windows.fps >= float(max(rates)) - 1e-6)


@dataclass(frozen=True)
class WindowErrors:
    """Root-aligned and global MPJPE in millimetres; MRE and mean distance of `native` vectors in their raw units."""

    aligned_mm: float
    global_mm: float
    mre: float
    vector_distance: float
    seconds: float


def window_errors(
    decoded: Float32[np.ndarray, "poses joints 3"],
    truth: Float32[np.ndarray, "poses joints 3"],
    fps: Fraction,
    seconds: float,
) -> WindowErrors:
    """The errors of one window of some seconds, decoded at `fps`; both in the window's frame, metres."""
    found, expected = (vectors(positions, "smpl22", fps) for positions in (decoded, truth))
    return WindowErrors(
        aligned_mm=1000.0 * mpjpe_root_aligned(decoded, truth),
        global_mm=1000.0 * mpjpe_global(decoded, truth),
        mre=mre(found, expected),
        vector_distance=mean_vector_distance(found, expected),
        seconds=seconds,
    )


def _mean(windows: Sequence[WindowErrors], values: Iterable[float]) -> float:
    seconds = sum(window.seconds for window in windows)
    return sum(window.seconds * value for window, value in zip(windows, values, strict=True)) / seconds


def mpjpe_cell(windows: Sequence[WindowErrors]) -> Cell:
    """Root-aligned MPJPE in millimetres, windows weighing by duration."""
    aligned = _mean(windows, (window.aligned_mm for window in windows))
    whole = _mean(windows, (window.global_mm for window in windows))
    return Cell(aligned, None, {GLOBAL: whole, COUNT: float(len(windows))})


def mre_cell(windows: Sequence[WindowErrors]) -> Cell:
    """MRE of `native` vectors, windows weighing by duration."""
    distance = _mean(windows, (window.vector_distance for window in windows))
    return Cell(_mean(windows, (window.mre for window in windows)), None, {DISTANCE: distance})


@dataclass(frozen=True, eq=False)
class Reconstructed:
    """Windows of a source, each with a model's reconstruction: a motion field in the window's own frame."""

    source: PositionCache
    windows: Windows
    fields: Sequence[MotionField]
    described: str

    def errors(self, fps: Fraction) -> dict[int, WindowErrors]:
        """The errors at a framerate by the window's row; windows without a ground truth have none."""
        found = {}
        for row in np.flatnonzero(comparable(self.windows, [fps])).tolist():
            truth = window_truth(self.source, self.windows, row, fps)
            decoded = to_motion(self.fields[row], fps).joint_positions[:, : truth.shape[1]]
            found[row] = window_errors(decoded, truth, fps, float(self.windows.duration_seconds[row]))
        return found


def reconstructed_windows(
    encoder: ReconstructsWindows, store: Store, config: EvalConfig, rates: Sequence[Fraction]
) -> dict[str, Reconstructed]:
    """Samples of the windows that an encoder was trained on, and of another split's if there are any.

    Of each at most `MOST_WINDOWS` random ones; those fast enough for all framerates come first.
    """
    sources = {TRAINING: encoder.training_windows(store)}
    with config.missing.skipping(HELD_OUT, (UsageError,)):
        if config.split in ("all", "train"):
            raise UsageError(f"split {config.split!r} holds training windows; name another (--split test)")
        sources[HELD_OUT] = encoder.other_windows(store, config.condition)
    found = {}
    for name, each in sources.items():
        shuffled = np.random.default_rng(config.seed).permutation(separate_windows(each.windows))
        fast = comparable(each.windows, rates)[shuffled]
        first_fast = np.concatenate((shuffled[fast], shuffled[~fast]))
        rows = np.sort(first_fast[: min(MOST_WINDOWS, config.max_motions)])
        found[name] = Reconstructed(each.source, each.windows.select(rows), each.fields(rows), each.described)
    return found


SAME, EVERY = "takes fast enough for every column", "all takes at least as fast as the column"
CELLS = {"MPJPE in mm": mpjpe_cell, "MRE": mre_cell}
METRICS = {"MPJPE in mm": measure("mpjpe", unit="mm"), "MRE": measure("mre")}
SHOWN = (("MPJPE in mm", SAME), ("MPJPE in mm", EVERY), ("MRE", SAME))


def compute(config: EvalConfig, store: Store) -> Content:
    """MPJPE and MRE of training and of held-out windows by framerate.

    Raises `UsageError` without a run or with a run of another store, and as loading the run.
    """
    if config.run is None:
        raise UsageError("table 4 needs a trained model that reconstructs windows of motion: --run NAME")
    rates = config.fps or COLUMNS
    rows: dict[tuple[str, str], list[Row]] = {shown: [] for shown in SHOWN}
    for name, trained in trained_reconstructors(config.run).items():
        for which, sample in reconstructed_windows(reconstructor(trained, store), store, config, rates).items():
            row = f"{name}: {which}, {sample.described}"
            errors = {fps: sample.errors(fps) for fps in rates}
            config.missing.add(*(f"{row}, {label(fps)}: no take is that fast" for fps in rates if not errors[fps]))
            at_all = set(np.flatnonzero(comparable(sample.windows, rates)).tolist())
            for error, windows in SHOWN:
                cells: dict[str, Cell] = {}
                for fps in rates:
                    if chosen := [each for index, each in errors[fps].items() if windows == EVERY or index in at_all]:
                        cells[label(fps)] = CELLS[error](chosen)
                rows[error, windows] += [Row(row, "ours", cells)] if cells else []
    same, every, mre = (
        Block(f"{error}, {windows}", tuple(map(label, rates)), tuple(found), metrics=(METRICS[error],))
        for (error, windows), found in rows.items()
    )
    printed_mpjpe, printed_mre = (
        printed_block(
            f"{metric} printed in the NeRM paper (HumanML3D{units})",
            [figure for figure in reported_figures("nerm", "4") if figure.metric == name],
            lambda figure: label(figure.setting),
            factor=factor,
            note="100 sequences of another data set; the paper does not say if they were trained on.",
        )
        for metric, name, units, factor in (
            ("MPJPE", "mpjpe_m", "; metres there, millimetres here", 1000.0),
            ("MRE", "mre", "", 1.0),
        )
    )
    return Content(
        caption=(
            "Root-aligned mean per-joint position error in millimetres over 22 joints, windows weighing by duration. "
            f"Held-out windows are of {config.real}."
        ),
        blocks=(same, every, printed_mpjpe, mre, printed_mre),
        definition={"most_windows": MOST_WINDOWS, "held_out_sequences": config.condition},
    )


TABLE = Table(
    "nerm",
    "4",
    "reconstruction MPJPE and MRE by framerate",
    VERSION,
    compute,
    heading="Table 4: reconstruction by framerate",
    takes_samples=False,
    shown=partial(installed_encoders, "reconstruction"),
)
