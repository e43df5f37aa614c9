"""The page: takes, their positions as text, and the player's script, in one self-contained file."""

import base64
import html
import json
import re
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core.errors import MotionkitError
from motionkit.core.files import write_whole
from motionkit.viz.player.takes import FARTHEST_METRES, Line, Take, drawing_of, pack, packed_bytes

# Opens in a few seconds in a browser, on phones too.
MOST_PAGE_BYTES = 64_000_000
SCRIPTS = ("packing.js", "clock.js", "camera.js", "panel.js", "timeline.js", "player.js")


def check_size(takes: Sequence[Take]) -> None:
    """Raise `MotionkitError` with advice if a page of these takes would be too large for a browser."""
    wanted = sum(packed_bytes(take.num_frames, take.skeleton.num_joints) for take in takes)
    if wanted <= MOST_PAGE_BYTES:
        return
    longest = max(take.duration_seconds for take in takes)
    enough = max(1, int(longest * MOST_PAGE_BYTES / wanted * 0.9))
    begin = min(take.start_seconds for take in takes)
    raise MotionkitError(
        f"the page would have {wanted / 1e6:,.0f} MB of positions, {longest:,.0f} s of the longest motion; at most "
        f"{MOST_PAGE_BYTES / 1e6:,.0f} MB: show a part with --from {begin:g} --to {begin + enough:g}, or fewer motions"
    )


def check_places(take: Take) -> None:
    """Raise `MotionkitError` for joints that are NaN or too far away."""
    # A comparison with nan is false.
    if not bool(np.all(np.abs(take.joint_positions) < FARTHEST_METRES)):
        raise MotionkitError(
            f"{take.name}: a joint is not within {FARTHEST_METRES:g} m of the origin; is its unit of length right?"
        )


def page_of(title: str, takes: Sequence[Take], *, note: str = "", one_camera: bool = False) -> str:
    """The page of one or more takes, side by side on one clock in seconds, as HTML that loads nothing.

    `note` is said below the title. The camera follows each take from its own front, or with `one_camera` at first all
    look at the same place. Raises `MotionkitError` for a joint that is nowhere, and for a page that is too large.
    """
    check_size(takes)
    # A script must not contain anything like its closing tag.
    text = json.dumps(data_of(title, takes, note, one_camera), ensure_ascii=False, allow_nan=False)
    return player(title, text.replace("<", "\\u003c"))


def player(title: str, data: str) -> str:
    """The page with this text for its data: `data_of` as JSON without any <, or what a script puts that in place of."""
    parts = resources.files("motionkit.viz.player") / "templates"
    page = parts.joinpath("page.html").read_text(encoding="utf-8")
    scripts = "\n".join(parts.joinpath(name).read_text(encoding="utf-8") for name in SCRIPTS)
    contents = {
        "TITLE": html.escape(title),
        "STYLE": parts.joinpath("style.css").read_text(encoding="utf-8"),
        "SCRIPTS": scripts,
        "DATA": data,
    }
    # In one pass, since a title may contain any text.
    page = re.sub("__(TITLE|STYLE|SCRIPTS|DATA)__", lambda place: contents[place[1]], page)
    return page.encode("utf-8", "backslashreplace").decode()  # bytes of a file's name may be no letters


def data_of(title: str, takes: Sequence[Take], note: str = "", one_camera: bool = False) -> dict[str, Any]:
    """The data of the page's script, as plain values; raises `MotionkitError` for NaN joints."""
    return {"title": title, "note": note, "oneCamera": one_camera, "takes": [_shown(take) for take in takes]}


def write_page(path: Path, title: str, takes: Sequence[Take], *, note: str = "", one_camera: bool = False) -> int:
    """Write `page_of` some takes atomically, and return its size in bytes."""
    written = page_of(title, takes, note=note, one_camera=one_camera).encode("utf-8")
    write_whole(path, written)
    return len(written)


def _shown(take: Take) -> dict[str, Any]:
    """A take as data of the page's script."""
    check_places(take)
    positions = pack(take.joint_positions, take.skeleton.parents)
    drawing = drawing_of(take.skeleton, take.joint_positions)
    uneven = take.uneven_seconds
    return {
        "name": take.name,
        "labels": list(take.labels),
        "details": [list(pair) for pair in take.details],
        "captions": [[each.text, each.start_seconds, each.end_seconds] for each in take.captions],
        "fps": [take.fps.numerator, take.fps.denominator],
        "startSeconds": take.start_seconds,
        "firstFrame": take.first_frame,
        "numFrames": take.num_frames,
        "unevenSeconds": None if uneven is None else _text(uneven.astype("<f8")),
        "seen": None if take.seen is None else _text(np.packbits(take.seen, bitorder="little")),
        "unseen": take.unseen,
        "colours": take.colours,
        "jointNames": list(take.skeleton.joint_names),
        "positions": positions,
        "bones": list(drawing.bones),
        "sides": list(drawing.sides),
        "head": drawing.head,
        "ends": list(drawing.ends),
        "yaw": drawing.yaw,
        "lines": [_points(line) for line in take.lines],
    }


def _points(line: Line) -> list[list[float | None]]:
    """Round to 0.1 mm; None for NaN."""
    return [[None if np.isnan(each) else round(each, 4) for each in point] for point in line.tolist()]


def _text(array: np.ndarray) -> str:
    return base64.b64encode(array.tobytes()).decode()
