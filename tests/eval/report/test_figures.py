from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from eval.report import figures
from motionkit.core.skeleton import SMPL22
from motionkit.fields.motion_field import to_motion
from tests.helpers.analytic import analytic_motion


def standing(left_hand_up: bool) -> np.ndarray:
    positions = np.zeros((1, 22, 3), np.float32)
    for joint, parent in enumerate(SMPL22.parents[1:], start=1):
        positions[0, joint] = positions[0, parent] + SMPL22.offsets[joint]
    positions[..., 1] += 0.9
    if left_hand_up:
        positions[0, 20, 1] = 2.2
    return positions


def test_the_picture_is_not_mirrored() -> None:
    """Seen from its front right, a person who faces the picture's right has the right side nearer to the viewer."""
    strip = figures.Strip("", standing(left_hand_up=True), np.zeros(1), SMPL22)
    lines, colours = figures.strip_segments(strip)
    highest = int(np.argmax(lines[:, 1, 1]))
    assert colours[highest] == figures.SIDE_COLOURS["left"]
    toes = [k for k, colour in enumerate(colours) if colour != figures.SIDE_COLOURS["middle"]]
    forward = standing(False)[0, 10] - standing(False)[0, 7]
    assert forward[2] > 0
    assert max(lines[k, 1, 0] - lines[k, 0, 0] for k in toes) > 0.1
    last_drawn = [colour for colour in colours if colour != figures.SIDE_COLOURS["middle"]][-1]
    assert last_drawn == figures.SIDE_COLOURS["right"]


def test_bones_keep_their_length_in_the_plane_or_shrink() -> None:
    positions = standing(False)
    lines, _ = figures.strip_segments(figures.Strip("", positions, np.zeros(1), SMPL22))
    drawn = np.sort(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=-1))
    true = np.sort(np.linalg.norm(SMPL22.offsets[1:], axis=-1))
    assert np.all(drawn <= true + 1e-6)


def test_strips_are_written(tmp_path: Path) -> None:
    field = analytic_motion("walk", 5.0)
    strip = figures.strip_of(to_motion(field, Fraction(60)), "walks, then bows", num_poses=6, seconds=3.0)
    assert strip.seconds[-1] == pytest.approx(3.0)
    assert strip.joint_positions.shape == (6, 22, 3)
    panel = figures.Panel("one", "clip-FID", (figures.Curve("a", (20.0,), (1.0,), (0.0,)),))
    figure = figures.curves_and_strips_figure([panel, panel], [strip, strip, strip])
    path = figures.save(figure, tmp_path / "new" / "both.png")
    assert path.read_bytes().startswith(b"\x89PNG")
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles == ["one"] * 2 + ["walks, then bows"] * 3


def test_curves_use_a_logarithmic_axis_where_they_span_a_decade(tmp_path: Path) -> None:
    def scale(values: tuple[float, float]) -> str:
        curve = figures.Curve("a", (20.0, 60.0), values, (0.1, 0.1))
        figure = figures.curves_and_strips_figure([figures.Panel("one", "clip-FID", (curve,))], [])
        figures.save(figure, tmp_path / "curves.png")
        return str(figure.axes[0].get_yscale())

    assert scale((1.0, 50.0)) == "log"
    assert scale((1.0, 2.0)) == "linear"
