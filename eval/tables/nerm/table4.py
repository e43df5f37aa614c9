"""NeRM's Table 4: how well the first stage reconstructs motions at 20, 40, 60, 100 and 120 fps."""

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import partial

import numpy as np

from eval.config import EvalConfig
from eval.reconstruction import MOST_WINDOWS, WindowErrors, comparable, described_windows, mpjpe_cell, mre_cell
from eval.report.results import Block, Cell, Row, measure
from eval.tables.columns import COLUMNS, label
from eval.tables.models import reconstructor, trained_reconstructors
from eval.tables.runs import RECONSTRUCTION_VERSION
from eval.tables.table import Content, Table, printed_block, reported_figures
from motionkit.core.errors import UsageError
from motionkit.edit.encoders import installed_encoders
from motionkit.store.reader import Store

PAPER_NOTE = "100 sequences of another data set; the paper says neither if they were in training nor what is aligned."

# A row's windows: their errors by framerate and row, and which of them have a ground truth at all framerates.
_Errors = tuple[dict[Fraction, dict[int, WindowErrors]], set[int]]


def compute(config: EvalConfig, store: Store) -> Content:
    """MPJPE and MRE of training and of held-out windows by framerate.

    Raises `UsageError` without a run or with a run of another store, and as loading the run.
    """
    if config.run is None:
        raise UsageError("table 4 needs a trained model that reconstructs windows of motion: --run NAME")
    rates = config.fps or COLUMNS
    rows: dict[str, _Errors] = {}
    for name, trained in trained_reconstructors(config.run).items():
        samples = described_windows(reconstructor(trained, store), store, config, rates, config.missing)
        for which, sample in samples.items():
            row, every = f"{name}: {which}, {sample.described}", np.arange(len(sample.windows))
            errors = {fps: sample.errors(every, fps) for fps in rates}
            config.missing.add(*(f"{row}, {label(fps)}: no take is that fast" for fps in rates if not errors[fps]))
            rows[row] = errors, set(np.flatnonzero(comparable(sample.windows, rates)).tolist())
    return Content(
        caption=(
            "Root-aligned mean per-joint position error in millimetres over 22 joints, windows weighing by duration. "
            f"Held-out windows are of {config.real}."
        ),
        blocks=(
            _block("MPJPE in mm, takes fast enough for every column", rows, rates, mpjpe_cell, same=True),
            _block("MPJPE in mm, all takes at least as fast as the column", rows, rates, mpjpe_cell, same=False),
            _printed("MPJPE printed in the NeRM paper (HumanML3D; metres there, millimetres here)", "mpjpe_m", 1000.0),
            _block("MRE, takes fast enough for every column", rows, rates, mre_cell, same=True),
            _printed("MRE printed in the NeRM paper (HumanML3D)", "mre", 1.0),
        ),
        definition={"most_windows": MOST_WINDOWS, "held_out_sequences": config.condition},
        notes=(
            "The global error of every cell is in its details.",
            "The paper words MRE as the Euclidean distance of two vectors, which its figures cannot be (a distance of "
            "0.041 does not leave room for an MPJPE of 0.016); that distance is in the details. Vectors hold "
            "velocities, so capture noise counts, the more the higher the framerate.",
        ),
    )


TABLE = Table(
    "nerm",
    "4",
    "reconstruction MPJPE and MRE by framerate",
    RECONSTRUCTION_VERSION,
    compute,
    heading="Table 4: reconstruction by framerate",
    takes_samples=False,
    shown=partial(installed_encoders, "reconstruction"),
)


def _block(
    title: str,
    rows: dict[str, _Errors],
    rates: Sequence[Fraction],
    mean: Callable[[Sequence[WindowErrors]], Cell | None],
    *,
    same: bool,
) -> Block:
    """Means over all windows with a ground truth, or over the same windows at every framerate."""
    found = []
    for name, (errors, at_all) in rows.items():
        cells = {
            label(fps): mean([error for row, error in errors[fps].items() if row in at_all or not same])
            for fps in rates
        }
        if known := {column: cell for column, cell in cells.items() if cell is not None}:
            found.append(Row(name, "ours", known))
    metric = measure("mpjpe", unit="mm") if mean is mpjpe_cell else measure("mre")
    return Block(title, tuple(map(label, rates)), tuple(found), metrics=(metric,))


def _printed(title: str, metric: str, factor: float) -> Block:
    figures = [figure for figure in reported_figures("nerm", "4") if figure.metric == metric]
    return printed_block(title, figures, lambda figure: label(figure.setting), factor=factor, note=PAPER_NOTE)
