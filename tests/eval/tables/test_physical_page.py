"""The page of physical figures shows the numbers of its results."""

from pathlib import Path

import pytest

from eval.report.results import read_result, to_markdown

RESULTS = Path(__file__).parents[3] / "docs" / "results"


@pytest.mark.parametrize("task", ["physical-framerates", "physical-games"])
def test_every_table_of_the_results_is_on_the_page(task: str) -> None:
    page = (RESULTS / "physical.md").read_text(encoding="utf-8").splitlines()
    rows = [line for line in to_markdown(read_result(RESULTS / f"{task}.json")).splitlines() if line.startswith("| ")]
    assert rows and [row for row in rows if row not in page] == []
