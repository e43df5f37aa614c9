"""A minute of motion from 30 to 120 fps by every interpolator, beside scipy's plain Slerp, in one process.

    python -m benchmarks.fields.upsampling [--seconds 60] [--repeats 5] [--json]

CPU seconds of one thread, the best of the repeats. Ours: a `Motion` of 22 joints with rotations in, a `Motion` at
120 fps out, positions by forward kinematics included. The peer does less: scipy's `Slerp` for each joint's rotations
and `numpy.interp` for the root, no positions. The second column of ours starts from joint positions alone (inverse
kinematics included).
"""

import os
from dataclasses import replace
from fractions import Fraction
from typing import Any

from benchmarks.command import arguments_parser, best_cpu_seconds, print_json

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from motionkit.core.kinematics import forward_kinematics
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.fields.completion import upsample
from motionkit.fields.interpolation import INTERPOLATORS

FAST = Fraction(120)


def swaying_body(seconds: float) -> Motion:
    """Smooth random turns of all joints along a smooth path, 30 fps."""
    rng = np.random.default_rng(0)
    grid = TimeGrid(Fraction(30), int(seconds * 30) + 1)
    times = grid.seconds()[:, None, None]
    turns = 0.6 * np.sin(times * rng.uniform(1, 9, (22, 3)) + rng.uniform(0, 6, (22, 3)))
    local = Rotation.from_rotvec(turns.reshape(-1, 3)).as_quat(scalar_first=True).reshape(-1, 22, 4).astype(np.float32)
    root = np.sin(0.3 * times[:, 0] * np.array([1.0, 2.0, 1.5])).astype(np.float32)
    return Motion(forward_kinematics(local, root, SMPL22), SMPL22, grid, local, root)


def scipy_slerp(motion: Motion) -> np.ndarray:
    known = motion.timegrid.seconds()
    times = TimeGrid(FAST, 4 * (motion.num_frames - 1) + 1).seconds()
    times = np.minimum(times, known[-1])
    assert motion.local_rotations is not None and motion.root_translation is not None
    rotations = np.empty((len(times), 22, 4))
    for joint in range(22):
        knots = Rotation.from_quat(motion.local_rotations[:, joint].astype(np.float64), scalar_first=True)
        rotations[:, joint] = Slerp(known, knots)(times).as_quat(scalar_first=True)
    for axis in range(3):
        np.interp(times, known, motion.root_translation[:, axis])
    return rotations


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    motion = swaying_body(options.seconds)
    bare = replace(motion, local_rotations=None, root_translation=None)
    peer = best_cpu_seconds(lambda: scipy_slerp(motion), options.repeats)
    rows: list[dict[str, Any]] = []
    for name, encoder in INTERPOLATORS.items():
        with_rotations, from_positions = (
            best_cpu_seconds(lambda given=given, encoder=encoder: upsample(given, FAST, encoder), options.repeats)
            for given in (motion, bare)
        )
        rows.append(
            {
                "method": name,
                "seconds": round(with_rotations, 4),
                "from_positions_seconds": round(from_positions, 4),
                "times_scipy_slerp": round(with_rotations / peer, 2),
            }
        )
    made = upsample(motion, FAST).local_rotations
    assert made is not None
    agreement = 1.0 - float(np.abs(np.sum(made * scipy_slerp(motion), axis=-1)).min())
    report = {
        "frames": motion.num_frames,
        "joints": 22,
        "scipy_slerp_seconds": round(peer, 4),
        "largest_difference_from_scipy": agreement,
        "rows": rows,
    }
    if options.json:
        print_json(report)
        return
    print(f"{motion.num_frames} frames, 22 joints, 30 -> 120 fps; scipy's Slerp, rotations alone: {peer:.4f} s")
    print(f"SLERP's cosine differs from scipy's by at most {agreement:.1e}")
    for row in rows:
        print(
            f"{row['method']:>22} {row['seconds']:8.4f} s   from positions {row['from_positions_seconds']:8.4f} s   "
            f"{row['times_scipy_slerp']:6.2f} x scipy"
        )


if __name__ == "__main__":
    main()
