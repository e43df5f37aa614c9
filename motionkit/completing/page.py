"""An HTML page with moving skeletons side by side: the clip as it was, completed, and completed in other ways.

One file without anything to load: positions are 16-bit numbers in it, a fraction of a millimetre apart.
"""

import base64
import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Float64

from motionkit.completing.clips import Clip
from motionkit.completion import Completion
from motionkit.motion import Motion

# A screen shows no more, and a page of some megabytes opens at once.
PAGE_FPS, PAGE_SECONDS = 60, 60.0
TRAVELLING_METRES = 0.1
PLACEHOLDER = "__PAGE_DATA__"


def write_page(
    path: Path,
    title: str,
    clip: Clip,
    observed: Bool[np.ndarray, "frames"],
    ways: Sequence[tuple[str, Completion]],
) -> None:
    """Write the page of a clip and of one or more completions of it, by name; it appears whole or not at all."""
    first = ways[0][1]
    step = max(1, -(-first.grid.fps.numerator // (first.grid.fps.denominator * PAGE_FPS)))
    fps = float(first.grid.fps / step)
    rows = np.arange(0, first.grid.num_frames, step)[: int(PAGE_SECONDS * fps)]
    seconds = first.seconds(0, first.grid.num_frames)[rows]
    panels = [(f"{name}", _sampled(made, seconds)) for name, made in ways]
    motion = clip.motion
    held, inside = _held(clip, seconds)
    as_it_was = f"the clip, {float(motion.fps):.6g} fps"
    low = min(float(joints.min()) for _, joints in [("", held), *panels])
    high = max(float(joints.max()) for _, joints in [("", held), *panels])
    scale = max((high - low) / 65_000, 1e-6)
    centre = (low + high) / 2

    def panel(name: str, joints: Float32[np.ndarray, "times joints 3"]) -> dict[str, Any]:
        numbers = np.rint((joints - centre) / scale).astype("<i2")
        return {"name": name, "joints": base64.b64encode(numbers.tobytes()).decode()}

    whole = len(rows) * step >= first.grid.num_frames
    data = {
        "title": title,
        "shown": "" if whole else f"the first {PAGE_SECONDS:g} of {first.grid.duration_seconds:.1f} seconds",
        "fps": fps,
        "startSeconds": float(seconds[0]),
        "numFrames": len(rows),
        "parents": _drawn_parents(motion),
        "scale": scale,
        "centre": centre,
        "given": _near_known(clip.seconds[observed], seconds, fps).astype(int).tolist(),
        "inside": inside.astype(int).tolist(),
        "panels": [panel(as_it_was, held), *(panel(*each) for each in panels)],
    }
    template = resources.files("motionkit.completing.templates").joinpath("compare.html").read_text(encoding="utf-8")
    # In a script nothing may look like the end of one.
    text = json.dumps(data, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
    temporary = path.with_name(f".{path.name}.tmp")
    temporary.write_text(template.replace(PLACEHOLDER, text), encoding="utf-8")
    temporary.replace(path)


def _drawn_parents(motion: Motion) -> list[int]:
    # A joint that travels relative to its parent (hips in a reference on the floor) has no bone to draw.
    parents = list(motion.skeleton.parents)
    above = [max(parent, 0) for parent in parents]
    lengths = np.linalg.norm(motion.joint_positions - motion.joint_positions[:, above], axis=-1)
    travels = np.ptp(lengths, axis=0) > TRAVELLING_METRES
    return [-1 if far else parent for parent, far in zip(parents, travels.tolist(), strict=True)]


def _sampled(made: Completion, seconds: Float64[np.ndarray, "times"]) -> Float32[np.ndarray, "times joints 3"]:
    inside = np.clip(seconds, made.field.start_seconds, made.field.end_seconds)
    return made.field.query(inside).joint_positions


def _held(
    clip: Clip, seconds: Float64[np.ndarray, "times"]
) -> tuple[Float32[np.ndarray, "times joints 3"], Bool[np.ndarray, "times"]]:
    # The clip at its own framerate: each frame until the next; and whether an instant lies inside the clip.
    frames = np.searchsorted(clip.seconds, seconds + 1e-6, side="right") - 1
    inside = (frames >= 0) & (seconds <= clip.seconds[-1] + 1e-6)
    return clip.motion.joint_positions[np.maximum(frames, 0)], np.asarray(inside)


def _near_known(
    known: Float64[np.ndarray, "known"], seconds: Float64[np.ndarray, "times"], fps: float
) -> Bool[np.ndarray, "times"]:
    after = np.searchsorted(known, seconds)
    nearest = np.minimum(
        np.abs(seconds - known[np.minimum(after, len(known) - 1)]), np.abs(seconds - known[np.maximum(after - 1, 0)])
    )
    return np.asarray(nearest < 0.5 / fps - 1e-9)
