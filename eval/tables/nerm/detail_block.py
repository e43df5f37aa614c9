"""The detail profile of a column's rows, as a block of a table."""

from collections.abc import Mapping

from eval.detail import LEAST_FPS, VERSION, Figure, RealDetail
from eval.report.results import Block, Cell, Origin, Row
from eval.sets.row_ids import RowId
from eval.tables.nerm.clip_fid_column import P1, REFERENCES, TRAINING, Column

LOWEST, HIGHEST = "real takes, lowest (2.5 %)", "real takes, highest (97.5 %)"
OUTSIDE = "*"
NOTE = (
    "T: how far power at 12 to 27 Hz comes when slow motion predicts, as a share of real motion's. Hz: power in that "
    "band, in dB relative to real motion's. R: change of bone lengths > 8 Hz, in mm. Read each by itself, none is a "
    f"score. The first two rows are the range of random halves of the real takes beside the other halves; {OUTSIDE} "
    "marks what lies outside of it (of R, only what lies above: bones of a body do not change). Intervals over takes "
    "are in the JSON."
)


def detail_block(column: Column, notes: Mapping[RowId, str], seed: int) -> Block | None:
    """The profile of every row of a column of at least 40 fps; None for a slower one, or without training motion."""
    if column.fps < LEAST_FPS or column.train is None:
        return None
    real = RealDetail.of(column.real, column.train, seed)
    profiles = {row: real.profile(samples).figures for row, samples in column.rows.items() if row != P1}
    names = tuple(real.profile(column.real).figures)
    rows = []
    if real.ranges is not None:
        for name, bounds in zip((LOWEST, HIGHEST), real.ranges.tolist(), strict=True):
            rows.append(Row(name, "reference", dict(zip(names, map(Cell, bounds), strict=True))))
    for row, figures in profiles.items():
        origin: Origin = "reference" if row in REFERENCES else "ours"
        note = "all of them" if row == TRAINING else notes.get(row, "")
        rows.append(Row(str(row), origin, {name: _cell(figure) for name, figure in figures.items()}, note))
    return Block(
        f"Detail profile, {column.label}",
        names,
        tuple(rows),
        note=f"{NOTE} Real motion keeps {real.real_slope:.2f} of the slope that the prediction was fitted with.",
        provenance={"version": VERSION, "real_slope": real.real_slope},
    )


def _cell(figure: Figure) -> Cell:
    low, high = figure.interval
    interval = {"2.5 % over takes": low, "97.5 % over takes": high}
    return Cell(figure.value, details=interval, mark="" if figure.is_real else OUTSIDE)
