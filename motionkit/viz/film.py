"""Films of takes: mp4, gif, and a strip of poses as png, drawn with matplotlib.

Motions are not resampled: a picture shows each take's most recent frame on a common clock.
"""

import subprocess
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

from motionkit.core.errors import MissingExtraError, MotionkitError
from motionkit.core.files import whole_file
from motionkit.core.framerate import format_fps
from motionkit.core.shapes import Float64, Int64, UInt8
from motionkit.viz.player.takes import Drawing, Take, drawing_of

PANEL_PIXELS, DPI = 480, 100
STRIP_POSES, STRIP_PIXELS = 8, 240
# Blue is left and orange right, as on pages.
COLOURS = {-1: "#2a6bd9", 0: "#444444", 1: "#e6611e"}
GROUND = "#d8d8d8"
# The camera is in front of the body, to its left and slightly above.
ASIDE_RADIANS, ABOVE_RADIANS = np.radians(35.0), np.radians(14.0)
GRID_METRES, AIR = 3, 1.15
# Poses used to compute the view's extent.
MOST_LOOKED_AT = 1000
# A gif's frames last whole hundredths of a second, and browsers show none shorter than two.
GIF_FPS, GIF_TICKS = Fraction(50), 100
MOST_PICTURES = 20_000

Picture = UInt8[np.ndarray, "height width 3"]


def film_fps(takes: Sequence[Take], speed: Fraction, suffix: str) -> Fraction:
    """Pictures per second: one for every native frame of the fastest take, at `speed`; at most 50 for a gif."""
    fps = max(take.fps for take in takes) * speed
    return min(fps, GIF_FPS) if suffix == ".gif" else fps


def num_pictures(takes: Sequence[Take], speed: Fraction, suffix: str) -> int:
    """How many pictures a film has; a strip is one. Raises `MotionkitError` for too many."""
    if suffix == ".png":
        return 1
    longest = max(take.duration_seconds for take in takes)
    fps = float(film_fps(takes, speed, suffix))
    count = max(1, int(np.ceil(longest / float(speed) * fps - 1e-6)))
    if count > MOST_PICTURES:
        enough = int(MOST_PICTURES * float(speed) / fps)
        raise MotionkitError(
            f"{count:,} pictures of {longest:,.0f} s, at most {MOST_PICTURES:,}: cut with --from 0 --to {enough}"
        )
    return count


def write_film(
    path: Path, takes: Sequence[Take], speed: Fraction = Fraction(1), on_picture: Callable[[], None] = lambda: None
) -> None:
    """Write takes side by side as .mp4 or .gif, played at `speed`, or as a strip of poses (.png).

    Raises `MotionkitError` for too many pictures, and `MissingExtraError` for an mp4 where the extra `video` is not
    installed.
    """
    suffix = path.suffix.lower()
    path.parent.mkdir(parents=True, exist_ok=True)
    if suffix == ".png":
        with whole_file(path) as temporary:
            Image.fromarray(_strip(takes)).save(temporary, "PNG")
        return
    fps, count = film_fps(takes, speed, suffix), num_pictures(takes, speed, suffix)
    pictures = _counted(_pictures(takes, np.arange(count) * float(speed / fps)), on_picture)
    with whole_file(path) as temporary:
        if suffix == ".gif":
            _write_gif(temporary, pictures, fps, count)
        else:
            _write_mp4(temporary, pictures, fps, len(takes))


def _counted(pictures: Iterable[Picture], on_picture: Callable[[], None]) -> Iterator[Picture]:
    for picture in pictures:
        yield picture
        on_picture()


def _pictures(takes: Sequence[Take], seconds: Float64[np.ndarray, "pictures"]) -> Iterator[Picture]:
    """All takes side by side at instants counted from their beginnings."""
    sheet = Figure(figsize=(len(takes) * PANEL_PIXELS / DPI, PANEL_PIXELS / DPI), dpi=DPI)
    panels = [_Panel.on(sheet, take, (len(takes), 1, place)) for place, take in enumerate(takes)]
    frames = [_frames_at(take, seconds) for take in takes]
    for number in range(len(seconds)):
        for panel, own in zip(panels, frames, strict=True):
            panel.show(int(own[number]))
        yield _drawn(sheet)


def _drawn(sheet: Figure) -> Picture:
    canvas: Any = FigureCanvasAgg(sheet)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _strip(takes: Sequence[Take]) -> Picture:
    """A row per take, with poses evenly spread over its duration."""
    size = STRIP_PIXELS / DPI
    sheet = Figure(figsize=(STRIP_POSES * size, len(takes) * size), dpi=DPI)
    for row, take in enumerate(takes):
        frames = np.unique(np.linspace(0, take.num_frames - 1, STRIP_POSES).round().astype(int))
        for column, frame in enumerate(frames.tolist()):
            place = (STRIP_POSES, len(takes), row * STRIP_POSES + column)
            _Panel.on(sheet, take, place, named=column == 0).show(frame)
    return _drawn(sheet)


def _frames_at(take: Take, seconds: Float64[np.ndarray, "pictures"]) -> Int64[np.ndarray, "pictures"]:
    own = take.frame_seconds() - take.frame_seconds()[0]
    return np.clip(np.searchsorted(own, seconds + 1e-6, side="right") - 1, 0, take.num_frames - 1)


@dataclass(frozen=True, eq=False)
class _View:
    """A camera: right and up directions of the picture, heights of the floor and of the picture's centre.

    `half` is half of the view's extent in metres, which contains every pose: the camera follows the joints' mean.
    """

    right: Float64[np.ndarray, "3"]
    up: Float64[np.ndarray, "3"]
    floor: float
    middle: float
    half: float

    @classmethod
    def of(cls, take: Take, drawing: Drawing) -> "_View":
        yaw = drawing.yaw + ASIDE_RADIANS
        level, height = np.cos(ABOVE_RADIANS), np.sin(ABOVE_RADIANS)
        camera = np.array([np.sin(yaw) * level, height, np.cos(yaw) * level])
        right = np.cross([0.0, 1.0, 0.0], camera)
        right /= np.linalg.norm(right)
        places = take.joint_positions[:: max(1, take.num_frames // MOST_LOOKED_AT)].astype(np.float64)
        places = places[np.isfinite(places).all(axis=(1, 2))]
        lowest, highest = (float(places[..., 1].min()), float(places[..., 1].max())) if len(places) else (0.0, 1.0)
        floor = 0.0 if abs(lowest) < (highest - lowest) / 7 else lowest
        middle = (floor + highest) / 2
        view = cls(right, np.cross(camera, right), floor, middle, 0.0)
        reach = float(np.abs(view.flat(places - view.centre(places)[:, None])).max(initial=0.0))
        return replace(view, half=AIR * max(reach, 0.05))

    def centre(self, poses: Float64[np.ndarray, "*poses joints 3"]) -> Float64[np.ndarray, "*poses 3"]:
        made = np.asarray(poses.mean(axis=-2))
        made[..., 1] = self.middle
        return made

    def flat(self, places: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 2"]:
        return np.stack((places @ self.right, places @ self.up), axis=-1)


@dataclass(frozen=True, eq=False)
class _Panel:
    """One take's part of a sheet; `show` moves its lines to another frame."""

    take: Take
    view: _View
    ends: Int64[np.ndarray, "bones 2"]
    bones: LineCollection
    ground: LineCollection
    clock: Text

    @classmethod
    def on(cls, sheet: Figure, take: Take, place: tuple[int, int, int], named: bool = True) -> "_Panel":
        columns, rows, number = place
        row, column = divmod(number, columns)
        axes = sheet.add_axes((column / columns, 1 - (row + 1) / rows, 1 / columns, 1 / rows))
        drawing = drawing_of(take.skeleton, take.joint_positions)
        view = _View.of(take, drawing)
        axes.set(xlim=(-view.half, view.half), ylim=(-view.half, view.half))
        axes.set_axis_off()
        ground = LineCollection([], colors=GROUND, linewidths=0.8)
        ends = np.array([(joint, parent) for joint, parent in enumerate(drawing.bones) if parent >= 0]).reshape(-1, 2)
        colours = [COLOURS[drawing.sides[joint]] for joint in ends[:, 0].tolist()]
        bones = LineCollection([], colors=colours, linewidths=2.5, capstyle="round")
        for lines in (ground, bones):
            axes.add_collection(lines)
        if named:
            title = f"{take.name}, {format_fps(take.fps)} fps"
            axes.text(0.03, 0.95, title, transform=axes.transAxes, fontsize=9, parse_math=False)
        clock = axes.text(0.03, 0.03, "", transform=axes.transAxes, fontsize=9, color="#666666")
        return cls(take, view, ends, bones, ground, clock)

    def show(self, frame: int) -> None:
        places = np.nan_to_num(self.take.joint_positions[frame]).astype(np.float64)
        middle = self.view.centre(places)
        flat = self.view.flat(places - middle)
        self.bones.set_segments(list(flat[self.ends]))
        self.ground.set_segments(list(self.view.flat(_grid(middle, self.view.floor) - middle)))
        seconds = self.take.frame_seconds()[frame]
        self.clock.set_text(f"{seconds:.3f} s, frame {self.take.first_frame + frame}")


def _grid(middle: Float64[np.ndarray, "3"], floor: float) -> Float64[np.ndarray, "lines 2 3"]:
    """Lines on the floor at whole metres around a place."""
    lines = []
    steps = np.arange(-GRID_METRES, GRID_METRES + 1)
    for axis, other in ((0, 2), (2, 0)):
        near, across = np.round(middle[axis]) + steps, np.round(middle[other]) + GRID_METRES * np.array([-1.0, 1.0])
        ends = np.full((len(near), 2, 3), floor)
        ends[:, :, axis] = near[:, None]
        ends[:, :, other] = across
        lines.append(ends)
    return np.concatenate(lines)


def _write_gif(path: Path, pictures: Iterator[Picture], fps: Fraction, count: int) -> None:
    # Each picture ends at the whole hundredth nearest to its time, so that errors do not add up.
    ends = [round(GIF_TICKS * Fraction(number) / fps) for number in range(count + 1)]
    lasting = [10 * (after - before) for before, after in pairwise(ends)]
    first = Image.fromarray(next(pictures)).quantize(64, dither=Image.Dither.NONE)
    rest = (Image.fromarray(picture).quantize(palette=first, dither=Image.Dither.NONE) for picture in pictures)
    first.save(path, "GIF", save_all=True, append_images=rest, duration=lasting, loop=0, optimize=False)


def _write_mp4(path: Path, pictures: Iterator[Picture], fps: Fraction, panels: int) -> None:
    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError:
        raise MissingExtraError("imageio-ffmpeg", "video") from None
    size, rate = f"{panels * PANEL_PIXELS}x{PANEL_PIXELS}", f"{fps.numerator}/{fps.denominator}"
    given = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-framerate", rate, "-i", "-"]
    # One thread and no dates: the same motion gives the same file.
    made = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-threads", "1", "-fflags", "+bitexact"]
    command = [get_ffmpeg_exe(), "-y", "-loglevel", "error", *given, *made, "-f", "mp4", str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdin is not None and process.stderr is not None
        try:
            for picture in pictures:
                process.stdin.write(picture.tobytes())
            process.stdin.close()
        except BrokenPipeError:
            pass
        said = process.stderr.read().decode(errors="replace").strip()
    if process.returncode:
        raise MotionkitError(f"{path}: ffmpeg ended with {process.returncode}: {said}")
