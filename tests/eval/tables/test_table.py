"""The papers' figures as they are printed, numbers that are kept, and tables by name."""

from importlib.resources import files

import pytest

from eval.tables.nerm import table1
from eval.tables.table import SOURCES, find_table, reported_figures
from motionkit.core.errors import UsageError


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
