from eval.report.curves import cost_figure
from eval.report.results import Block, Cell, Result, Row

COLUMNS = ("CPU seconds a motion", "seconds a motion", "clip-FID, 60 fps")
ROWS = (
    Row("real", "reference", {"clip-FID, 60 fps": Cell(0.9, 0.1)}),
    Row("50 steps", "ours", {COLUMNS[0]: Cell(0.2), COLUMNS[1]: Cell(0.3), COLUMNS[2]: Cell(5.0, 0.4)}),
    Row("not timed", "reference", {}),
    Row("5 steps", "ours", {COLUMNS[0]: Cell(0.05), COLUMNS[1]: Cell(0.1), COLUMNS[2]: Cell(8.0)}),
)


def result(block: Block) -> Result:
    return Result("nerm-figure8", "1", "Figure 8", "caption", (block,))


def test_rows_with_seconds_are_points_and_others_levels_inside_the_picture() -> None:
    figure = cost_figure(result(Block("Cost", COLUMNS, (*ROWS, Row("far", "reference", {COLUMNS[2]: Cell(30.0)})))))
    assert figure is not None
    (axes,) = figure.axes
    assert axes.get_xlim()[0] == 0.0 == axes.get_ylim()[0]
    assert axes.get_xlim()[1] > 0.2 and axes.get_ylim()[1] > 30.0
    assert {text.get_text() for text in axes.texts} == {"50 steps", "5 steps", "real", "far"}
    assert axes.lines[0].get_xydata().tolist() == [[0.2, 5.0], [0.05, 8.0]]
    assert (axes.get_xlabel(), axes.get_ylabel()) == (COLUMNS[0], "clip-FID, 60 fps (lower is better)")


def test_other_results_have_no_cost_curve() -> None:
    assert cost_figure(result(Block("by framerate", ("20 fps", "60 fps"), ()))) is None
    assert cost_figure(result(Block("Cost", COLUMNS, ROWS[:1]))) is None
    by_framerate = Row("NeRM", "ours", {"20 fps": Cell(1.0), "60 fps": Cell(2.0)})
    assert cost_figure(result(Block("by framerate", ("20 fps", "60 fps"), (by_framerate,)))) is None
