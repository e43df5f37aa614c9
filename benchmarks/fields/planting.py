"""Speed of planting, and the statistics of real feet that its limits come from.

    python -m benchmarks.fields.planting [--store STORE] [--json]

Frames a second of the process's own time, the best of three: five minutes at 120 fps of a body that walks on a floor
going at 0.2 m/s, its positions known as `motionkit plant` knows a file's; of the same walk standing, and with bones
whose lengths vary by 15 %, as a model's do, which are projected onto constant ones; and beside them forward kinematics
of as many frames, the floor of anything that makes poses. Of a store's training takes: how many
times the rests of their feet are faster than the limit (`motionkit.fields.contact.detection`), quantiles over takes.
"""

import os
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from benchmarks.command import arguments_parser, best_cpu_seconds, print_json

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from eval.sets.real import real_motion
from motionkit.core.kinematics import forward_kinematics
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.fields.contact.detection import MOST_TIMES, Rests, find_contacts, ground_of, velocities
from motionkit.fields.contact.legs import legs_of
from motionkit.fields.contact.planted import planted_frames
from motionkit.fields.motion_field import Observation, to_motion
from motionkit.store.reader import Store
from tests.helpers.analytic import analytic_motion

FPS, SECONDS, MINUTES, SLIDING, VARIATION, REPEATS = Fraction(120), 10.0, 5, 0.2, 0.15, 3
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95, 0.98)


def walk(minutes: float, sliding: float) -> Motion:
    """A walk, repeated forwards and backwards in time."""
    once = to_motion(analytic_motion("walk", SECONDS), FPS)
    count = int(minutes * 60 * FPS)
    rows = np.arange(count) % (2 * once.num_frames)
    rows = np.where(rows < once.num_frames, rows, 2 * once.num_frames - 1 - rows)
    grid = TimeGrid(FPS, count)
    step = np.zeros((count, 3), np.float32)
    step[:, 0] = sliding * grid.seconds()
    assert once.local_rotations is not None
    assert once.root_translation is not None
    return Motion(
        once.joint_positions[rows] + step[:, None],
        once.skeleton,
        grid,
        once.local_rotations[rows],
        once.root_translation[rows] + step,
    )


def bare(motion: Motion) -> Motion:
    """The motion without rotations."""
    return replace(motion, local_rotations=None, root_translation=None)


def varying(motion: Motion) -> Motion:
    """The same walk with bones that vary by 15 %, each with a period of its own."""
    assert motion.local_rotations is not None
    assert motion.root_translation is not None
    rates = 0.3 + 0.05 * np.arange(motion.skeleton.num_joints)
    lengths = 1.0 + VARIATION * np.sin(2.0 * np.pi * rates * motion.timegrid.seconds()[:, None])
    offsets = (motion.skeleton.offsets * lengths[..., None]).astype(np.float32)
    positions = forward_kinematics(motion.local_rotations, motion.root_translation, motion.skeleton, offsets)
    return replace(bare(motion), joint_positions=positions)


def plant(motion: Motion) -> None:
    """All frames."""
    planted_frames(Observation.of(motion), motion.timegrid).query(motion.timegrid.seconds())


def frames_a_second(work: Callable[[], object], frames: int) -> float:
    """The best of some repeats, by the process's own time."""
    return frames / best_cpu_seconds(work, REPEATS)


def speeds() -> dict[str, float]:
    """Frames a second of each way."""
    slides, stands = walk(MINUTES, SLIDING), walk(MINUTES, 0.0)
    loose = varying(slides)
    assert slides.local_rotations is not None
    assert slides.root_translation is not None
    body = (slides.local_rotations, slides.root_translation, slides.skeleton)
    ways: dict[str, Callable[[], object]] = {
        "forward kinematics alone": lambda: forward_kinematics(*body),
        "positions, sliding": lambda: plant(bare(slides)),
        "positions, standing": lambda: plant(bare(stands)),
        "positions, sliding, bones vary": lambda: plant(loose),
        "with rotations, sliding": lambda: plant(slides),
        "with rotations, standing": lambda: plant(stands),
    }
    return {name: frames_a_second(work, slides.num_frames) for name, work in ways.items()}


def rests(store: Path) -> dict[str, float]:
    """Of training takes: the mean over contacts of how many times a foot's rests are faster than the limit."""
    real, legs = real_motion(Store.open(store), "train"), legs_of(SMPL22)
    found = []
    for positions, fps in zip(real.sequences, real.fps, strict=True):
        paths = legs.foot_paths(positions).astype(np.float64)
        if len(paths) < fps:
            continue
        contacts = find_contacts(paths, float(fps), ground_of(paths, float(fps)))
        speed = np.linalg.norm(velocities(paths, float(fps))[..., ::2], axis=-1)
        seen = Rests.of(contacts.down, speed, float(fps))
        times = np.minimum(seen.speed / seen.limit, MOST_TIMES)[seen.on_ground]
        if len(times):
            found.append(float(times.mean()))
    return {f"{quantile:.0%}": float(np.quantile(found, quantile)) for quantile in QUANTILES} | {"takes": len(found)}


def main() -> None:
    """Print the figures."""
    parser = arguments_parser(__doc__)
    parser.add_argument("--store", type=Path)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    figures: dict[str, Any] = {"frames a second": speeds()}
    if arguments.store is not None:
        figures["times the limit, training takes"] = rests(arguments.store)
    if arguments.json:
        print_json({**figures})
        return
    for title, rows in figures.items():
        print(f"\n{title}\n")
        for name, value in rows.items():
            print(f"| {name} | {value:,.3g} |" if value < 1000 else f"| {name} | {value:,.0f} |")


if __name__ == "__main__":
    main()
