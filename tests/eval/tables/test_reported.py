"""The papers' figures as they are printed."""

from importlib.resources import files

from eval.tables.parts import SOURCES, reported_figures


def test_table_2_of_nerm() -> None:
    figures = {(figure.method, figure.setting): figure.value for figure in reported_figures("nerm", "2")}
    assert len(figures) == 20
    assert figures["NeRM", "120fps"] == 1.315
    assert figures["T2M", "20fps"] == 1.067


def test_what_is_not_printed_is_none() -> None:
    by_method = {
        (figure.method, figure.metric): figure for figure in reported_figures("nerm", "1") if figure.dataset == "KIT"
    }
    assert by_method["MDM", "fid"].ci95 == 0.021
    assert by_method["NeRM", "multimodality"].value == 1.785
    assert reported_figures("nerm", "99") == []


def test_every_paper_has_its_source() -> None:
    text = (files("eval") / "data" / "reported.csv").read_text(encoding="utf-8")
    papers = {line.split(",")[0] for line in text.splitlines()[1:]}
    assert papers == set(SOURCES)
