"""Captions and actions of windows of motion, with left and right swapped for mirrored windows."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import pandas as pd

from motionkit.data.windows import Windows

MINIMUM_OVERLAP = 0.5
SIDED_WORD = re.compile(
    r"(?<![a-z])(?:(left|right)(wards?|most)?|((?:counter|anti)[- ]?)?clockwise)(?![a-z])", re.IGNORECASE
)


def overlapping_captions(
    captions: Iterable[Mapping[str, Any]], window_start: float, window_end: float
) -> tuple[str, ...]:
    """The texts whose seconds overlap [window_start, window_end) by at least half of the shorter of the two.

    `captions` are rows of the store: text, start_seconds, end_seconds (None: to the end of the sequence). A caption of
    HumanML3D may describe a segment only, which a window that overlaps it by a tenth of a second doesn't show.
    """
    result = []
    for caption in captions:
        start, end = float(caption["start_seconds"]), caption["end_seconds"]
        stop = math.inf if end is None or math.isnan(end) else float(end)
        overlap = min(stop, window_end) - max(start, window_start)
        shorter = min(stop - start, window_end - window_start)
        if overlap > 0 and overlap >= MINIMUM_OVERLAP * shorter and caption["text"]:
            result.append(str(caption["text"]))
    return tuple(result)


def mirrored_text(text: str) -> str:
    """The text of the mirrored motion: swaps left and right, clockwise and counterclockwise.

    Also leftward(s), leftmost and similar; counter- and anti-clockwise may be one word, two, or hyphenated.
    """
    return SIDED_WORD.sub(_opposite, text)


def _opposite(match: re.Match[str]) -> str:
    side, ending, against = match.groups()
    if side:
        other = {"left": "right", "right": "left"}[side.lower()] + (ending or "").lower()
    else:
        other = "clockwise" if against else "counterclockwise"
    word = match.group()
    return other.upper() if word.isupper() else other.capitalize() if word[0].isupper() else other


def captions_of_windows(windows: Windows, sequences: pd.DataFrame) -> list[tuple[str, ...]]:
    """Each window's captions, mirrored for mirrored windows."""
    captions: dict[Any, Sequence[Any]] = sequences["captions"].to_dict()
    ends = windows.start_seconds + windows.duration_seconds
    result = []
    for sequence, start, end, mirrored in zip(
        windows.sequence_index, windows.start_seconds, ends, windows.mirrored, strict=True
    ):
        texts = overlapping_captions(captions[int(sequence)], float(start), float(end))
        result.append(tuple(map(mirrored_text, texts)) if mirrored else texts)
    return result


def actions_of_windows(windows: Windows, sequences: pd.DataFrame) -> list[str]:
    """Each window's action ("" for none), mirrored for mirrored windows."""
    actions: dict[Any, str] = sequences["action"].to_dict()
    return [
        mirrored_text(actions[int(sequence)]) if mirrored else actions[int(sequence)]
        for sequence, mirrored in zip(windows.sequence_index, windows.mirrored, strict=True)
    ]
