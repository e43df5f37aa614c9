"""The page on games shows what its result holds, and says the least shares that it holds."""

from pathlib import Path

from benchmarks.eval.games import page, shown
from eval.report.results import read_result

RESULTS = Path(__file__).parents[2] / "docs" / "results"


def test_the_page_is_that_of_the_result() -> None:
    assert page(read_result(RESULTS / "games.json")).strip() in (RESULTS / "games.md").read_text(encoding="utf-8")


def test_what_the_page_says_of_the_second_version_is_so() -> None:
    result = read_result(RESULTS / "games.json")
    cells = [
        (block.title, row.name, column.split(", ")[1], cell)
        for block in result.blocks
        for row in block.rows
        for column, cell in row.cells.items()
        if column.startswith("kinematic/2")
    ]
    shares = [(title, shown(cell)) for title, _, _, cell in cells if "share" in cell.details]
    assert round(min(share for title, share in shares if not title.startswith("hdm05")), 2) == 0.82
    assert round(min(share for title, share in shares if title.startswith("hdm05")), 2) == 0.83
    harmless = [cell.value for _, name, _, cell in cells if "harmless" in name]
    assert round(max(harmless), 2) == 1.42
    unordered = {
        (title.split(",")[0], name.split("-")[0], fps)
        for title, name, fps, cell in cells
        if name.endswith("Spearman") and cell.value < 0.999
    }
    assert unordered == {("hdm05", "upsampling", fps) for fps in ("60 fps", "100 fps", "120 fps")}
