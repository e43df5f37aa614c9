"""The calibration's picture: a line per feature set, a panel per family, floors drawn, other results refused."""

from dataclasses import replace
from pathlib import Path

import pytest

from eval.calibration import CLEAN, DISJOINT, FLAT, level_name
from eval.report.curves import calibration_figure
from eval.report.figures import save
from eval.report.results import Block, Cell, Result, ResultError, Row
from eval.sets.corruptions import damages

COLUMNS = ("40 fps", "120 fps")


def block(features: str) -> Block:
    """Scores that rise from 2 on; a level that is no damage at 40 fps has no cell there."""
    rows = [
        Row(CLEAN, "reference", {column: Cell(0.01, 0.001) for column in COLUMNS}),
        Row(DISJOINT, "reference", {"40 fps": Cell(30.0, 5.0), "120 fps": Cell(50.0, 5.0)}),
        Row(f"{FLAT}yaw", "reference", {column: Cell(1.0, 0.1) for column in COLUMNS}),
    ]
    for family in damages():
        for index, level in enumerate(family.levels):
            present = [column for column in COLUMNS if level in family.levels_at(float(column.split()[0]))]
            rows.append(
                Row(level_name(family, level), "reference", {column: Cell(2.0 + index, 0.5) for column in present})
            )
    return Block(features, COLUMNS, tuple(rows), provenance={"features": features, "shows": "scores"})


def test_every_feature_set_has_its_line_of_panels(tmp_path: Path) -> None:
    result = Result("calibration", "calibration/2", "Calibration", "", (block("kinematic"), block("native")))
    figure = calibration_figure(result)
    titles = list(filter(None, (axes.get_title(loc="left") for axes in figure.axes)))
    assert titles == ["harmless", *(family.name for family in damages())] * 2
    slerp = figure.axes[1]
    curves = {container.get_label(): container.lines[0].get_xdata().tolist() for container in slerp.containers}
    assert curves == {"40 fps": [2.0, 3.0, 4.0, 5.0], "120 fps": [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]}
    floors = {tuple(line.get_ydata()) for line in slerp.lines if line.get_linestyle() == ":"}
    assert floors == {(30.0, 30.0), (50.0, 50.0)}
    assert save(figure, tmp_path / "calibration.png").read_bytes().startswith(b"\x89PNG")


def test_other_results_are_refused() -> None:
    other = replace(block("kinematic"), provenance={})
    with pytest.raises(ResultError, match="Table 2: there is no calibration to draw"):
        calibration_figure(Result("nerm-table2", "clip-fid/1", "Table 2", "", (other,)))
