from eval.report.curves import panels_of
from eval.report.figures import curves_figure
from eval.report.results import Block, Cell, Result, Row

COLUMNS = ("20 fps", "120 fps")
PAPER = Block("the paper", COLUMNS, (Row("MDM (paper)", "paper", {"20 fps": Cell(0.5), "120 fps": Cell(8.4)}),))
OURS = Block("kinematic", COLUMNS, (Row("NeRM", "ours", {"120 fps": Cell(7.0, 0.3)}), Row("absent", "ours", {})))


def result(*blocks: Block) -> Result:
    return Result("t", "1", "title", "caption", blocks)


def test_blocks_become_panels_with_the_papers_last() -> None:
    ours, paper = panels_of(result(PAPER, OURS))
    assert (ours.title, paper.title) == ("kinematic", "the paper")
    (curve,) = ours.curves
    assert (curve.label, curve.places, curve.values, curve.half_widths) == ("NeRM", (120.0,), (7.0,), (0.3,))
    assert paper.curves[0].label == "MDM"
    assert paper.curves[0].half_widths == (0.0, 0.0)


def test_blocks_by_something_else_are_left_out() -> None:
    by_action = Block("actions", ("walk",), (Row("NeRM", "ours", {"walk": Cell(1.0)}),))
    assert [panel.title for panel in panels_of(result(by_action, OURS))] == ["kinematic"]


def test_columns_are_values_of_any_one_quantity() -> None:
    named = {
        ("×2", "×2.4"): "scale", ("5 frames", "30 frames"): "frames asked for", ("λ = 0", "λ = 0.5"): "λ",
        ("20 fps", "×2"): None, ("5", "6"): None, (): None,
    }  # fmt: skip
    for columns, label in named.items():
        cells = {column: Cell(30.0) for column in columns}
        block = Block("PSNR", columns, (Row("linear", "ours", cells),), lower_is_better=False)
        panels = panels_of(result(block))
        assert [panel.x_label for panel in panels] == ([] if label is None else [label])
        if panels:
            assert panels[0].curves[0].places == tuple(float(column.strip("× framesλ=")) for column in columns)
            assert curves_figure(panels).axes[0].get_ylim()[0] > 0
