"""What a difference of two rows allows to say, by which of two numbers is better."""

from eval.metrics.replications import Score
from eval.metrics.resampling import Difference
from eval.report.differences import differences_block, of_interest, pairs_of, said, score_differences
from eval.report.results import Block, Cell, Row, measure

MEASURES = (measure("fid", column="FID"), measure("accuracy", column="Accuracy"), measure("diversity", column="D"))


def block_of(**fids: float) -> Block:
    """A block of FIDs, lower being better."""
    rows = tuple(Row(name, "reference" if name == "r" else "ours", {"FID": Cell(fid)}) for name, fid in fids.items())
    return Block("t", ("FID", "Accuracy"), rows, metrics=MEASURES)


def test_better_is_what_the_metric_says() -> None:
    lower, higher, same = Difference(-2.0, 1.0), Difference(2.0, 1.0), Difference(0.5, 1.0)
    assert said({"FID": lower, "Accuracy": lower}, MEASURES) == "better: FID; worse: Accuracy"
    assert said({"FID": same, "Accuracy": higher, "D": higher}, MEASURES) == (
        "better: Accuracy; higher: D; not told apart: FID"
    )
    assert said({"20 fps": lower, "60 fps": lower}, (measure("fid"),)) == "better: 20 fps, 60 fps"


def test_pairs_are_each_row_with_later_ones_and_references() -> None:
    assert pairs_of(["a", "b"], ["r"]) == [("a", "b"), ("a", "r"), ("b", "r")]


def test_rows_without_resamplings_have_no_difference() -> None:
    rows = {"a": {"fid": Score((1.0,), (1.0, 1.2))}, "b": {"fid": Score((3.0,), (3.0, 3.1))}}
    found = score_differences(rows, {"fid": "FID", "accuracy": "Accuracy"})
    block = differences_block(block_of(a=1.0, b=3.0), found)
    assert block is not None
    (row,) = block.rows
    assert (row.name, row.cells["FID"].value, row.note) == ("a − b", -2.0, "better: FID")
    bare = {"a": {"fid": Score((1.0,))}, "b": {"fid": Score((3.0,))}}
    assert differences_block(block_of(a=1.0, b=3.0), score_differences(bare, {"fid": "FID"})) is None


def test_pairs_without_the_best_row_are_shown_of_the_same_motions_alone() -> None:
    names = ("a", "b", "b, planted", "c")
    every = {pair: {"FID": Difference(-1.0, 0.5)} for pair in pairs_of(names, ("r",))}
    block, treated = block_of(r=0.1, a=1.0, b=3.0, **{"b, planted": 2.0}, c=4.0), ("b", "b, planted")
    references = [("a", "r"), ("b", "r"), ("b, planted", "r"), ("c", "r")]
    best = [("a", "b"), ("a", "b, planted"), ("a", "c"), treated]
    assert [*of_interest(block, every)] == [*best, *references]
    named = [("a", "c"), treated, ("b", "c"), ("b, planted", "c")]
    assert [*of_interest(block, every, ["c"])] == [*named, *references]
