"""Detects foot contacts and sliding from the trajectories of ankles and toes on a fine time grid.

Heights are relative to each joint's own level, estimated from the motion; speeds are per second, so nothing depends on
the framerate. Sliding thresholds come from real feet: in CMU's training takes feet in contact roll, pivot and creep,
yet each nearly comes to rest within 0.6 s (docs/plant.md).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from motionkit.core.shapes import Bool, Float, Float64
from motionkit.core.timegrid import runs

FootPaths = Float64[np.ndarray, "instants feet ends 3"]
PerFoot = Float64[np.ndarray, "instants feet"]
PerEnd = Float64[np.ndarray, "instants feet ends"]
EndMask = Bool[np.ndarray, "instants feet ends"]

LEVEL_QUANTILE, LEVEL_METRES = 0.05, 0.06
MOST_BETWEEN_FEET_METRES = 0.04
GROUND_METRES, GROUND_SECONDS = 0.12, 1.0
"""Maximum distance of the local ground (lowest foot height within a second) from the level."""

SPEED_SECONDS = 0.05
ENTER_METRES, LEAVE_METRES = 0.05, 0.08
ENTER_SPEED, LEAVE_SPEED = (0.45, 1.5), (0.7, 1.9)
"""Limits for standing feet, and for a motion with sliding feet."""
SHORTEST_SECONDS, GAP_SECONDS = 0.08, 0.05

REST_SECONDS, REST_WITHIN_SECONDS = 0.1, 0.6
CREEP_SPEED, CREEP_AT_ONE_SECOND, CREEP_POWER = 0.015, 0.02, 1.3
"""Real feet slow down below 0.015 + 0.02 · seconds^−1.3 m/s in a contact of that duration (CMU's train split)."""
MOST_TIMES = 4.0
AROUND_SECONDS = 10.0
STEADY_SPEED = 0.05
_FEWEST = 10


class Limits(NamedTuple):
    """Multiples of real feet's creep where sliding begins to count and counts fully: over 10 s, and per foot.

    A foot is held up to a speed of `rest_speed` m/s and `rest_times` its slowest speed, and by its leg alone up to
    `lead_times` that.
    """

    around: tuple[float, float]
    here: tuple[float, float]
    rest_speed: float
    rest_times: float
    lead_times: float


CAPTURED = Limits((1.15, 1.45), (2.5, 3.5), 0.12, 1.6, 4.0)
GENERATED = Limits((0.5, 0.7), (1.0, 1.5), 0.03, 1.0, 2.0)
"""Creeping is normal in captures; in generated motion only feet stiller than most real ones are left alone.

Generated feet are held only around their slowest: in transition they are as fast as real ones (docs/plant.md).
"""


@dataclass(frozen=True, eq=False)
class Contacts:
    """For every sample of a grid: contacts of ankle and toe of both feet, and how much each foot slides.

    `sliding` is 0 up to the creep speed of real feet, 1 for certain sliding. `velocity` is that of the foot's steadier
    end in contact, m/s, 0 without contact. `hold` is the weight with which a foot is planted: 1 near its slowest speed,
    less in transition, 0 in the air; `lead` is the same with a looser threshold. `beside` is 1 if the other foot rests
    as real feet do: sliding is then possibly intended, as in dancing.
    """

    down: EndMask
    sliding: PerFoot
    velocity: Float64[np.ndarray, "instants feet 3"]
    hold: PerFoot
    lead: PerFoot
    beside: PerFoot


@dataclass(frozen=True, eq=False)
class Ground:
    """Heights of every foot joint on the ground, metres: `level` is the usual one, `floor` the 5 % quantile.

    `bottom` is the 5 % quantile of all joints together.
    """

    level: Float64[np.ndarray, "feet ends"]
    floor: Float64[np.ndarray, "feet ends"]
    bottom: float


def ground_of(paths: Float[np.ndarray, "instants feet ends 3"], fps: float) -> Ground:
    """Estimates the ground from the lowest 6 cm of slow foot-joint positions.

    A foot that never touches the ground gets the other's level, plus up to 4 cm.
    """
    speed = np.linalg.norm(velocities(paths.astype(np.float64), fps), axis=-1)
    level, floor = np.empty((2, 2)), np.empty((2, 2))
    for foot, end in np.ndindex(2, 2):
        height = paths[:, foot, end, 1].astype(np.float64)
        slow = height[speed[:, foot, end] < ENTER_SPEED[0]]
        slow = slow if len(slow) >= _FEWEST else height
        floor[foot, end] = np.quantile(slow, LEVEL_QUANTILE)
        level[foot, end] = np.median(slow[slow <= floor[foot, end] + LEVEL_METRES])
    level, floor = (np.minimum(each, each.min(axis=0) + MOST_BETWEEN_FEET_METRES) for each in (level, floor))
    return Ground(level, floor, float(np.quantile(paths[..., 1].min(axis=(1, 2)), LEVEL_QUANTILE)))


def find_contacts(paths: FootPaths, fps: float, ground: Ground, limits: Limits = CAPTURED) -> Contacts:
    """Contacts of foot joints from their paths, sampled at `fps`."""
    velocity = velocities(paths, fps)
    speed = np.linalg.norm(velocity, axis=-1)
    height = _above_ground(paths[..., 1] - ground.level, fps)
    level_speed = np.hypot(velocity[..., 0], velocity[..., 2])
    down = _down(height, speed, fps, 0)
    rests = Rests.of(down, level_speed, fps)
    beside = rests.stands[:, ::-1]
    here, around = rests.sliding(fps, limits)
    if (around > 0.5).any():
        down = np.where((around > 0.5)[:, None, None], _down(height, speed, fps, 1), down)
        rests = Rests.of(down, level_speed, fps)
    steadiest = _steadiest(down, velocity, level_speed)
    faster = np.hypot(steadiest[..., 0], steadiest[..., 2]) / (limits.rest_speed + limits.rest_times * rests.speed)
    hold, lead = (rests.on_ground / (1.0 + (faster / times) ** 4) for times in (1.0, limits.lead_times))
    return Contacts(down, np.maximum(here, around[:, None]), steadiest, hold, lead, beside)


def velocities(paths: FootPaths, fps: float) -> FootPaths:
    """Central differences over about 0.05 s; at both ends the nearest such difference."""
    reach = max(1, round(SPEED_SECONDS * fps / 2))
    count = len(paths)
    if count <= 2 * reach:
        return np.gradient(paths, 1.0 / fps, axis=0) if count > 1 else np.zeros_like(paths)
    result = np.empty_like(paths)
    np.subtract(paths[2 * reach :], paths[: -2 * reach], out=result[reach:-reach])
    result[reach:-reach] *= fps / (2 * reach)
    result[:reach], result[-reach:] = result[reach], result[-reach - 1]
    return result


def _above_ground(height: PerEnd, fps: float) -> PerEnd:
    """Heights above the feet's lowest point within a second, if that is close to their level."""
    from scipy.ndimage import minimum_filter1d, uniform_filter1d

    window = 2 * round(GROUND_SECONDS * fps / 2) + 1
    lowest = minimum_filter1d(height.min(axis=(1, 2)), window, mode="nearest")
    ground = np.clip(uniform_filter1d(lowest, window, mode="nearest"), -GROUND_METRES, GROUND_METRES)
    return np.asarray(height - ground[:, None, None])


def _down(height: PerEnd, speed: PerEnd, fps: float, kind: int) -> EndMask:
    """Joints in contact, with the limits for standing (0) to sliding (1) feet.

    Hysteresis: while a joint stays within the wider limits, if it is within the narrower ones once.
    """
    enters = (height < ENTER_METRES) & (speed < ENTER_SPEED[kind])
    stays = (height < LEAVE_METRES) & (speed < LEAVE_SPEED[kind])
    down = np.zeros_like(stays)
    for foot, end in np.ndindex(2, 2):
        for start, stop in zip(*runs(stays[:, foot, end]), strict=True):
            down[start:stop, foot, end] = enters[start:stop, foot, end].any()
    return _cleaned(down, fps)


def _cleaned(down: EndMask, fps: float) -> EndMask:
    """Closes short gaps between contacts, then removes short contacts."""
    cleaned = down.copy()
    for foot, end in np.ndindex(2, 2):
        joint = cleaned[:, foot, end]
        starts, stops = runs(joint)
        for start, stop in zip(stops[:-1], starts[1:], strict=True):
            joint[start:stop] = stop - start <= GAP_SECONDS * fps + 1e-9
        for start, stop in zip(*runs(joint), strict=True):
            joint[start:stop] = stop - start >= SHORTEST_SECONDS * fps - 1e-9
    return cleaned


def _steadiest(down: EndMask, velocity: FootPaths, speed: PerEnd) -> Float64[np.ndarray, "instants feet 3"]:
    """Weighted mean velocity of both ends, favouring the steadier: the heel may rise over a resting toe."""
    weight = down / np.square(np.square(speed) + STEADY_SPEED**2)
    total = weight.sum(axis=-1, keepdims=True)
    weight /= np.where(total > 0, total, 1.0)
    return np.asarray(np.einsum("tfe,tfex->tfx", weight, velocity))


@dataclass(frozen=True, eq=False)
class Rests:
    """For every foot in contact: its slowest 0.1 s within 0.6 s, m/s, and the creep speed of real feet."""

    on_ground: Bool[np.ndarray, "instants feet"]
    speed: PerFoot
    limit: PerFoot

    @classmethod
    def of(cls, down: EndMask, speed: PerEnd, fps: float) -> "Rests":
        """Resting speeds of feet from their joints' horizontal speeds."""
        from scipy.ndimage import minimum_filter1d, uniform_filter1d

        on_ground = np.asarray(down.any(axis=-1))
        slowest = np.where(down, speed, LEAVE_SPEED[1]).min(axis=-1)
        smooth = uniform_filter1d(slowest, max(1, round(REST_SECONDS * fps)), axis=0, mode="nearest")
        window = 2 * round(REST_WITHIN_SECONDS * fps / 2) + 1
        rests, limit = np.zeros(on_ground.shape), np.ones(on_ground.shape)
        for foot in range(2):
            for start, stop in zip(*runs(on_ground[:, foot]), strict=True):
                here = slice(start, stop)
                rests[here, foot] = minimum_filter1d(smooth[here, foot], min(window, stop - start), mode="nearest")
                limit[here, foot] = CREEP_SPEED + CREEP_AT_ONE_SECOND / ((stop - start) / fps) ** CREEP_POWER
        return cls(on_ground, rests, limit)

    @property
    def stands(self) -> PerFoot:
        """1 if a foot in contact rests as real feet do, 0 if it slides or is in the air."""
        return np.where(self.on_ground, 1.0 - smoothstep(self.speed / self.limit, *CAPTURED.around), 0.0)

    def sliding(self, fps: float, limits: Limits) -> tuple[PerFoot, Float64[np.ndarray, "instants"]]:
        """Sliding of every foot by itself, and of all feet within 10 s."""
        from scipy.ndimage import uniform_filter1d

        times = np.minimum(self.speed / self.limit, MOST_TIMES)
        window = 2 * round(AROUND_SECONDS * fps / 2) + 1
        total, count = (
            uniform_filter1d(each.sum(axis=1).astype(np.float64), window, mode="constant")
            for each in (times, self.on_ground)
        )
        around = total / np.maximum(count, 1e-9)
        return np.where(self.on_ground, smoothstep(times, *limits.here), 0.0), smoothstep(around, *limits.around)


def smoothstep(
    values: Float64[np.ndarray, "*shape"] | np.float64, start: float, stop: float
) -> Float64[np.ndarray, "*shape"]:
    """Smoothstep: 0 up to `start`, 1 from `stop` on."""
    u = np.clip((values - start) / (stop - start), 0.0, 1.0)
    return u * u * (3.0 - 2.0 * u)
