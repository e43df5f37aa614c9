"""NeRM's Table 4: how well the first stage reconstructs motions at 20, 40, 60, 100 and 120 fps."""

from functools import partial

import numpy as np

from eval.report.results import Block, Cell, Row, measure
from eval.tables.reconstruction import MOST_WINDOWS, VERSION, comparable, mpjpe_cell, mre_cell, reconstructed_windows
from eval.tables.systems import COLUMNS, label, reconstructor, trained_reconstructors
from eval.tables.table import Content, EvalConfig, Table, printed_block, reported_figures
from motionkit.core.errors import UsageError
from motionkit.edit.encoders import installed_encoders
from motionkit.store.reader import Store

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
    "reconstruction by framerate",
    VERSION,
    compute,
    takes_samples=False,
    shown=partial(installed_encoders, "reconstruction"),
)
