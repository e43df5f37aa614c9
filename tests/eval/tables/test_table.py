"""The papers' figures as they are printed, numbers that are kept, and tables by name."""

from importlib.resources import files
from pathlib import Path

import pytest

from eval.tables.nerm import table1
from eval.tables.table import SOURCES, cached, find_table, reported_figures
from motionkit.core.errors import UsageError
from motionkit.core.files import read_json, write_json


def test_printed_figures_are_read_and_those_that_are_not_are_none() -> None:
    figures = {(figure.method, figure.setting): figure.value for figure in reported_figures("nerm", "2")}
    assert len(figures) == 20 and figures["NeRM", "120fps"] == 1.315
    kit = {(each.method, each.metric): each for each in reported_figures("nerm", "1") if each.dataset == "KIT"}
    assert kit["MDM", "fid"].ci95 == 0.021 and kit["NeRM", "multimodality"].value == 1.785
    assert reported_figures("nerm", "99") == []


def test_every_paper_has_its_source() -> None:
    text = (files("eval") / "data" / "reported.csv").read_text(encoding="utf-8")
    papers = {line.split(",")[0] for line in text.splitlines()[1:]}
    assert papers == set(SOURCES)


def test_a_table_is_found_by_paper_and_number() -> None:
    assert find_table("nerm", "1") is table1.TABLE
    with pytest.raises(UsageError, match="nobody"):
        find_table("nobody", "2")


def test_values_are_kept_for_their_terms_and_computed_anew_if_damaged(tmp_path: Path) -> None:
    assert cached(tmp_path, "floors", {"store": "abc"}, lambda: {"a": [1.5, None]}) == {"a": [1.5, None]}
    assert cached(tmp_path, "floors", {"store": "abc"}, lambda: 0) == {"a": [1.5, None]}
    assert cached(tmp_path, "floors", {"store": "other"}, lambda: 0) == 0
    for path in (tmp_path / "parts").iterdir():
        write_json(path, {"key": read_json(path, "")["key"]})
    assert cached(tmp_path, "floors", {"store": "abc"}, lambda: 2) == 2
    for path in (tmp_path / "parts").iterdir():
        path.write_text("{")
    assert cached(tmp_path, "floors", {"store": "abc"}, lambda: 3) == 3
