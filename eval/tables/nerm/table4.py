"""NeRM's Table 4: how well the first stage reconstructs motions at 20, 40, 60, 100 and 120 fps."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from eval.reconstruction.errors import WindowErrors, mpjpe_cell, mre_cell, window_errors
from eval.reconstruction.windows import Reconstruction, comparable, reconstructions, separate_windows
from eval.report.results import Block, Cell, Result, Row, measure
from eval.sets.partial import PartialResult
from eval.tables.models import reconstructor, trained_reconstructors
from eval.tables.parts import printed_rows, reported_figures
from eval.tables.registry import Table, TableRequest
from motionkit.core.errors import UsageError
from motionkit.core.shapes import Int64
from motionkit.data.reconstruction import ModelWindows, ReconstructsWindows
from motionkit.data.windows import PositionSource, Windows
from motionkit.edit.encoders import installed_encoders
from motionkit.fields.motion_field import MotionField

if TYPE_CHECKING:
    from motionkit.store.reader import Store

VERSION = "reconstruction/2"
COLUMNS = tuple(Fraction(rate) for rate in (20, 40, 60, 100, 120))
TRAINING, HELD_OUT = "training windows", "held-out windows"
MOST_WINDOWS = 384
PAPER_NOTE = "100 sequences of another data set; the paper says neither if they were in training nor what is aligned."


@dataclass(frozen=True, eq=False)
class DescribedWindows:
    """Windows of a source, each with a model's reconstruction: a motion field in the window's own frame."""

    source: PositionSource
    windows: Windows
    fields: Sequence[MotionField]
    described: str

    def reconstructed(self, rows: Int64[np.ndarray, "chosen"], fps: Fraction) -> Iterator[Reconstruction]:
        """Some of the windows with their ground truth at a framerate."""
        return reconstructions(self.source, self.windows.select(rows), [self.fields[row] for row in rows], fps)


@dataclass(frozen=True, eq=False)
class _Measured:
    """The errors of windows at each framerate, and which windows have a ground truth at all of them."""

    errors: dict[Fraction, dict[int, WindowErrors]]
    comparable: frozenset[int]

    def at(self, fps: Fraction, *, same: bool) -> list[WindowErrors]:
        """Errors at one framerate, of all windows with a ground truth, or of the same windows at every framerate."""
        return [error for row, error in self.errors[fps].items() if row in self.comparable or not same]


def build_table4(request: TableRequest) -> Result:
    """MPJPE and MRE of training and of held-out windows by framerate.

    Raises `UsageError` without a run or with a run of another store, and as loading the run or the store.
    """
    if request.evaluated.run is None:
        raise UsageError("table 4 needs a trained model that reconstructs windows of motion: --run NAME")
    store = request.open_store()
    rates = request.fps or COLUMNS
    sets: dict[str, DescribedWindows] = {}
    missing: list[str] = []
    found = trained_reconstructors(request.evaluated.run)
    for name, trained in found.items():
        each = described_windows(reconstructor(trained, store), store, request)
        sets |= {f"{name}: {which}, {some.described}": some for which, some in each.value.items()}
        missing += each.missing
    measured = {name: _measure(each, rates) for name, each in sets.items()}
    for name, errors in ((name, each.errors) for name, each in measured.items()):
        missing += [f"{name}, {_label(fps)}: no take is that fast" for fps in errors if not errors[fps]]
    blocks = (
        _block("MPJPE in mm, takes fast enough for every column", measured, rates, mpjpe_cell, same=True),
        _block("MPJPE in mm, all takes at least as fast as the column", measured, rates, mpjpe_cell, same=False),
        _paper_block("MPJPE printed in the NeRM paper (HumanML3D; metres there, millimetres here)", "mpjpe_m", 1000.0),
        _block("MRE, takes fast enough for every column", measured, rates, mre_cell, same=True),
        _paper_block("MRE printed in the NeRM paper (HumanML3D)", "mre", 1.0),
    )
    return Result(
        task="nerm-table4",
        version=VERSION,
        title="Table 4: reconstruction by framerate",
        caption=(
            "Root-aligned mean per-joint position error in millimetres over 22 joints, windows weighing by duration. "
            f"Held-out windows are of {request.real.named}."
        ),
        blocks=tuple(block for block in blocks if block.rows),
        definition={
            "truth": "the capture, brought down band-limited to the column's framerate; slower takes are left out",
            "root-aligned": "both roots at the origin, no rotation fitted; the root counts as a joint with error 0",
            "training windows": "do not overlap, not mirrored; decoded from the posterior mean, not fitted again",
            "sample": f"at most {MOST_WINDOWS} windows a row, those fast enough for every column first",
            "held-out sequences": request.real.condition,
            "held-out windows": "z by L-BFGS on evenly spaced native poses against the frozen field",
            "MRE": "root of the mean squared difference of `native` pose vectors (263 numbers; m, m/s, rad/s)",
        },
        notes=(
            "The global error of every cell is in its details.",
            "The paper words MRE as the Euclidean distance of two vectors, which its figures cannot be (a distance of "
            "0.041 does not leave room for an MPJPE of 0.016); that distance is in the details. Vectors hold "
            "velocities, so capture noise counts, the more the higher the framerate.",
        ),
        missing=tuple(missing),
        provenance=request.provenance(store, run=request.evaluated.run.name),
    )


TABLE = Table(
    "nerm",
    "4",
    "reconstruction MPJPE and MRE by framerate",
    build_table4,
    takes_samples=False,
    shown=partial(installed_encoders, "reconstruction"),
)


def described_windows(
    encoder: ReconstructsWindows, store: "Store", request: TableRequest
) -> PartialResult[dict[str, DescribedWindows]]:
    """Samples of the windows that an encoder was trained on, and of another split's if there are any."""
    found = {TRAINING: _described(encoder.training_windows(store), request)}
    try:
        if request.real.split in ("all", "train"):
            raise UsageError(f"split {request.real.split!r} holds training windows; name another (--split test)")
        found[HELD_OUT] = _described(encoder.other_windows(store, request.real.condition), request)
    except UsageError as error:
        return PartialResult(found, (f"{HELD_OUT}: {error}",))
    return PartialResult(found)


def _described(windows: ModelWindows, request: TableRequest) -> DescribedWindows:
    rows = _sample(separate_windows(windows.windows), windows.windows, request)
    return DescribedWindows(windows.source, windows.windows.select(rows), windows.fields(rows), windows.described)


def _sample(rows: Int64[np.ndarray, "windows"], windows: Windows, request: TableRequest) -> Int64[np.ndarray, "chosen"]:
    """At most `MOST_WINDOWS` random rows, in order; those with a sufficient framerate for every column come first."""
    shuffled = np.random.default_rng(request.seed).permutation(rows)
    fast = comparable(windows, request.fps or COLUMNS)[shuffled]
    first_fast = np.concatenate((shuffled[fast], shuffled[~fast]))
    return np.sort(first_fast[: min(MOST_WINDOWS, request.evaluated.max_motions)])


def _measure(described: DescribedWindows, rates: Sequence[Fraction]) -> _Measured:
    errors: dict[Fraction, dict[int, WindowErrors]] = {}
    for fps in rates:
        rows = np.flatnonzero(comparable(described.windows, [fps]))
        found = described.reconstructed(rows, fps)
        errors[fps] = {int(row): window_errors(window, fps) for row, window in zip(rows, found, strict=True)}
    return _Measured(errors, frozenset(np.flatnonzero(comparable(described.windows, rates)).tolist()))


def _block(
    title: str,
    measured: dict[str, _Measured],
    rates: Sequence[Fraction],
    cell_of: Callable[[Sequence[WindowErrors]], Cell | None],
    *,
    same: bool,
) -> Block:
    rows = []
    for name, each in measured.items():
        cells = {_label(fps): cell_of(each.at(fps, same=same)) for fps in rates}
        found = {label: cell for label, cell in cells.items() if cell is not None}
        if found:
            rows.append(Row(name, "ours", found))
    return Block(
        title,
        tuple(_label(fps) for fps in rates),
        tuple(rows),
        metrics=(measure("mpjpe", unit="mm") if cell_of is mpjpe_cell else measure("mre"),),
    )


def _paper_block(title: str, metric: str, factor: float) -> Block:
    figures = [figure for figure in reported_figures("nerm", "4") if figure.metric == metric]
    return Block(
        title=title,
        columns=tuple(dict.fromkeys(_label(figure.setting) for figure in figures)),
        rows=printed_rows(figures, lambda figure: _label(figure.setting), factor=factor),
        note=PAPER_NOTE,
    )


def _label(fps: Fraction | str) -> str:
    return f"{str(fps).removesuffix('fps').strip()} fps"
