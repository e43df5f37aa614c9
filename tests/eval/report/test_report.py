"""Results survive their file, renderers print what is in them and nothing else, differences say who is better."""

import csv
import json
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from eval.commands.report import report
from eval.metrics.intervals import Number, over_replications
from eval.report.results import (
    Block,
    Cell,
    Result,
    ResultError,
    Row,
    differences_block,
    find_results,
    format_cell,
    measure,
    of_interest,
    pairs_of,
    read_result,
    samples_only,
    score_differences,
    to_csv,
    to_html,
    to_latex,
    to_markdown,
    verdicts,
    write_result,
)
from eval.sets.sets import RowId, Variant
from motionkit.core.errors import DamagedFileError

MEASURES = (measure("fid", column="FID"), measure("accuracy", column="Accuracy"), measure("diversity", column="D"))


@pytest.fixture
def result() -> Result:
    rows = (
        Row(
            "real & <true>", "reference", {"20 fps": Cell(0.01234, 0.001, {"KID": 1e-5}), "40 fps": Cell(0.0)}, "a note"
        ),
        Row("theirs_x", "paper", {"40 fps": Cell(11.264)}),
    )
    return Result(
        task="nerm-table2",
        version="clip-fid/1",
        title="Table 2",
        caption="A caption.",
        blocks=(Block("features | one", ("20 fps", "40 fps"), rows, note="Block's note."),),
        definition={"n": 4},
        notes=("first",),
        missing=("NeRM: no run",),
        provenance={"seed": 1},
    )


def test_a_result_survives_its_file(result: Result, tmp_path: Path) -> None:
    path = write_result(result, tmp_path)
    assert read_result(path) == result
    (tmp_path / "else.json").write_text('{"format": "something"}')
    assert find_results(tmp_path) == ([result], [])


@pytest.mark.parametrize(
    ("change", "about"),
    [
        ({"title": None}, "title"),
        ({"format": "motionkit-result/9"}, "motionkit-result/9"),
        ({"task": "../mine"}, "file's name"),
        ({"figure": "/tmp/mine"}, "file's name"),
    ],
)
def test_files_that_are_no_results_are_refused(
    change: dict[str, object], about: str, result: Result, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_result(result, tmp_path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(ResultError, match=about):
        read_result(path)
    with pytest.raises(ResultError, match="1 of 1"):
        report(tmp_path)
    assert about in capsys.readouterr().err.replace("\n", "")
    path.write_text("{")
    with pytest.raises(DamagedFileError, match=r"nerm-table2\.json"):
        read_result(path)


def test_a_result_has_no_nan(result: Result, tmp_path: Path) -> None:
    row = Row("nan", "ours", {"20 fps": Cell(float("nan"))})
    with pytest.raises(ValueError, match="JSON compliant"):
        write_result(replace(result, blocks=(Block("b", ("20 fps",), (row,)),)), tmp_path)


def places(document: object, at: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Where values lie in a document, itself among them."""
    yield at
    children = document.items() if isinstance(document, dict) else enumerate(document) if type(document) is list else ()
    for key, child in children:
        yield from places(child, (*at, key))


@pytest.mark.parametrize("value", [None, True, 3, "a", ["a"], [3], {}, {"a": 3}])
def test_a_value_of_another_type_anywhere_is_shown_or_refused(value: object, result: Result, tmp_path: Path) -> None:
    path = write_result(result, tmp_path)
    whole = json.loads(path.read_text())
    refused = 0
    for *upper, last in filter(None, places(whole)):
        document = json.loads(json.dumps(whole))
        within = document
        for key in upper:
            within = within[key]
        within[last] = value
        path.write_text(json.dumps(document))
        found, faults = find_results(tmp_path)
        for each in found:
            assert to_markdown(each) + to_latex(each) + to_csv(each) + to_html([each])
        refused += len(faults)
    assert refused > 20


def test_markdown_latex_csv_and_notebooks_show_every_number(result: Result) -> None:
    text = to_markdown(result)
    assert "| real & <true> | 0.0123 ± 0.0010 | 0 |" in text and "| theirs_x | – | 11.264 |" in text
    assert "- NeRM: no run" in text and "nerm-table2, version clip-fid/1." in text and "\n\n\n" not in text
    text = to_latex(result)
    assert r"real \& $<$true$>$ & 0.0123 $\pm$ 0.0010 & 0 \\" in text and r"theirs\_x & -- & 11.264 \\" in text
    lines = list(csv.DictReader(to_csv(result).splitlines()))
    assert {(line["row"], line["column"], line["metric"]): line["value"] for line in lines} == {
        ("real & <true>", "20 fps", "value"): "0.01234",
        ("real & <true>", "20 fps", "KID"): "1e-05",
        ("real & <true>", "40 fps", "value"): "0.0",
        ("theirs_x", "40 fps", "value"): "11.264",
    }
    text = result._repr_html_()
    assert "<td>real &amp; &lt;true&gt;</td><td>0.0123 ± 0.0010</td>" in text and "<true>" not in text


@pytest.mark.parametrize(
    ("name", "escaped"),
    [
        ("x^2 ~ y", r"x\textasciicircum{}2 \textasciitilde{} y"),
        ("50 % & #1 $ _", r"50 \% \& \#1 \$ \_"),
        ("NeRM − MDM, λ → 3", r"NeRM $-$ MDM, $\lambda$ $\rightarrow$ 3"),
    ],
)
def test_latex_escapes_names(name: str, escaped: str, result: Result) -> None:
    block = replace(result.blocks[0], rows=(Row(name, "ours", {}),))
    assert f"\n{escaped} & -- & --" in to_latex(replace(result, blocks=(block,)))


def test_html_is_whole_and_escaped(result: Result) -> None:
    text = to_html([result])
    open_tags: list[str] = []

    class Checker(HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            if tag not in ("meta", "br"):
                open_tags.append(tag)

        def handle_endtag(self, tag: str) -> None:
            assert open_tags.pop() == tag

    Checker().feed(text)
    assert not open_tags
    assert "real &amp; &lt;true&gt;" in text
    assert "src=" not in text
    assert "http" not in text


def test_html_marks_the_best_and_those_not_told_apart_from_it(result: Result) -> None:
    numbers = {"one": 2.1, "two": 2.0, "three": 2.2, "far": 9.0}
    rows = tuple(Row(name, "ours", {"FID": Cell(value, 0.1), "D": Cell(value)}) for name, value in numbers.items())
    less = {"one − two": (0.1, 0.11), "two − three": (-0.2, 0.19), "one − three": (-0.1, 0.3)}
    pairs = tuple(Row(name, "ours", {"FID": Cell(*values), "D": Cell(0.0, 1.0)}) for name, values in less.items())
    reference = Row("real", "reference", {"FID": Cell(0.0, 0.1), "D": Cell(0.0)})
    block = Block("numbers", ("FID", "D"), (reference, *rows), metrics=MEASURES)
    compared = Block("differences", ("FID", "D"), pairs, metrics=MEASURES, differences_of="numbers")
    text = to_html([replace(result, blocks=(block, compared))])
    marked = [part.split("</td>")[0] for part in text.split('<td class="best">')[1:]]
    assert marked == ["<span>2.10</span> <span>± 0.10</span>", "<span>2.00</span> <span>± 0.10</span>"]
    assert "Bold: the best" in text and "Bold: the best" not in to_html([result])


@pytest.mark.parametrize(
    ("value", "ci95", "text"),
    [
        (135.2, 0.4, "135.2 ± 0.4"),
        (4.31, 1.7, "4.31 ± 1.70"),
        (0.0, None, "0"),
        (-0.0021, None, "-0.00210"),
        (1.6e-7, None, "1.60e-07"),
        (54321.0, None, "54321"),
        (0.99995, None, "1.00"),
    ],
)
def test_numbers_have_three_digits(value: float, ci95: float | None, text: str) -> None:
    assert format_cell(Cell(value, ci95)) == text


def block_of(**fids: float) -> Block:
    """A block of FIDs, lower being better."""
    rows = tuple(Row(name, "reference" if name == "r" else "ours", {"FID": Cell(fid)}) for name, fid in fids.items())
    return Block("t", ("FID", "Accuracy"), rows, metrics=MEASURES)


def test_better_is_what_the_metric_says() -> None:
    lower, higher, same = Number(-2.0, 1.0), Number(2.0, 1.0), Number(0.5, 1.0)
    assert verdicts({"FID": lower, "Accuracy": lower}, MEASURES) == "better: FID; worse: Accuracy"
    assert verdicts({"FID": same, "Accuracy": higher, "D": higher}, MEASURES) == (
        "better: Accuracy; higher: D; not told apart: FID"
    )
    assert verdicts({"20 fps": lower, "60 fps": lower}, (measure("fid"),)) == "better: 20 fps, 60 fps"


def test_rows_without_resamplings_have_no_difference() -> None:
    a, b = map(RowId, "ab")
    rows = {a: {"fid": over_replications((1.0,), (1.0, 1.2))}, b: {"fid": over_replications((3.0,), (3.0, 3.1))}}
    found = score_differences(rows, {"fid": "FID", "accuracy": "Accuracy"})
    block = differences_block(block_of(a=1.0, b=3.0), found)
    assert block is not None
    (row,) = block.rows
    assert (row.name, row.cells["FID"].value, row.note) == ("a − b", -2.0, "better: FID")
    assert block.differences_of == "t"
    bare = {a: {"fid": over_replications((1.0,))}, b: {"fid": over_replications((3.0,))}}
    assert differences_block(block_of(a=1.0, b=3.0), score_differences(bare, {"fid": "FID"})) is None


def test_pairs_without_the_best_row_are_shown_of_the_same_motions_alone() -> None:
    a, b, c, r = map(RowId, "abcr")
    planted, other = RowId("b", Variant.PLANTED), RowId("b, 50 steps")
    every = {pair: {"FID": Number(-1.0, 0.5)} for pair in pairs_of((a, b, planted, other, c), (r,))}
    block = block_of(r=0.1, a=1.0, b=3.0, **{"b, planted": 2.0, "b, 50 steps": 5.0}, c=4.0)
    references = [(row, r) for row in (a, b, planted, other, c)]
    with_best = [(a, b), (a, planted), (a, other), (a, c), (b, planted)]
    assert [*of_interest(block, every)] == [*with_best, *references]
    named = [(a, c), (b, planted), (b, c), (planted, c), (other, c)]
    assert [*of_interest(block, every, ["c"])] == [*named, *references]


def test_samples_alone_can_be_published():
    def row(name, origin="ours"):
        return Row(name, origin, {"20 fps": Cell(1.0)})

    scores = Block("scores", ("20 fps",), tuple(map(row, ("mine", "mine, planted", "NeRM", "NeRM, planted"))))
    scores = replace(scores, rows=(row("real, SLERP", "reference"), *scores.rows, row("MDM (paper)", "paper")))
    names = ("mine − NeRM", "mine − real, SLERP", "mine, planted − mine", "NeRM − real, SLERP")
    differences = Block("differences", ("20 fps",), tuple(map(row, names)))
    models = Block("models", ("20 fps",), (row("NeRM"),))
    result = Result("t", "1", "T", "", (scores, differences, models), missing=("NeRM, 60 fps: none", "mine: short"))
    shown = samples_only(replace(result, provenance={"samples": {"mine@20": "a", "mine@60": "b"}}))
    assert [[each.name for each in block.rows] for block in shown.blocks] == [
        ["real, SLERP", "mine", "mine, planted", "MDM (paper)"],
        ["mine − real, SLERP", "mine, planted − mine"],
    ]
    assert shown.missing == ("mine: short",)
