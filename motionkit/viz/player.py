"""Motions moving side by side in one self-contained page: what is shown of each, their positions as text, the page."""

import base64
import html
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from importlib import resources
from typing import Any, TypedDict

import numpy as np

from motionkit.core.errors import MotionkitError
from motionkit.core.motion import Caption, Motion
from motionkit.core.shapes import Bool, Float32, Float64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError, counterpart_joints
from motionkit.core.timegrid import TimeGrid
from motionkit.io.gltf import joint_sides

Positions = Float32[np.ndarray, "frames joints 3"]

# Opens in a few seconds in a browser, on phones too.
MOST_PAGE_BYTES = 64_000_000
FARTHEST_METRES = 2e5
SCRIPTS = ("packing.js", "clock.js", "camera.js", "panel.js", "timeline.js", "player.js")
# A joint whose distance from its parent changes by so much hangs on no bone: from the root (hips above a reference on
# the floor), and from any other joint, where a generated limb's length may well change by a decimetre.
TRAVELLING_FROM_ROOT_METRES, TRAVELLING_METRES = 0.1, 0.5
# Of feet without toes the ankles.
ENDS = (("left_foot", "left_ankle"), ("right_foot", "right_ankle"), ("left_wrist",), ("right_wrist",))
# Where no table knows a skeleton, the ends of its limbs are traced, of a few.
MOST_ENDS = 8
# Positions are rounded to this, unless a joint is more than 3.2 m from the root.
STEP_METRES, LARGEST_STEPS = 1e-4, 2**15 - 1


@dataclass(frozen=True, eq=False)
class Panel:
    """One motion of a page or film: joint positions [T, J, 3] in metres, y up, at its own framerate.

    Frame k is at `start_seconds` + k / `fps`, or at `uneven_seconds`[k]. `first_frame` is the number of the first one
    in its file. `observed` masks the frames that the source has; others are faint and called lost. `labels` are shown
    below the name, `details` are key-value pairs.
    """

    name: str
    joint_positions: Positions
    skeleton: Skeleton
    fps: Fraction
    start_seconds: float = 0.0
    first_frame: int = 0
    uneven_seconds: Float64[np.ndarray, "frames"] | None = None
    observed: Bool[np.ndarray, "frames"] | None = None
    captions: tuple[Caption, ...] = ()
    labels: tuple[str, ...] = ()
    details: tuple[tuple[str, str], ...] = ()

    @property
    def num_frames(self) -> int:
        """Number of frames T."""
        return len(self.joint_positions)

    @property
    def duration_seconds(self) -> float:
        """Display duration: T / fps; for uneven times until the last, plus 1 / fps."""
        if self.uneven_seconds is None:
            return float(self.num_frames / self.fps)
        return float(self.uneven_seconds[-1] - self.uneven_seconds[0] + 1 / self.fps)

    def frame_seconds(self) -> Float64[np.ndarray, "frames"]:
        """Times of its frames in seconds."""
        if self.uneven_seconds is not None:
            return self.uneven_seconds
        return TimeGrid(self.fps, self.num_frames, self.start_seconds).seconds()

    def frames(self, start: int, stop: int) -> "Panel":
        """Frames [start, stop), relative to its first, with their own times."""
        return replace(
            self,
            joint_positions=self.joint_positions[start:stop],
            start_seconds=float(self.frame_seconds()[start]),
            first_frame=self.first_frame + start,
            uneven_seconds=None if self.uneven_seconds is None else self.uneven_seconds[start:stop],
            observed=None if self.observed is None else self.observed[start:stop],
        )


def panel_of(motion: Motion, name: str) -> Panel:
    """The panel of a motion, with its captions, labels and provenance."""
    known = motion.provenance
    labels = [motion.action, motion.style, known.subject and f"subject {known.subject}", motion.split]
    rotations = "with rotations" if motion.local_rotations is not None else "positions only"
    details = {
        "skeleton": f"{motion.skeleton.name or 'unnamed'}, {motion.skeleton.num_joints} joints, {rotations}",
        "framerate": f"{motion.fps} fps",
        "the file says": known.stated_fps,
        "format": known.source_format,
        "source": "/".join(filter(None, (known.source, known.source_path))),
        "licence": known.licence,
        "operations": "; ".join(known.operations),
    }
    return Panel(
        name=name,
        joint_positions=motion.joint_positions,
        skeleton=motion.skeleton,
        fps=motion.fps,
        start_seconds=motion.timegrid.start_seconds,
        captions=motion.captions,
        labels=tuple(dict.fromkeys(filter(None, labels))),
        details=tuple((key, value) for key, value in details.items() if value),
    )


@dataclass(frozen=True)
class Drawing:
    """For each joint the parent of its bone (-1: none) and its side (-1 left, 0, 1 right).

    `head` is the head joint, -1 if unknown. `ends` are feet and hands. `yaw` is the facing direction in the first
    frame: the angle about Y, in radians, from Z+ towards X+.
    """

    bones: tuple[int, ...]
    sides: tuple[int, ...]
    head: int
    ends: tuple[int, ...]
    yaw: float


def drawing_of(skeleton: Skeleton, positions: Positions) -> Drawing:
    """How a skeleton with these positions in metres is drawn; markers without bones are points."""
    try:
        own = {SMPL22.joint_names[joint]: source for joint, source in counterpart_joints(skeleton).items()}
    except SkeletonMapError:
        own = {}
    bones = _bones(skeleton, positions)
    ends = [next(own[name] for name in names if name in own) for names in ENDS if own.keys() & set(names)]
    if not ends:
        ends = [joint for joint, parent in enumerate(bones) if parent >= 0 and joint not in bones][:MOST_ENDS]
    yaw = 0.0
    if "left_hip" in own and "right_hip" in own:
        # Left is at X+ of a body that faces Z+.
        across = positions[0, own["left_hip"]] - positions[0, own["right_hip"]]
        yaw = float(np.arctan2(-across[2], across[0]))
    return Drawing(bones, joint_sides(skeleton), own.get("head", -1), tuple(dict.fromkeys(ends)), yaw)


def _bones(skeleton: Skeleton, positions: Positions) -> tuple[int, ...]:
    parents = skeleton.parents
    # Markers have the first of them for their parent, and no rest pose.
    if not skeleton.offsets.any() and skeleton.num_joints > 1 and all(parent <= 0 for parent in parents):
        return (-1,) * len(parents)
    lengths = np.linalg.norm(positions - positions[:, skeleton.parents_or_self], axis=-1)
    limits = [TRAVELLING_FROM_ROOT_METRES if parent == 0 else TRAVELLING_METRES for parent in parents]
    travels = np.ptp(lengths, axis=0) > limits
    return tuple(-1 if far else parent for parent, far in zip(parents, travels.tolist(), strict=True))


class Packed(TypedDict):
    """Positions as base64: the root's, float32 [T, 3] in metres, and all relative to it, int16 [T, J, 3] in steps."""

    stepMetres: float
    root: str
    steps: str


def pack(positions: Positions) -> Packed:
    """Positions in metres, rounded to 0.1 mm; to more if a joint is more than 3.2 m from the root."""
    root = positions[:, :1]
    relative = positions.astype(np.float64) - root
    step = max(STEP_METRES, float(np.abs(relative).max()) / LARGEST_STEPS)
    return Packed(stepMetres=step, root=_text(root.astype("<f4")), steps=_text(np.rint(relative / step).astype("<i2")))


def packed_bytes(num_frames: int, num_joints: int) -> int:
    """Size of positions in a page, as text."""
    return num_frames * (2 * 3 * num_joints + 4 * 3) * 4 // 3


def check_places(panel: Panel) -> None:
    """Raise `MotionkitError` for joints that are NaN or more than 200 km away."""
    # A comparison with nan is false.
    if not bool(np.all(np.abs(panel.joint_positions) < FARTHEST_METRES)):
        raise MotionkitError(
            f"{panel.name}: a joint is not within {FARTHEST_METRES:g} m of the origin; is its unit of length right?"
        )


def page_of(title: str, panels: Sequence[Panel], *, note: str = "") -> str:
    """The page of one or more motions, side by side on one clock in seconds, as HTML that loads nothing.

    `note` is shown below the title. The camera follows each motion from its own front. Raises `MotionkitError` as
    `check_places` does, and for a page that is too large.
    """
    size = sum(packed_bytes(panel.num_frames, panel.skeleton.num_joints) for panel in panels)
    if size > MOST_PAGE_BYTES:
        longest = max(panel.duration_seconds for panel in panels)
        begin = min(panel.start_seconds for panel in panels)
        end = begin + max(1, int(longest * MOST_PAGE_BYTES / size * 0.9))
        raise MotionkitError(
            f"the page would have {size / 1e6:,.0f} MB of positions, {longest:,.0f} s of the longest motion; at most "
            f"{MOST_PAGE_BYTES / 1e6:,.0f} MB: show a part with --from {begin:g} --to {end:g}, or fewer motions"
        )
    return player(title, data_text(data_of(title, panels, note)))


def data_text(data: dict[str, Any]) -> str:
    """Data of a page as JSON without any <: a script must not contain anything like its closing tag."""
    return json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def player(title: str, data: str) -> str:
    """The page with this text for its data: `data_text`, or what a script puts that in place of."""
    return filled("page.html", title, data, SCRIPTS, ("style.css",))


def filled(page: str, title: str, data: str, scripts: Sequence[str], styles: Sequence[str]) -> str:
    """The HTML of `player_page/shell.html` around another file of that folder, with scripts, styles and data inside."""
    folder = resources.files("motionkit.viz") / "player_page"

    def text(names: Sequence[str]) -> str:
        return "\n".join(folder.joinpath(name).read_text(encoding="utf-8") for name in names)

    contents = {"STYLE": text(styles), "BODY": text([page]), "SCRIPTS": text(scripts)}
    contents |= {"TITLE": html.escape(title), "DATA": data}
    # In one pass, since a title may contain any text.
    result = re.sub(f"__({'|'.join(contents)})__", lambda place: contents[place[1]], text(["shell.html"]))
    return result.encode("utf-8", "backslashreplace").decode()  # bytes of a file's name may be no letters


def data_of(title: str, panels: Sequence[Panel], note: str = "") -> dict[str, Any]:
    """The data of the page's script, as plain values; raises `MotionkitError` as `check_places` does."""
    return {"title": title, "note": note, "takes": [_data(panel) for panel in panels]}


def _data(panel: Panel) -> dict[str, Any]:
    check_places(panel)
    drawing = drawing_of(panel.skeleton, panel.joint_positions)
    uneven = panel.uneven_seconds
    return {
        "name": panel.name,
        "labels": list(panel.labels),
        "details": [list(pair) for pair in panel.details],
        "captions": [[each.text, each.start_seconds, each.end_seconds] for each in panel.captions],
        "fps": [panel.fps.numerator, panel.fps.denominator],
        "startSeconds": panel.start_seconds,
        "firstFrame": panel.first_frame,
        "numFrames": panel.num_frames,
        "unevenSeconds": None if uneven is None else _text(uneven.astype("<f8")),
        "seen": None if panel.observed is None else _text(np.packbits(panel.observed, bitorder="little")),
        "jointNames": list(panel.skeleton.joint_names),
        "positions": pack(panel.joint_positions),
        "bones": list(drawing.bones),
        "sides": list(drawing.sides),
        "head": drawing.head,
        "ends": list(drawing.ends),
        "yaw": drawing.yaw,
    }


def _text(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
