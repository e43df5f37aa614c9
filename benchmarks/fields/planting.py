"""P11: speed of planting, beside forward kinematics of as many frames, the floor of anything that makes poses.

    python -m benchmarks.fields.planting [--json]

Frames a second of processor time, the best of three, of five minutes at 120 fps: a body that walks on a floor that
moves at 0.2 m/s; the same walk on a still floor; and with bones whose lengths vary by 15 %, as a model's do, which are
projected onto constant ones.
"""

import os
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction

from benchmarks.command import arguments_parser, best_cpu_seconds, print_json

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from motionkit.core.kinematics import forward_kinematics
from motionkit.core.motion import Motion
from motionkit.core.timegrid import TimeGrid
from motionkit.fields.contact.planted import planted_frames
from motionkit.fields.motion_field import Observation, to_motion
from tests.helpers.analytic import analytic_motion

FPS, SECONDS, MINUTES, SLIDING, VARIATION, REPEATS = Fraction(120), 10.0, 5, 0.2, 0.15, 3


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
    planted_frames(Observation.of(motion), motion.timegrid)(motion.timegrid.seconds())


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


def main() -> None:
    """Print the figures."""
    parser = arguments_parser(__doc__)
    parser.add_argument("--json", action="store_true")
    figures = speeds()
    if parser.parse_args().json:
        print_json({"frames_per_second": figures})
        return
    for name, value in figures.items():
        print(f"{name:34} {value:12,.0f} frames/s")


if __name__ == "__main__":
    main()
