"""What a difference of two rows allows to say, by which of two numbers is better."""

from eval.metrics.number import Number, over_replications
from eval.report.results import (
    Block,
    Cell,
    Row,
    differences_block,
    measure,
    of_interest,
    pairs_of,
    said,
    score_differences,
)
from eval.sets.sets import RowId, Variant

MEASURES = (measure("fid", column="FID"), measure("accuracy", column="Accuracy"), measure("diversity", column="D"))


def block_of(**fids: float) -> Block:
    """A block of FIDs, lower being better."""
    rows = tuple(Row(name, "reference" if name == "r" else "ours", {"FID": Cell(fid)}) for name, fid in fids.items())
    return Block("t", ("FID", "Accuracy"), rows, metrics=MEASURES)


def test_better_is_what_the_metric_says() -> None:
    lower, higher, same = Number(-2.0, 1.0), Number(2.0, 1.0), Number(0.5, 1.0)
    assert said({"FID": lower, "Accuracy": lower}, MEASURES) == "better: FID; worse: Accuracy"
    assert said({"FID": same, "Accuracy": higher, "D": higher}, MEASURES) == (
        "better: Accuracy; higher: D; not told apart: FID"
    )
    assert said({"20 fps": lower, "60 fps": lower}, (measure("fid"),)) == "better: 20 fps, 60 fps"


def test_pairs_are_each_row_with_later_ones_and_references() -> None:
    a, b, r = map(RowId, "abr")
    assert pairs_of([a, b], [r]) == [(a, b), (a, r), (b, r)]


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
