"""Framerates as exact fractions: parsing from numbers and texts, and formatting.

Light on purpose: the command line parses its options with it, without numpy.
"""

import math
from fractions import Fraction
from functools import lru_cache

from motionkit.core.plain_text import shown

COMMON_FPS: tuple[Fraction, ...] = (
    *(Fraction(n) for n in (10, 12, 15, 16, 20, 24, 25, 30, 48, 50, 60, 72, 75, 90, 100, 120, 144, 150, 200, 240, 250)),
    *(Fraction(n) for n in (300, 360, 480, 500, 1000)),
    Fraction(25, 2),
    Fraction(24000, 1001),
    Fraction(30000, 1001),
    Fraction(60000, 1001),
    Fraction(120000, 1001),
)
SNAP_TOLERANCE = 1e-3
MIN_FPS, MAX_FPS = Fraction(1), Fraction(10_000)
LARGEST_FLOAT = 1e308
# Anything that `parse_fps` accepts.
Framerate = Fraction | int | float | str


@lru_cache(maxsize=256, typed=True)  # a corpus repeats the same few thousands of times
def parse_fps(value: Framerate) -> Fraction:
    """Read a framerate exactly: `120`, `"30000/1001"`, `"59.94"`, or a float that is snapped to a common rate.

    A float or decimal string within 0.1 % of a common framerate becomes that rate (120.00004577636719 → 120), because
    files print them with few digits; anything else becomes the closest fraction with a denominator up to 100,000.
    Raises `ValueError` for anything but a finite number between 1 and 10,000 frames per second.
    """
    if isinstance(value, str):
        try:
            value = Fraction(value) if "/" in value else float(value)
        except (ValueError, ZeroDivisionError):
            raise ValueError(f"a framerate is a number such as 120, 59.94 or 30000/1001, not {shown(value)}") from None
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"a framerate must be a finite number, not {value}")
        exact = Fraction(value)
        nearest = min(COMMON_FPS, key=lambda rate: abs(rate - exact))
        fps = nearest if abs(nearest - exact) <= SNAP_TOLERANCE * nearest else exact.limit_denominator(100_000)
    else:
        fps = Fraction(value)
    if not MIN_FPS <= fps <= MAX_FPS:
        found = f"{float(fps):g}" if abs(fps) < LARGEST_FLOAT else "a number of that many digits"
        raise ValueError(f"a framerate must lie between {MIN_FPS} and {MAX_FPS} frames a second, not {found}")
    return fps


def format_fps(fps: Fraction) -> str:
    """Write a framerate so that `parse_fps` reads the same fraction back: `120` or `30000/1001`."""
    return str(fps)
