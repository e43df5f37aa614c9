"""Curves of tables over one quantity, of seconds against quality, and of a run's training."""

from pathlib import Path

import numpy as np
import pytest

from eval.report.curves import (
    Curve,
    Panel,
    cost_figure,
    curves_figure,
    panels_of,
    row_colours,
    run_card,
    save,
    stages_of,
    training_figure,
)
from eval.report.results import Block, Cell, Result, Row, environment, origin_line
from motionkit.core.files import write_json
from motionkit.training.run import RunError, RunFolder


def result(*blocks: Block) -> Result:
    return Result("t", "1", "title", "caption", blocks)


def test_an_axis_is_logarithmic_where_values_span_a_decade(tmp_path: Path) -> None:
    for values, scale in (((1.0, 50.0), "log"), ((1.0, 2.0), "linear")):
        figure = curves_figure([Panel("one", "clip-FID", (Curve("a", (20.0, 60.0), values, (0.1, 0.1)),))])
        assert save(figure, tmp_path / "curves.png").stat().st_size > 0
        assert figure.axes[0].get_yscale() == scale


def test_a_row_has_one_colour_and_its_name_stands_free_at_its_end() -> None:
    rows = ("real", "NeRM, local (ours)", "NeRM, local (ours), planted", "MDM")
    ours = Panel("ours", "", tuple(Curve(name, (20.0, 60.0), (1.0, 2.0), (0.1, 0.1)) for name in rows))
    papers = Panel("paper", "", tuple(Curve(name, (20.0, 60.0), (1.0, 2.0), (0.0, 0.0)) for name in ("T2M", "NeRM")))
    here, there = row_colours([ours, papers])
    assert len({*here.values(), *there.values()}) == 5 and here["NeRM, local (ours)"] == there["NeRM"]
    axes, _ = curves_figure([ours, papers]).axes
    heights = sorted(text.get_position()[1] for text in axes.texts)
    assert {text.get_text() for text in axes.texts} == set(rows)
    assert min(np.diff(heights)) > 0.03 and 0.0 < heights[0] < heights[-1] < 1.0


def test_blocks_become_panels_with_the_papers_last() -> None:
    fps = ("20 fps", "120 fps")
    of_paper = Block("the paper", fps, (Row("MDM (paper)", "paper", {"20 fps": Cell(0.5), "120 fps": Cell(8.4)}),))
    ours = Block("kinematic", fps, (Row("NeRM", "ours", {"120 fps": Cell(7.0, 0.3)}), Row("absent", "ours", {})))
    by_action = Block("actions", ("walk",), (Row("NeRM", "ours", {"walk": Cell(1.0)}),))
    first, last = panels_of(result(of_paper, by_action, ours))
    assert (first.title, first.curves) == ("kinematic", (Curve("NeRM", (120.0,), (7.0,), (0.3,)),))
    assert (last.title, last.curves) == ("the paper", (Curve("MDM", (20.0, 120.0), (0.5, 8.4), (0.0, 0.0)),))


@pytest.mark.parametrize(
    ("columns", "label"),
    [
        (("×2", "×2.4"), "scale"),
        (("5 frames", "30 frames"), "number of frames"),
        (("λ = 0", "λ = 0.5"), "λ"),
        (("20 fps", "×2"), None),
    ],
)
def test_columns_are_values_of_one_quantity(columns: tuple[str, ...], label: str | None) -> None:
    row = Row("linear", "ours", {column: Cell(30.0) for column in columns})
    panels = panels_of(result(Block("PSNR", columns, (row,), lower_is_better=False)))
    assert [panel.x_label for panel in panels] == ([] if label is None else [label])
    if panels:
        assert panels[0].curves[0].places == tuple(float(column.strip("× framesλ=")) for column in columns)
        assert curves_figure(panels).axes[0].get_ylim()[0] > 0


def test_rows_with_seconds_are_points_and_others_levels_inside_the_picture() -> None:
    seconds, _, quality = columns = ("CPU seconds a motion", "seconds a motion", "clip-FID, 60 fps")
    rows = (
        Row("real", "reference", {quality: Cell(0.9, 0.1)}),
        Row("50 steps", "ours", {seconds: Cell(0.2), quality: Cell(5.0, 0.4)}),
        Row("not timed", "reference", {}),
        Row("5 steps", "ours", {seconds: Cell(0.05), quality: Cell(8.0)}),
        Row("far", "reference", {quality: Cell(30.0)}),
    )
    figure = cost_figure(result(Block("Cost", columns, rows)))
    assert figure is not None
    (axes,) = figure.axes
    assert axes.get_xlim()[0] == 0.0 == axes.get_ylim()[0]
    assert axes.get_xlim()[1] > 0.2 and axes.get_ylim()[1] > 30.0
    assert {text.get_text() for text in axes.texts} == {"50 steps", "5 steps", "real", "far"}
    assert np.asarray(axes.lines[0].get_xydata()).tolist() == [[0.2, 5.0], [0.05, 8.0]]
    assert (axes.get_xlabel(), axes.get_ylabel()) == (seconds, f"{quality} (lower is better)")
    assert cost_figure(result(Block("Cost", columns, rows[:1]), Block("other", ("20 fps",), rows))) is None


def test_a_run_shows_its_stages_and_losses(tmp_path: Path) -> None:
    run = RunFolder(tmp_path / "nano")
    for name, losses in (("field", [0.5, 0.25]), ("denoiser", [])):
        stage = run.stage(name)
        stage.path.mkdir(parents=True)
        config = {"stage": name, "recipe": "nano", "store_fingerprint": "ab" * 32, "commit": "cd" * 20}
        write_json(stage.config_path, config)
        for number, loss in enumerate(losses):
            stage.append_metrics({"step": 50.0 * (number + 1), "seconds": 1.0, "loss": loss, "kl": 0.0})
    run.stage("field").finish({"steps": 1234, "parameters": 56789, "cpu_seconds": 12.0})
    denoiser, field = stages_of(run.path)
    assert denoiser.facts["steps"] == "not finished"
    expected = {"steps": "1,234", "parameters": "56,789", "store": "ab" * 6, "commit": "cd" * 6}
    assert {fact: field.facts[fact] for fact in expected} == expected
    figure = training_figure([denoiser, field])
    assert figure is not None
    (line,) = figure.axes[0].lines
    assert (line.get_label(), np.asarray(line.get_xydata()).tolist()) == ("loss", [[50.0, 0.5], [100.0, 0.25]])
    page = run_card(run.path, [("a <person>", '<p title="x">')])
    assert "data:image/png;base64," in page and "a &lt;person&gt;" in page and 'srcdoc="&lt;p title=&#34;x&#34;' in page
    with pytest.raises(RunError, match="holds no trained stage"):
        run_card(tmp_path / "none")


def test_a_result_says_its_command_without_folders_of_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    words = ["/usr/bin/motionkit", "eval", "--store", "/home/someone/store", "--samples", "My model=/data/mine"]
    monkeypatch.setattr("sys.argv", words)
    found = environment()
    assert found["command"] == "motionkit eval --store store --samples 'My model=mine'"
    known = Result("t", "1", "T", "", (), provenance={"environment": {**found, "commit": None}})
    assert origin_line(known).startswith("by motionkit eval --store store --samples 'My model=mine', on 20")
    assert origin_line(result()) == ""
