"""A result whose columns are framerates, as panels of curves."""

import re

from eval.report.figures import Curve, Panel
from eval.report.results import Block, Result, Row

FRAMERATE = r"\d+(\.\d+)? fps"


def panels_of(result: Result, y_label: str = "lower is better") -> tuple[Panel, ...]:
    """One panel per block, for numbers of different blocks can't be compared; ours first, the paper's after them.

    `y_label` is that of the blocks in which lower is better; others have none. Blocks with a column that is no
    framerate ("120 fps") are left out.
    """
    ordered = sorted(filter(_is_by_framerate, result.blocks), key=_is_from_paper)
    panels = (Panel(block.title, y_label if block.lower_is_better else "", _curves(block)) for block in ordered)
    return tuple(panel for panel in panels if panel.curves)


def _is_by_framerate(block: Block) -> bool:
    return all(re.fullmatch(FRAMERATE, column) for column in block.columns)


def _is_from_paper(block: Block) -> bool:
    return all(row.origin == "paper" for row in block.rows)


def _curves(block: Block) -> tuple[Curve, ...]:
    return tuple(_curve(row, block.columns) for row in block.rows if row.cells)


def _curve(row: Row, columns: tuple[str, ...]) -> Curve:
    present = [column for column in columns if column in row.cells]
    cells = [row.cells[column] for column in present]
    return Curve(
        label=row.name.removesuffix(" (paper)"),
        fps=tuple(_fps(column) for column in present),
        values=tuple(cell.value for cell in cells),
        half_widths=tuple(cell.ci95 or 0.0 for cell in cells),
    )


def _fps(column: str) -> float:
    return float(column.removesuffix(" fps"))
