"""A Fréchet distance that sees accelerations is won by noise: low-passed motion scores better once noise is added.

    python -m benchmarks.eval.noise_wins STORE [--fps 120]

A descriptor of the usual kind: means over half a second of the log speed and log acceleration of every joint,
standardised on training motion. Beside it, what `detail_profile` says of the same sets.
"""

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np

from benchmarks.command import arguments_parser
from eval.detail import RealDetail
from eval.metrics.distributions import fit_gaussian, frechet_distance
from eval.sets.motions import low_pass, real_motion
from motionkit.store import Store


def described(motions: Iterable[np.ndarray], fps: float) -> np.ndarray:
    """Features [windows, 44] of motions [frames, 22, 3]."""
    rows = []
    for motion in motions:
        velocity = np.gradient(motion.astype(np.float64), axis=0) * fps
        acceleration = np.gradient(velocity, axis=0) * fps
        moving = [np.log(np.linalg.norm(each, axis=-1) + 1e-2) for each in (velocity, acceleration)]
        frames, size = np.concatenate(moving, axis=1), round(fps / 2)
        rows += [frames[first : first + size].mean(axis=0) for first in range(0, len(frames) - size + 1, size)]
    return np.array(rows)


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("--fps", type=Fraction, default=Fraction(120))
    arguments = parser.parse_args()
    store, fps, rng = Store.open(arguments.store), float(arguments.fps), np.random.default_rng(0)
    real, train = (real_motion(store, split).at(arguments.fps) for split in ("test", "train"))
    slow = [low_pass(take, fps, 8.0) for take in real.sequences]
    sets = {"real": list(real.sequences), "low-passed at 8 Hz": slow}
    for metres in (0.0002, 0.0004, 0.001):
        noisy = [(take + metres * rng.standard_normal(take.shape)).astype(np.float32) for take in slow]
        sets[f"low-passed, with {1000 * metres:g} mm of white noise"] = noisy
    spread, detail = described(train.sequences, fps).std(axis=0), RealDetail.of(real, train)
    reference = fit_gaussian(described(real.sequences, fps) / spread)
    for name, motions in sets.items():
        distance = frechet_distance(reference, fit_gaussian(described(motions, fps) / spread))
        profile = detail.profile(real.with_positions(motions, name=name)).figures
        marked = (f"{key} {each.value:.2f}{'' if each.is_real else '*'}" for key, each in profile.items())
        print(f"{name:42} {distance:7.2f}   {'  '.join(marked)}")


if __name__ == "__main__":
    main()
