"""How much one motion moves when it is told another framerate: a field's own dependence on s (Eq. 2).

One seed gives one latent at every framerate, so the poses at 30 fps are those at 60 fps wherever their instants meet,
but for the field's dependence on s. That is measured here, in millimetres, at the instants that all framerates share.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations

import numpy as np

from motionkit.core.timegrid import TimeGrid, num_frames_within
from motionkit.fields.motion_field import FramerateConditioned, MotionField

RATES = (Fraction(20), Fraction(30), Fraction(60), Fraction(120))


@dataclass(frozen=True)
class FramerateShift:
    """Distances of joints between answers at two framerates: mean and largest over pairs, instants, joints, motions."""

    rates: tuple[Fraction, ...]
    mean_mm: float
    max_mm: float
    num_motions: int
    num_instants: int

    def plain(self) -> dict[str, object]:
        """As values for JSON."""
        return {
            "rates": [str(rate) for rate in self.rates],
            "mean_mm": self.mean_mm,
            "max_mm": self.max_mm,
            "motions": self.num_motions,
            "instants": self.num_instants,
        }


def common_fps(rates: Sequence[Fraction]) -> Fraction:
    """The framerate whose instants are those that all `rates` have in common: their greatest common divisor."""
    denominator = math.lcm(*(rate.denominator for rate in rates))
    return Fraction(math.gcd(*(int(rate * denominator) for rate in rates)), denominator)


def framerate_shift(fields: Iterable[MotionField], rates: Sequence[Fraction] = RATES) -> FramerateShift:
    """How far joints move between `rates`; a field that doesn't know of framerates moves by nothing.

    Raises `ValueError` for fewer than two rates or no field.
    """
    if len(rates) < 2:
        raise ValueError("a shift needs two framerates or more")
    shared = common_fps(rates)
    total, largest, count, num_motions, num_instants = 0.0, 0.0, 0, 0, 0
    for field in fields:
        num_frames = num_frames_within(field.end_seconds - field.start_seconds, shared)
        seconds = np.minimum(TimeGrid(shared, num_frames, field.start_seconds).seconds(), field.end_seconds)
        told = [field.at_fps(rate) if isinstance(field, FramerateConditioned) else field for rate in rates]
        answers = [each.query(seconds).joint_positions.astype(np.float64) for each in told]
        for one, other in combinations(answers, 2):
            distances = np.linalg.norm(one - other, axis=-1)
            total, count = total + float(distances.sum()), count + distances.size
            largest = max(largest, float(distances.max()))
        num_motions, num_instants = num_motions + 1, num_instants + num_frames
    if not num_motions:
        raise ValueError("a shift needs a motion")
    return FramerateShift(tuple(rates), 1000.0 * total / count, 1000.0 * largest, num_motions, num_instants)
