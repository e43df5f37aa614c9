"""Takes of a rigid body that stamps: above 12 Hz it shakes after each stamp and hardly between, with some noise."""

from fractions import Fraction

import numpy as np

from eval.sets.damage import with_bones_of
from eval.sets.sets import SampleSet, sample_set
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import rest_positions

FPS = Fraction(120)


def stamping(num_takes: int = 16, seed: int = 0) -> SampleSet:
    """Takes of four seconds at 120 fps."""
    rng, rest = np.random.default_rng(seed), rest_positions(SMPL22)
    takes, seconds = [], np.arange(480) / 120.0
    for _ in range(num_takes):
        phase = 2 * np.pi * (rng.uniform(1.0, 1.6) * seconds + rng.uniform())
        sway = np.stack([0.2 * np.sin(phase), 0.1 * np.abs(np.sin(phase)), 0.05 * np.cos(phase)], axis=-1)
        wave = np.sin(2 * np.pi * rng.uniform(16, 24) * seconds + rng.uniform(0, 6))
        shake = np.exp(4 * (np.cos(2 * phase) - 1)) * wave
        take = rest + rng.uniform(0.5, 1.5, (22, 1)) * sway[:, None] + 0.003 * shake[:, None, None]
        noisy = take + 0.0002 * rng.standard_normal(take.shape)
        takes.append(with_bones_of(noisy, np.broadcast_to(rest, noisy.shape)).astype(np.float32))
    return sample_set("stamping", FPS, takes, [str(index) for index in range(num_takes)])
