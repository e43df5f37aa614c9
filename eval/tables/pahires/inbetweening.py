"""PA-HiRes' Table 3: in-betweening by the protocol of LaFAN1's benchmark, on LaFAN1 and on any data set at 30 fps."""

from dataclasses import replace
from functools import partial

from eval.completion.encoders import INTERPOLATION
from eval.completion.lafan1_benchmark import (
    NUM_PAST_FRAMES,
    TEST_STEP_FRAMES,
    TEST_WINDOW_FRAMES,
    TRAIN_STEP_FRAMES,
    TRAIN_WINDOW_FRAMES,
)
from eval.completion.protocol import INBETWEENING_VERSION, gaps
from eval.report.results import Block, Cell, Result, Row
from eval.tables.pahires.window_rows import WindowTable, measure_table
from eval.tables.parts import SOURCES, Reported, reported_figures
from eval.tables.registry import Table, TableRequest
from motionkit.edit.encoders import installed_encoders

_NAMES = {"hold": "zero velocity", "SLERP": "interpolation (SLERP)"}
_NOTES = {"hold": "the last given pose", "SLERP": "the benchmark's own interpolation: local great arcs, root on a line"}
ROWS = tuple(
    replace(row, name=_NAMES.get(row.name, row.name), note=_NOTES.get(row.name, row.note)) for row in INTERPOLATION
)
METRICS = {"l2p": "L2P", "l2q": "L2Q", "npss": "NPSS"}
DETAILS = {"l2p": {"mpjpe_global": "MPJPE (cm)"}, "l2q": {"l2q_as_signed": "L2Q, signs as they come"}}
# Limitations of printed rows.
CAVEATS = {
    "MC-Trans": "its L2Q equals ERD-QV's digit for digit; its authors' own L2Q at 30 frames is 0.61",
    "NeMF": "its authors never published figures on LaFAN1",
}


def build_inbetweening(request: TableRequest) -> Result:
    """Rows of every data set at 30 fps that the store holds.

    Raises `NoTakesError` if there is none, `UsageError` for an unknown encoder, and as opening the store.
    """
    questions = gaps()
    table = WindowTable("inbetweening", INBETWEENING_VERSION, questions, METRICS, DETAILS, ROWS, "inbetweening")
    found = measure_table(table, request)
    columns = tuple(question.label for question in questions)
    return Result(
        task="pahires-table3",
        version=INBETWEENING_VERSION,
        title="PA-HiRes, Table 3: in-betweening",
        caption=(
            "10 past frames and the first future one are given, the n frames between them asked for and scored "
            f"(LaFAN1's protocol, 30 fps). S{request.real.named[1:]}: {' '.join(found.remarks)}"
        ),
        blocks=(*found.blocks, *_published(columns)),
        definition=definition(request),
        notes=(
            "± is half the 95 % interval over takes: all windows of a take are resampled together.",
            "Figures of one data set do not compare with another's: they are divided by its own deviations.",
            "The benchmark's own figures of zero velocity and interpolation have signs of quaternions as they come; "
            "that L2Q stands under further metrics.",
        ),
        missing=found.missing,
        provenance=found.provenance,
    )


TABLE = Table(
    "pahires",
    "3",
    "in-betweening (LaFAN1's protocol)",
    build_inbetweening,
    shown=partial(installed_encoders, "inbetweening"),
)


def definition(request: TableRequest) -> dict[str, object]:
    """All settings that the figures depend on."""
    return {
        "windows": f"{TEST_WINDOW_FRAMES} frames every {TEST_STEP_FRAMES}, start + window < frames of "
        f"the take; centred on their mean in x and z, frame {NUM_PAST_FRAMES - 1} facing +x",
        "statistics": f"deviations of global positions over training windows of {TRAIN_WINDOW_FRAMES} frames "
        f"every {TRAIN_STEP_FRAMES}",
        "bones": "those of the first training window's first frame, for the truth and for every row",
        "l2p": "mean over frames of the norm of all global positions' differences, each divided by its deviation",
        "l2q": "mean over frames of the norm of all global quaternions' differences, signs aligned joint by joint",
        "npss": "of global quaternions; power of the real part of the Fourier coefficients, weighted by the truth's",
        "LaFAN1": "subjects 1-4 train, subject 5 tests, whatever the store's split",
        "split": request.real.split,
        "where": request.real.where,
    }


def _published(columns: tuple[str, ...]) -> list[Block]:
    """Published figures for LaFAN1: the paper's, and those of the rows' own authors."""
    figures = [
        *reported_figures("pahires", "3"),
        *(
            figure
            for paper in ("lafan1", "delta-interp", "ts-former")
            for figure in reported_figures(paper, "benchmark")
        ),
    ]
    blocks = []
    for metric, title in METRICS.items():
        cells: dict[str, dict[str, Cell]] = {}
        for figure in figures:
            if figure.value is not None and figure.metric.removesuffix("_percent") == metric:
                percent = figure.metric.endswith("_percent")
                value = round(figure.value / 100, 6) if percent else figure.value
                cells.setdefault(_origin(figure), {})[figure.setting] = Cell(value)
        rows = tuple(
            Row(name, "paper", found, CAVEATS.get(name.partition(" (")[0], "")) for name, found in cells.items()
        )
        note = (
            "The PA-HiRes paper prints NPSS in percent; it stands here as it is elsewhere." if metric == "npss" else ""
        )
        blocks.append(Block(f"Printed for LaFAN1: {title}", columns, rows, note=note))
    sources = "; ".join(SOURCES[paper] for paper in ("pahires", "lafan1", "delta-interp", "ts-former"))
    return [*blocks[:-1], replace(blocks[-1], note=f"{blocks[-1].note} Sources: {sources}.")]


def _origin(figure: Reported) -> str:
    whose = {"pahires": "PA-HiRes paper", "lafan1": "benchmark"}.get(figure.paper, "its authors")
    return f"{figure.method} ({whose})"
