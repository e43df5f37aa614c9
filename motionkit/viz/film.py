"""Films of motions (mp4, gif), strips of poses (png), and recordings for Rerun's viewer (rrd, https://rerun.io).

Motions are not resampled: a picture shows each motion's most recent frame on a common clock.
"""

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from subprocess import CalledProcessError
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.animation import FFMpegWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure, FigureBase
from PIL import Image

from motionkit.core.errors import MissingExtraError, MotionkitError
from motionkit.core.files import whole_file
from motionkit.core.progress import OnProgress, ignore, tracked
from motionkit.core.shapes import Float64
from motionkit.viz.player import Panel, drawing_of

PANEL_PIXELS, DPI = 480, 100
STRIP_POSES, STRIP_PIXELS = 8, 240
# Blue is left and orange right, as on pages. Rerun's viewer is dark: other bones are light there.
COLOURS, LIGHT = {-1: "#2a6bd9", 0: "#444444", 1: "#e6611e"}, (190, 190, 190)
# The camera is in front of the body, to its left and slightly above.
ASIDE_RADIANS, ABOVE_RADIANS = np.radians(35.0), np.radians(14.0)
# Half the size of the ground, and the picture's extent relative to the poses'.
GRID_METRES, AIR = 3, 1.15
# The poses that the picture's extent is computed from.
MOST_POSES = 1000
# A gif's frames last whole hundredths of a second, and browsers show none shorter than two.
GIF_FPS = Fraction(50)
MOST_PICTURES = 20_000
# One thread and no dates: the same motion gives the same file.
MP4_OPTIONS = ["-pix_fmt", "yuv420p", "-crf", "18", "-threads", "1", "-fflags", "+bitexact"]


def pictures_of(panels: Sequence[Panel], speed: Fraction, suffix: str) -> tuple[int, Fraction]:
    """How many pictures an mp4 or a gif has, and pictures per second.

    There is one for every native frame of the fastest motion, at `speed`; at most 50 per second in a gif. Raises
    `MotionkitError` for too many.
    """
    fps = max(panel.fps for panel in panels) * speed
    fps = min(fps, GIF_FPS) if suffix == ".gif" else fps
    longest = max(panel.duration_seconds for panel in panels)
    count = max(1, int(np.ceil(longest * float(fps / speed) - 1e-6)))
    if count > MOST_PICTURES:
        enough = int(MOST_PICTURES * float(speed / fps))
        raise MotionkitError(
            f"{count:,} pictures of {longest:,.0f} s, at most {MOST_PICTURES:,}: cut with --from 0 --to {enough}"
        )
    return count, fps


def write_film(
    path: Path, panels: Sequence[Panel], speed: Fraction = Fraction(1), on_progress: OnProgress = ignore
) -> None:
    """Write motions side by side: .mp4 and .gif played at `speed`, .png a strip of poses, .rrd for Rerun's viewer.

    Raises `MotionkitError` for too many pictures, and `MissingExtraError` for an mp4 without the extra `video`, an rrd
    without `rerun`.
    """
    suffix = path.suffix.lower()
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        if suffix in (".png", ".rrd"):
            (_write_strip if suffix == ".png" else _write_recording)(temporary, panels)
            return
        count, fps = pictures_of(panels, speed, suffix)
        figure = Figure(figsize=(len(panels) * PANEL_PIXELS / DPI, PANEL_PIXELS / DPI), dpi=DPI)
        scenes = [_Scene(figure, panel, (1, len(panels)), number) for number, panel in enumerate(panels)]

        def each_picture() -> Iterator[None]:
            for number in tracked(on_progress, "draw", range(count), count):
                for scene in scenes:
                    scene.draw(number * float(speed / fps))
                yield

        (_write_gif if suffix == ".gif" else _write_mp4)(temporary, figure, each_picture(), fps, count)


class _Scene:
    """The axes of one motion, seen by a camera that follows the body and keeps every pose inside."""

    def __init__(
        self,
        figure: FigureBase,
        panel: Panel,
        grid: tuple[int, int],
        number: int,
        titled: bool = True,
        colours: Mapping[int, str] = COLOURS,
    ) -> None:
        drawing = drawing_of(panel.skeleton, panel.joint_positions)
        yaw, level, above = drawing.yaw + ASIDE_RADIANS, np.cos(ABOVE_RADIANS), np.sin(ABOVE_RADIANS)
        right = np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
        towards = np.array([np.sin(yaw) * level, above, np.cos(yaw) * level])
        self._panel, self._seconds = panel, panel.frame_seconds()
        self._camera = np.stack((right, np.cross(towards, right)))
        poses = panel.joint_positions[:: max(1, panel.num_frames // MOST_POSES)].astype(np.float64)
        poses = poses[np.isfinite(poses).all(axis=(1, 2))]
        lowest, highest = (float(poses[..., 1].min()), float(poses[..., 1].max())) if len(poses) else (0.0, 1.0)
        self._floor = 0.0 if abs(lowest) < (highest - lowest) / 7 else lowest
        self._middle = (self._floor + highest) / 2
        reach = np.abs((poses - self._centre(poses)[:, None]) @ self._camera.T).max(initial=0.05) * AIR
        rows, columns = grid
        row, column = divmod(number, columns)
        axes = figure.add_axes((column / columns, 1 - (row + 1) / rows, 1 / columns, 1 / rows))
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
        axes.set_axis_off()
        bones = [(joint, parent) for joint, parent in enumerate(drawing.bones) if parent >= 0]
        self._bones = np.array(bones, np.int64).reshape(-1, 2)
        self._ground = LineCollection([], colors="#d8d8d8", linewidths=0.8)
        self._body = LineCollection(
            [], colors=[colours[drawing.sides[joint]] for joint, _ in bones], linewidths=2.5, capstyle="round"
        )
        for lines in (self._ground, self._body):
            axes.add_collection(lines)
        self._clock = axes.text(0.03, 0.02, "", transform=axes.transAxes, fontsize=9, color="#666666")
        if titled:
            title = f"{panel.name}, {panel.fps} fps"
            colour = "black" if colours is COLOURS else colours[0]
            axes.text(0.03, 0.98, title, transform=axes.transAxes, fontsize=9, color=colour, va="top", parse_math=False)

    def draw(self, instant: float) -> None:
        """Show the most recent frame at an instant in seconds after the motion's beginning."""
        seconds = self._seconds[0] + instant + 1e-6
        frame = max(0, int(np.searchsorted(self._seconds, seconds, side="right")) - 1)
        pose = np.nan_to_num(self._panel.joint_positions[frame]).astype(np.float64)
        centre = self._centre(pose)
        self._body.set_segments(list((pose - centre)[self._bones] @ self._camera.T))
        self._ground.set_segments(list((_ground_lines(centre, self._floor) - centre) @ self._camera.T))
        self._clock.set_text(f"{self._seconds[frame]:.3f} s, frame {self._panel.first_frame + frame}")

    def _centre(self, poses: Float64[np.ndarray, "*poses joints 3"]) -> Float64[np.ndarray, "*poses 3"]:
        """Where the camera looks: the mean of the joints, at one height."""
        centre = np.asarray(poses.mean(axis=-2))
        centre[..., 1] = self._middle
        return centre


def _ground_lines(centre: Float64[np.ndarray, "3"], floor: float) -> Float64[np.ndarray, "lines 2 3"]:
    """Lines on the floor at whole metres around a place."""
    x, _, z = np.round(centre)
    steps, ends = range(-GRID_METRES, GRID_METRES + 1), (-GRID_METRES, GRID_METRES)
    along_z = [[(x + step, floor, z + end) for end in ends] for step in steps]
    along_x = [[(x + end, floor, z + step) for end in ends] for step in steps]
    return np.array(along_z + along_x)


def _write_strip(path: Path, panels: Sequence[Panel]) -> None:
    size = STRIP_PIXELS / DPI
    figure = Figure(figsize=(STRIP_POSES * size, len(panels) * size), dpi=DPI)
    draw_strips(figure, [(panel, COLOURS) for panel in panels])
    figure.savefig(path, format="png", dpi=DPI)


def draw_strips(figure: FigureBase, strips: Sequence[tuple[Panel, Mapping[int, str]]]) -> None:
    """Draw a row for each motion, with poses evenly spread over its duration.

    A motion comes with the colours of its left (-1), middle (0) and right (1) bones. Rows are as wide as the figure and
    an eighth of that high.
    """
    for row, (panel, colours) in enumerate(strips):
        seconds = panel.frame_seconds() - panel.frame_seconds()[0]
        for column, frame in enumerate(
            np.unique(np.linspace(0, panel.num_frames - 1, STRIP_POSES).round().astype(int))
        ):
            grid, number = (len(strips), STRIP_POSES), row * STRIP_POSES + column
            _Scene(figure, panel, grid, number, column == 0, colours).draw(float(seconds[frame]))


def _write_gif(path: Path, figure: Figure, pictures: Iterator[None], fps: Fraction, count: int) -> None:
    # Each picture ends at the whole hundredth nearest to its time, so that errors do not add up.
    ends = [round(100 * number / fps) for number in range(count + 1)]
    canvas: Any = FigureCanvasAgg(figure)

    def drawn() -> Image.Image:
        next(pictures)
        canvas.draw()
        return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")

    first = drawn().quantize(64, dither=Image.Dither.NONE)
    others = (drawn().quantize(palette=first, dither=Image.Dither.NONE) for _ in range(count - 1))
    lasting = [10 * (stop - start) for start, stop in pairwise(ends)]
    first.save(path, "GIF", save_all=True, append_images=others, duration=lasting, loop=0, optimize=False)
    next(pictures, None)


def _write_mp4(path: Path, figure: Figure, pictures: Iterator[None], fps: Fraction, count: int) -> None:
    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError:
        raise MissingExtraError("imageio-ffmpeg", "video") from None
    exact: Any = fps  # which ffmpeg reads as 30000/1001
    try:
        with mpl.rc_context({"animation.ffmpeg_path": get_ffmpeg_exe()}):
            writer = FFMpegWriter(fps=exact, codec="libx264", extra_args=MP4_OPTIONS)
            with writer.saving(figure, str(path), DPI):
                for _ in pictures:
                    writer.grab_frame()
    except CalledProcessError as error:
        raise MotionkitError(f"{path}: ffmpeg failed: {str(error.stderr).strip()}") from None


def _write_recording(path: Path, panels: Sequence[Panel]) -> None:
    """A view for each motion: named joints and bones at their own seconds; frames with NaN are left out."""
    try:
        import rerun
        from rerun.blueprint import Horizontal, Spatial3DView
    except ImportError:
        raise MissingExtraError("rerun-sdk", "rerun") from None
    entities = [rerun.new_entity_path([panel.name]) for panel in panels]
    views = [Spatial3DView(origin=entity, name=panel.name) for entity, panel in zip(entities, panels, strict=True)]
    recording = rerun.RecordingStream("motionkit")
    recording.save(path, default_blueprint=Horizontal(*views))
    for entity, panel in zip(entities, panels, strict=True):
        drawing, names = drawing_of(panel.skeleton, panel.joint_positions), panel.skeleton.joint_names
        joints = [
            rerun.AnnotationInfo(number, name, tuple(bytes.fromhex(COLOURS[side][1:])) if side else LIGHT)
            for number, (name, side) in enumerate(zip(names, drawing.sides, strict=True))
        ]
        bones = [(joint, parent) for joint, parent in enumerate(drawing.bones) if parent >= 0]
        body = rerun.ClassDescription(
            info=rerun.AnnotationInfo(0, panel.name, LIGHT), keypoint_annotations=joints, keypoint_connections=bones
        )
        look = rerun.Points3D.from_fields(
            class_ids=[0], keypoint_ids=range(len(names)), radii=[0.012], show_labels=False
        )
        for each in (rerun.ViewCoordinates.RIGHT_HAND_Y_UP, rerun.AnnotationContext([body]), look):
            rerun.log(entity, each, static=True, recording=recording)
        whole = np.isfinite(panel.joint_positions).all(axis=(1, 2))
        seconds = np.round(panel.frame_seconds()[whole] * 1e9).astype("timedelta64[ns]")
        poses = rerun.Points3D.columns(positions=panel.joint_positions[whole].reshape(-1, 3))
        clock, sizes = rerun.TimeColumn("time", duration=seconds), np.full(int(whole.sum()), len(names))
        rerun.send_columns(entity, [clock], poses.partition(sizes), recording=recording)
    recording.disconnect()
