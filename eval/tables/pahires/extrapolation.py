"""Extrapolation: a second of motion continued, forwards and backwards; baselines are zero and constant velocity."""

from dataclasses import replace
from functools import partial

from eval.completion.encoders import HOLD, INTERPOLATION
from eval.completion.protocol import EXTRAPOLATION_VERSION, continuations
from eval.report.results import Result
from eval.tables.pahires.inbetweening import definition
from eval.tables.pahires.window_rows import WindowTable, measure_table
from eval.tables.registry import Table, TableRequest
from motionkit.edit.encoders import installed_encoders

SLERP = next(row for row in INTERPOLATION if row.name == "SLERP")
ROWS = (
    replace(HOLD, name="zero velocity", note="the nearest given pose"),
    replace(
        SLERP,
        name="constant velocity",
        note="joints go on turning as between the last two given poses, the root moving",
    ),
)
METRICS = {"mpjpe_global": "MPJPE (cm)", "l2p": "L2P", "l2q": "L2Q", "npss": "NPSS"}


def build_extrapolation(request: TableRequest) -> Result:
    """Rows of every data set at 30 fps that the store holds; raises as `build_inbetweening`."""
    table = WindowTable("extrapolation", EXTRAPOLATION_VERSION, continuations(), METRICS, {}, ROWS, "extrapolation")
    found = measure_table(table, request)
    return Result(
        task="pahires-extrapolation",
        version=EXTRAPOLATION_VERSION,
        title="PA-HiRes: extrapolation",
        caption=(
            "30 frames (one second) are given, the n frames after or before them asked for and scored; windows and "
            f"statistics of the in-betweening table. S{request.real.named[1:]}: " + " ".join(found.remarks)
        ),
        blocks=found.blocks,
        definition={**definition(request), "given": "frames 0-29 of a window for what comes after, 30-59 for before"},
        notes=(
            "± is half the 95 % interval over takes: all windows of a take are resampled together.",
            "The paper shows extrapolation in pictures alone and prints no figures.",
            "What people do next is not in what they did: an error that grows slowly says that a row does not drift, "
            "not that it foresees.",
        ),
        missing=found.missing,
        provenance=found.provenance,
    )


TABLE = Table(
    "pahires",
    "extrapolation",
    "extrapolation, forwards and backwards",
    build_extrapolation,
    shown=partial(installed_encoders, "extrapolation"),
)
