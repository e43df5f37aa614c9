"""Which captions and which action belong to a window of a sequence."""

import math
import re
from collections.abc import Iterable, Mapping
from typing import Any

MINIMUM_OVERLAP = 0.5
OPPOSITES = {
    "left": "right",
    "right": "left",
    "clockwise": "counterclockwise",
    "counterclockwise": "clockwise",
    "counter-clockwise": "clockwise",
    "anticlockwise": "clockwise",
}
SIDED_WORD = re.compile(
    "(?<![a-z])(" + "|".join(sorted(OPPOSITES, key=len, reverse=True)) + ")(?![a-z])", re.IGNORECASE
)


def overlapping_captions(
    captions: Iterable[Mapping[str, Any]], window_start: float, window_end: float
) -> tuple[str, ...]:
    """The texts whose seconds overlap [window_start, window_end) by at least half of the shorter of the two.

    `captions` are rows of the store: text, start_seconds, end_seconds (None: to the end of the sequence). A caption of
    HumanML3D may speak of a segment only; a window that touches it by a tenth of a second doesn't show what it says.
    Raises `ValueError` for an empty window.
    """
    if window_end <= window_start:
        raise ValueError(f"the window [{window_start}, {window_end}) s is empty")
    found = []
    for caption in captions:
        start, end = float(caption["start_seconds"]), caption["end_seconds"]
        stop = math.inf if end is None or math.isnan(end) else float(end)
        overlap = min(stop, window_end) - max(start, window_start)
        shorter = min(stop - start, window_end - window_start)
        if overlap > 0 and overlap >= MINIMUM_OVERLAP * shorter and caption["text"]:
            found.append(str(caption["text"]))
    return tuple(found)


def mirrored_text(text: str) -> str:
    """The text of the motion seen in a mirror: left and right, clockwise and counterclockwise change places."""
    return SIDED_WORD.sub(_opposite, text)


def _opposite(found: re.Match[str]) -> str:
    word = found.group()
    other = OPPOSITES[word.lower()]
    return other.capitalize() if word[0].isupper() else other
