"""Upsampling: how often a capture's original framerate is detected after resampling, and false alarms.

    python -m benchmarks.quality.upsampled FOLDER… [--takes 40] [--seconds 6]

FOLDERs hold captures as `motionkit ingest` reads them. All takes, unchanged, give the false alarms, the other flags and
the cost of measuring beside reading. Then takes of 120 fps are thinned to 20 … 60 fps (those of 30 fps stay as they
are), brought up by holding, linear interpolation, SLERP of rotations and cubic curves, and measured. A table goes to
stderr, JSON to stdout.
"""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.command import arguments_parser, print_table_and_json
from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.timegrid import TimeGrid
from motionkit.features.quality import measure
from motionkit.fields.interpolation import interpolate
from motionkit.fields.motion_field import to_motion
from motionkit.io.reading import read
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import scan

# Captured → stated fps: factors 2, 3, 4, 5, 6, then others, pulldown from film last.
PAIRS = (
    (60, 120),
    (30, 60),
    (40, 120),
    (30, 90),
    (30, 120),
    (24, 120),
    (20, 120),
    (24, 60),
    (30, 100),
    (60, 100),
    (24, 30),
)


def every(motion: Motion, step: int) -> Motion:
    """Every step-th frame."""
    return replace(
        motion,
        joint_positions=motion.joint_positions[::step],
        timegrid=TimeGrid(motion.fps / step, len(motion.joint_positions[::step])),
        local_rotations=None if motion.local_rotations is None else motion.local_rotations[::step],
        root_translation=None if motion.root_translation is None else motion.root_translation[::step],
    )


def held(motion: Motion, fps: Fraction) -> Motion:
    """Every frame repeated until the next one is due."""
    num_frames = int(motion.num_frames * fps / motion.fps)
    ratio = motion.fps / fps
    frames = np.arange(num_frames) * ratio.numerator // ratio.denominator
    return replace(
        motion,
        joint_positions=motion.joint_positions[frames],
        timegrid=TimeGrid(fps, num_frames),
        local_rotations=None,
        root_translation=None,
    )


METHODS: dict[str, Callable[[Motion, Fraction], Motion]] = {
    "hold": held,
    "linear": lambda motion, fps: to_motion(interpolate(motion, "linear"), fps),
    "SLERP": lambda motion, fps: to_motion(interpolate(motion, "slerp"), fps),
    "cubic": lambda motion, fps: to_motion(interpolate(motion, "cubic"), fps),
}


def read_all(folders: list[Path]) -> tuple[list[Motion], float]:
    """All takes that can be read, and the CPU seconds that reading took."""
    options = ReadOptions()
    motions = []
    start = time.process_time()
    for item in scan(folders, options).items:
        try:
            motions.append(read(item, options))
        except FormatError:
            continue
    return motions, time.process_time() - start


def evenly(motions: list[Motion], count: int) -> list[Motion]:
    return [motions[index] for index in np.linspace(0, len(motions) - 1, min(count, len(motions)), dtype=int)]


def captured_at(motions: list[Motion], fps: int, count: int, seconds: float) -> list[Motion]:
    """Captures at exactly this rate: takes of 120 fps thinned, or of the rate itself where none is thinned to it."""
    fit = [motion for motion in motions if motion.fps in (120, fps) and motion.fps % fps == 0]
    long = [motion for motion in fit if motion.duration_seconds >= 3.0]
    cut = [motion.frames(0, min(motion.num_frames, int(seconds * motion.fps))) for motion in evenly(long, count)]
    return [every(motion, int(motion.fps / fps)) for motion in cut]


def detection(motions: list[Motion], count: int, seconds: float) -> dict[str, dict[str, dict[str, float]]]:
    """Per pair of rates and method: share of takes that are flagged, and whose rate is detected exactly."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for captured, stated in PAIRS:
        takes = captured_at(motions, captured, count, seconds)
        for name, upsample in METHODS.items():
            usable = [take for take in takes if name != "SLERP" or take.local_rotations is not None]
            detected = [measure(upsample(take, Fraction(stated))).effective_fps for take in usable]
            known = [rate for rate in detected if rate is not None]
            found.setdefault(f"{captured} → {stated}", {})[name] = {
                "takes": len(known),
                "flagged": float(np.mean([rate < stated for rate in known])),
                "exact": float(np.mean([abs(rate - captured) < 0.01 for rate in known])),
                "told_too_low": float(np.mean([rate < captured - 0.01 for rate in known])),
            }
    return found


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--takes", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=6.0)
    arguments = parser.parse_args()
    motions, reading = read_all(arguments.folders)
    start = time.process_time()
    qualities = [measure(motion) for motion in motions]
    measuring = time.process_time() - start
    frames = sum(motion.num_frames for motion in motions)
    suspected = {
        motion.sequence_id: {"stated": float(motion.fps), "effective": quality.effective_fps}
        for motion, quality in zip(motions, qualities, strict=True)
        if "upsampled" in quality.flags
    }
    sound = [motion for motion in motions if motion.sequence_id not in suspected]
    report: dict[str, Any] = {
        "benchmark": "upsampled",
        "takes": len(motions),
        "judged": sum(quality.effective_fps is not None for quality in qualities),
        "frames": frames,
        "suspected": suspected,
        "flags": dict(Counter(flag for quality in qualities for flag in quality.flags).most_common()),
        "cpu_microseconds_per_frame": {
            "reading": round(reading / frames * 1e6, 2),
            "measuring": round(measuring / frames * 1e6, 2),
        },
        "detection": detection(sound, arguments.takes, arguments.seconds),
    }
    table = Table("captured → stated fps", *METHODS, title="flagged / rate detected exactly, % of takes")
    for pair, methods in report["detection"].items():
        table.add_row(pair, *(f"{100 * each['flagged']:.0f} / {100 * each['exact']:.0f}" for each in methods.values()))
    print_table_and_json(table, report)


if __name__ == "__main__":
    main()
