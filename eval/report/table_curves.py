"""A result whose columns are values of one quantity (framerates, scales, lengths, a setting), as panels of curves."""

import re

from eval.report.figures import FRAMERATE_LABEL, Curve, Panel
from eval.report.results import Block, Result, Row

# "120 fps", "×2.4", "15 frames", "λ = 0.5": what comes before the number, the number, what comes after it.
COLUMN = re.compile(r"(?P<before>×|\w+ = |)(?P<number>\d+(?:\.\d+)?)(?P<after> fps| frames|)")
X_LABELS = {("", " fps"): FRAMERATE_LABEL, ("", " frames"): "frames asked for", ("×", ""): "scale"}


def panels_of(result: Result, y_label: str = "lower is better") -> tuple[Panel, ...]:
    """One panel per block, for numbers of different blocks can't be compared; ours first, the paper's after them.

    `y_label` is that of the blocks in which lower is better; others have none. Blocks whose columns are not all values
    of one quantity ("120 fps", "×4", "30 frames", "λ = 0.5") are left out.
    """
    ordered = sorted(filter(_quantity, result.blocks), key=_is_from_paper)
    panels = (
        Panel(
            block.title,
            y_label if block.lower_is_better else "",
            _curves(block),
            _quantity(block) or "",
            from_zero=block.lower_is_better,
        )
        for block in ordered
    )
    return tuple(panel for panel in panels if panel.curves)


def _quantity(block: Block) -> str | None:
    """What the columns are values of, as an axis says it; None where they are not of one quantity."""
    found = [COLUMN.fullmatch(column) for column in block.columns]
    kinds = {None if match is None else (match["before"], match["after"]) for match in found}
    kind = kinds.pop() if len(kinds) == 1 else None
    if kind is None or kind == ("", ""):
        return None
    return X_LABELS.get(kind) or kind[0].removesuffix(" = ")


def _is_from_paper(block: Block) -> bool:
    return all(row.origin == "paper" for row in block.rows)


def _curves(block: Block) -> tuple[Curve, ...]:
    return tuple(_curve(row, block.columns) for row in block.rows if row.cells)


def _curve(row: Row, columns: tuple[str, ...]) -> Curve:
    present = [column for column in columns if column in row.cells]
    cells = [row.cells[column] for column in present]
    return Curve(
        label=row.name.removesuffix(" (paper)"),
        places=tuple(_number(column) for column in present),
        values=tuple(cell.value for cell in cells),
        half_widths=tuple(cell.ci95 or 0.0 for cell in cells),
    )


def _number(column: str) -> float:
    match = COLUMN.fullmatch(column)
    assert match is not None
    return float(match["number"])
