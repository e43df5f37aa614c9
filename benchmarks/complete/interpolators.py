"""Errors of interpolators on captures: upsampling, gaps, and extrapolation.

    python benchmarks/complete/interpolators.py CAPTURES [--takes 40] [--seed 0] [--json]

CAPTURES is a folder that is searched for BVH files of one or more sources; at most 20 s of each take are used. Figures
are the mean distance of all joints from the ground truth in mm over all completed frames. `4×`: every fourth frame of
takes at 120 fps. The others are at 30 fps (faster takes filtered down): gaps of so many frames between ten known ones,
and continuations by so many frames from every 25th frame on. `settling` is what `motionkit complete` does beyond the
ends. `hold` is the floor.
"""

import random
import sys
from collections import defaultdict
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np

from benchmarks.command import arguments_parser, print_json
from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.fields.completion import complete
from motionkit.fields.interpolation import INTERPOLATORS, Settling
from motionkit.fields.motion_field import MotionEncoder
from motionkit.fields.resample import downsample
from motionkit.io.bvh import read_bvh

BETWEEN = ("hold", "linear", "slerp", "rotation-catmull-rom", "squad", "rotation-cubic")
GAPS, REACHES = (2, 4, 8, 15, 30), (3, 8, 15, 30)
FPS, SECONDS, KNOWN, PAST, EVERY = Fraction(30), 20, 10, 20, 25
BEYOND: dict[str, MotionEncoder] = {
    "hold": INTERPOLATORS["hold"],
    "slerp": INTERPOLATORS["slerp"],
    "rotation-cubic": INTERPOLATORS["rotation-cubic"],
    "slerp, settling": Settling(INTERPOLATORS["slerp"]),
    "rotation-cubic, settling": Settling(INTERPOLATORS["rotation-cubic"]),
}

Errors = dict[tuple[str, str], list[float]]


def takes(folder: Path, count: int, seed: int) -> Iterator[Motion]:
    """Takes with rotations, an equal number of each folder of files."""
    by_folder: dict[Path, list[Path]] = defaultdict(list)
    for path in sorted(folder.rglob("*.bvh")):
        by_folder[path.parent].append(path)
    draw = random.Random(seed)
    for paths in by_folder.values():
        for path in draw.sample(paths, min(len(paths), -(-count // len(by_folder)))):
            try:
                motion = read_bvh(path)
            except FormatError as error:
                print(error, file=sys.stderr)
                continue
            if motion.local_rotations is not None and motion.num_frames > 2:
                yield motion.frames(0, min(motion.num_frames, int(SECONDS * motion.fps)))


def distance(made: Motion, truth: Motion, rows: np.ndarray | slice) -> float:
    """Mean distance of joints in mm."""
    off = made.joint_positions[rows].astype(np.float64) - truth.joint_positions[rows]
    return float(np.linalg.norm(off, axis=-1).mean()) * 1000


def between(motion: Motion, observed: np.ndarray, task: str, errors: Errors) -> None:
    """Errors of frames that are not observed."""
    for name in BETWEEN:
        errors[name, task].append(distance(complete(motion, INTERPOLATORS[name], observed=observed), motion, ~observed))


def measure(motion: Motion, errors: Errors) -> None:
    """All errors of one take."""
    if motion.fps == 4 * FPS:
        last = (motion.num_frames - 1) // 4 * 4 + 1
        between(motion.frames(0, last), np.arange(last) % 4 == 0, "4×", errors)
    if motion.fps < FPS:
        return
    motion = downsample(motion, FPS)
    for gap in GAPS:
        place = np.arange(motion.num_frames)
        observed = place % (gap + KNOWN) < KNOWN
        last = int(np.flatnonzero(observed)[-1]) + 1
        if not observed[:last].all():
            between(motion.frames(0, last), observed[:last], f"gap {gap}", errors)
    for start in range(PAST, motion.num_frames - max(REACHES), EVERY):
        for name, encoder in BEYOND.items():
            made = complete(motion.frames(0, start), encoder, after_seconds=float(max(REACHES) / FPS) + 1e-4)
            truth = motion.frames(0, made.num_frames)
            for reach in REACHES:
                errors[name, f"beyond {reach}"].append(distance(made, truth, slice(start, start + reach)))


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("captures", type=Path)
    parser.add_argument("--takes", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    errors: Errors = defaultdict(list)
    count = 0
    for motion in takes(arguments.captures, arguments.takes, arguments.seed):
        measure(motion, errors)
        count += 1
    figures: dict[str, dict[str, float]] = defaultdict(dict)
    for (name, task), found in errors.items():
        figures[name][task] = round(float(np.mean(found)), 2)
    if arguments.json:
        print_json({"takes": count, "millimetres": figures})
        return
    tasks = ["4×", *(f"gap {gap}" for gap in GAPS), *(f"beyond {reach}" for reach in REACHES)]
    print(f"{count} takes, mm")
    print(f"{'':26}" + "".join(f"{task:>10}" for task in tasks))
    for name, row in figures.items():
        print(f"{name:26}" + "".join(f"{row[task]:10.1f}" if task in row else f"{'':10}" for task in tasks))


if __name__ == "__main__":
    main()
