"""Parts of tables that somebody changed and signed again: they are computed anew, which a warning says."""

from pathlib import Path
from typing import Any

import pytest

from eval.metrics.metric import MeanSums
from eval.report.results import Cell
from eval.tables.pahires.measured import find_scores, keep_scores
from eval.tables.parts import Part, find_part, keep_part
from motionkit.core.files import read_json, write_json

TERMS = {"store": "abc"}
PART = Part({"a": {"x": Cell(1.5, None, {"weight": 4.0})}}, ("b: no takes",))


def _signed_again(folder: Path, **changed: Any) -> None:
    (path,) = (folder / "parts").iterdir()
    write_json(path, read_json(path, "") | changed)


def test_a_part_is_kept(tmp_path: Path) -> None:
    keep_part(tmp_path, "floors", TERMS, PART)
    assert find_part(tmp_path, "floors", TERMS) == PART


@pytest.mark.parametrize(
    "rows",
    [
        7,
        {"a": 7},
        {"a": {"x": 7}},
        {"a": {"x": {"value": "1"}}},
        {"a": {"x": {"value": 10**400}}},
        {"a": {"x": {"value": 1, "details": None}}},
        {"a": {"x": {"value": 1, "details": {"weight": "4"}}}},
        {"a": {"x": {"value": 1, "unknown": 1}}},
    ],
)
def test_a_part_of_anything_but_numbers_is_not_used(
    rows: object, tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    keep_part(tmp_path, "floors", TERMS, PART)
    _signed_again(tmp_path, rows=rows)
    assert find_part(tmp_path, "floors", TERMS) is None
    assert any("is no part of a table" in str(each.message) for each in recwarn)


@pytest.mark.parametrize("rows", [{}, {"psnr": {}}, {"psnr": {"×2": {"value": 1.0}}}])
def test_scores_that_are_not_whole_are_not_used(rows: object, tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    scores = {"psnr": {"×2": {"a": MeanSums().added(3.0, 2.0), "b": MeanSums().added(1.0, 4.0)}}}
    keep_scores(tmp_path, "interpolation", TERMS, scores)
    assert find_scores(tmp_path, "interpolation", TERMS, ["psnr"], ["×2"]) == scores
    _signed_again(tmp_path, rows=rows)
    assert find_scores(tmp_path, "interpolation", TERMS, ["psnr"], ["×2"]) is None
    assert any("computing it anew" in str(each.message) for each in recwarn)
