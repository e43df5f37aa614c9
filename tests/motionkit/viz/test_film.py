"""Films and strips: how many pictures, how fast, and that what is drawn moves and is the same every time."""

import subprocess
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from motionkit.core.progress import Progress
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import rest_positions
from motionkit.viz import film
from motionkit.viz.player import Panel


def take(num_frames: int, fps: Fraction, name: str = "still $x$") -> Panel:
    """A body that rises by 0.6 m; a name that is no formula."""
    places = np.repeat(rest_positions(SMPL22)[None] + np.array([0, 0.9, 0], np.float32), num_frames, axis=0)
    places[..., 1] += np.linspace(0, 0.6, num_frames)[:, None]
    return Panel(name, places.astype(np.float32), SMPL22, fps)


@pytest.mark.parametrize(
    ("suffix", "speed", "fps", "count"),
    [(".mp4", Fraction(1, 4), Fraction(30), 24), (".gif", Fraction(1), Fraction(50), 10)],
)
def test_every_native_frame_of_the_fastest_is_a_picture(suffix, speed, fps, count):
    takes = [take(24, Fraction(120)), take(5, Fraction(30))]
    assert film.pictures_of(takes, speed, suffix) == (count, fps)


def test_a_gif_lasts_as_long_as_its_motion_and_moves(tmp_path: Path) -> None:
    reports: list[Progress] = []
    film.write_film(tmp_path / "a.gif", [take(12, Fraction(30))], Fraction(1), reports.append)
    with Image.open(tmp_path / "a.gif") as made:
        pictures, lasting = [], 0
        for number in range(made.n_frames):
            made.seek(number)
            pictures.append(np.array(made.convert("RGB"), np.int64))
            lasting += made.info["duration"]
    assert len(pictures) == reports[-1].done == 12 and reports[-1].finished and lasting == 400
    assert pictures[0].shape == (480, 480, 3)
    heights = [np.nonzero(picture[..., 2] - picture[..., 0] > 100)[0].mean() for picture in pictures]
    assert (np.diff(heights) < 0).all() and heights[-1] < heights[0] - 5, "the body rises"


def test_an_mp4_has_the_exact_framerate_and_is_the_same_every_time(tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    for name in ("a.mp4", "b.mp4"):
        film.write_film(tmp_path / name, [take(6, Fraction(30000, 1001))])
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()
    wanted = [ffmpeg, "-loglevel", "error", "-i", str(tmp_path / "a.mp4"), "-f", "framemd5", "-"]
    lines = subprocess.run(wanted, capture_output=True, text=True, check=True).stdout.splitlines()
    assert any(line.replace(" ", "") == "#tb0:1001/30000" for line in lines)
    assert sum(not line.startswith("#") for line in lines) == 6


def test_a_strip_has_a_row_for_each_take(tmp_path: Path) -> None:
    film.write_film(tmp_path / "a.png", [take(24, Fraction(120)), take(1, Fraction(30))])
    with Image.open(tmp_path / "a.png") as made:
        assert made.size == (8 * 240, 2 * 240)
        drawn = np.array(made, np.int64)
    panels = [drawn[:240, 240 * column : 240 * (column + 1)] for column in range(8)]
    assert all((abs(panel[..., 2] - panel[..., 0]) > 100).sum() > 50 for panel in panels)


def test_every_native_frame_of_a_recording_is_at_its_second(tmp_path: Path) -> None:
    reader = pytest.importorskip("rerun.chunk", reason="the extra rerun is not installed").RrdReader
    places = np.random.default_rng(0).normal(size=(7, 22, 3)).astype(np.float32)
    lost = places.copy()
    lost[3] = np.nan
    takes = [
        Panel("a/b c.bvh", lost, SMPL22, Fraction(120), 1.5),
        Panel("run.bvh", places, SMPL22, Fraction(30000, 1001)),
    ]
    film.write_film(tmp_path / "made.rrd", takes)
    found = [chunk.to_record_batch().to_pydict() for chunk in reader(tmp_path / "made.rrd").stream().to_chunks()]
    poses = [each for each in found if "Points3D:positions" in each]
    for take in takes:
        whole = np.isfinite(take.joint_positions).all(axis=(1, 2))
        (own,) = (each for each in poses if len(each["time"]) == whole.sum())
        np.testing.assert_array_equal(np.array(own["Points3D:positions"], np.float32), take.joint_positions[whole])
        seconds = [each.total_seconds() for each in own["time"]]
        np.testing.assert_allclose(seconds, take.frame_seconds()[whole], atol=1e-6)
    (context, _) = (each["AnnotationContext:context"] for each in found if "AnnotationContext:context" in each)
    assert all(f"'{name}'" in str(context) for name in SMPL22.joint_names)
