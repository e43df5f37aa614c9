"""The foot-sliding correction as a function of time: offsets of the body and of both feet, computed in blocks."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from motionkit.core.shapes import Bool, Float64
from motionkit.fields.contact.detection import (
    CAPTURED,
    GENERATED,
    Contacts,
    Ground,
    find_contacts,
    ground_of,
    runs,
    smoothstep,
)
from motionkit.fields.contact.legs import Legs
from motionkit.fields.contact.offsets import Costs, Wishes, solve_offsets

Path = Literal["near", "free", "kept"]
"""Whether the body returns to its path, may end elsewhere (where its planted feet carry it), or stays on its path.

If the path is `kept` (to a few centimetres), feet slide by what the legs cannot reach.
"""

LEVEL_COSTS = {
    "near": Costs(foot_down=0.05, foot_up=1.0, foot_sudden=2e-4, body=0.02, body_sudden=3e-3),
    "free": Costs(foot_down=0.05, foot_up=1.0, foot_sudden=2e-4, body=1e-6, body_sudden=3e-3),
    "kept": Costs(foot_down=0.05, foot_up=1.0, foot_sudden=2e-4, body=3.0, body_sudden=3e-3),
}
HEIGHT_COSTS = Costs(foot_down=0.05, foot_up=1.0, foot_sudden=2e-4, body=0.3, body_sudden=3e-3)
REACH_METRES = {"near": (0.12, 0.25), "free": (0.15, 0.3), "kept": (0.15, 0.3)}
"""Feet that would need a larger offset beside the body were dragged or stand there by intent: not corrected."""
KEPT_SHARE = 0.02
"""Fraction of its velocity that a sliding foot keeps: real feet are never quite still."""
STEP_DOWN_METRES = (0.02, 0.04)
"""A captured foot lower than this, in a motion without sliding, steps down or pushes off: not corrected."""
FLOATING, SUNK, STEADY_HEIGHT = 100.0, 1000.0, 0.05
"""Costs of metres² above and below the ground, and of (m/s)² of an offset's vertical velocity."""
ABOVE_METRES, BELOW_METRES, HIGHEST_METRES = (0.03, 0.003), 0.003, (0.05, 0.08)
"""Tolerated heights above the ground, without and with sliding; tolerated depth; height that isn't corrected."""
HEIGHT_ROUNDS, TOLERATED_METRES = 2, 0.001
"""Feet that the other foot's correction pulls further below the ground are raised in a second pass."""

BLOCK_SECONDS, MARGIN_SECONDS, FADE_SECONDS = 180.0, 12.0, 1.0
BLOCKS_KEPT = 3
LEVEL_STRETCHES, LEVEL_STRETCH_SECONDS = 24, 10.0
FEWEST_INSTANTS = 4
HELD = 1e9


@dataclass(frozen=True, eq=False)
class Block:
    """A segment of the grid from sample `first` on: foot positions, contacts, and the offsets."""

    first: int
    paths: Float64[np.ndarray, "instants feet ends 3"]
    contacts: Contacts
    offsets: Float64[np.ndarray, "instants 3 3"]

    def at(self, place: Float64[np.ndarray, "times"]) -> Float64[np.ndarray, "times 3 3"]:
        """The offsets at fractional grid positions, by C1 cubic interpolation."""
        values = self.offsets
        place = np.clip(place - self.first, 0.0, len(values) - 1.0)
        row = np.minimum(place.astype(np.int64), len(values) - 2)
        u = (place - row)[:, None, None]
        before, after = np.maximum(row - 1, 0), np.minimum(row + 2, len(values) - 1)
        start, stop = values[row], values[row + 1]
        # Central differences; one-sided at the ends of the motion.
        rise, later = (stop - values[before]) / (row + 1 - before)[:, None, None], values[after] - start
        later /= (after - row)[:, None, None]
        step = stop - start
        return np.asarray(
            start + u * (rise + u * ((3.0 * step - 2.0 * rise - later) + u * (rise + later - 2.0 * step)))
        )


@dataclass(frozen=True, eq=False)
class Correction:
    """Offsets of body, left and right foot at any instant of a motion, metres.

    `positions(start, stop)` are the joints (at least those of the feet) at samples [start, stop) of a grid of `count`
    samples, `fps` per second from `start_seconds` on. Blocks of three minutes are computed on demand, with 12 s of
    context on both sides, and blended into one another, so memory doesn't grow with the motion. `down(start, stop)`
    returns which foot joints are on the ground if the motion predicts contacts; else they are detected from the feet's
    paths.
    """

    legs: Legs
    positions: Callable[[int, int], Float64[np.ndarray, "instants joints 3"]]
    start_seconds: float
    fps: float
    count: int
    path: Path
    down: Callable[[int, int], Bool[np.ndarray, "instants feet ends"]] | None = None

    def at(self, times_seconds: Float64[np.ndarray, "times"]) -> Float64[np.ndarray, "times 3 3"]:
        """The offsets at any times; constant before the first sample and after the last one."""
        place = (times_seconds - self.start_seconds) * self.fps
        found = np.zeros((len(place), 3, 3))
        if not self.works:
            return found
        number = np.clip(np.floor(place / self._block_length), 0, self.num_blocks - 1).astype(np.int64)
        for each in np.unique(number).tolist():
            rows = np.flatnonzero(number == each)
            found[rows] = self._in_block(each, place[rows])
        return found

    @property
    def num_blocks(self) -> int:
        """Number of blocks; a motion shorter than two blocks is one."""
        return max(1, self.count // self._block_length)

    @property
    def works(self) -> bool:
        """Whether the motion is long enough to detect contacts."""
        return self.count >= FEWEST_INSTANTS

    def own(self, number: int) -> slice:
        """Rows of a block that don't overlap other blocks."""
        first = self.block(number).first
        last = number == self.num_blocks - 1
        stop = self.count if last else (number + 1) * self._block_length
        return slice(number * self._block_length - first, stop - first)

    @cached_property
    def block(self) -> Callable[[int], Block]:
        """A block by number, its offsets continuous with the previous block's."""
        return lru_cache(BLOCKS_KEPT)(self._block)

    @cached_property
    def _alone(self) -> Callable[[int], Block]:
        return lru_cache(BLOCKS_KEPT)(self._raw)

    @cached_property
    def ground(self) -> Ground:
        """Ground height, estimated from the whole motion, or from some minutes spread over one of several blocks."""
        if self.num_blocks == 1:
            return ground_of(self._paths(0, self.count), self.fps)
        stretch = round(LEVEL_STRETCH_SECONDS * self.fps)
        starts = np.linspace(0, self.count - stretch, LEVEL_STRETCHES).astype(np.int64)
        each = [ground_of(self._paths(start, start + stretch), self.fps) for start in starts.tolist()]
        level, floor = (np.median([getattr(one, name) for one in each], axis=0) for name in ("level", "floor"))
        return Ground(level, floor, float(np.median([one.bottom for one in each])))

    @property
    def _block_length(self) -> int:
        return round(BLOCK_SECONDS * self.fps)

    @cached_property
    def _paths(self) -> Callable[[int, int], Float64[np.ndarray, "instants feet ends 3"]]:
        """Foot paths at samples [start, stop); the last ones are kept, since a motion of one block needs them twice."""

        @lru_cache(1)
        def paths(start: int, stop: int) -> Float64[np.ndarray, "instants feet ends 3"]:
            return self.legs.foot_paths(self.positions(start, stop)).astype(np.float64)

        return paths

    def _in_block(self, number: int, place: Float64[np.ndarray, "times"]) -> Float64[np.ndarray, "times 3 3"]:
        found = self.block(number).at(place)
        u = (place - number * self._block_length) / (FADE_SECONDS * self.fps)
        fades = np.flatnonzero((u < 1.0) & (number > 0))
        if len(fades):
            u = u[fades, None, None]
            before = self.block(number - 1).at(place[fades])
            found[fades] = before + u**3 * (10.0 - 15.0 * u + 6.0 * u * u) * (found[fades] - before)
        return found

    def _block(self, number: int) -> Block:
        start = self._start(number)
        alone = self._alone(number)
        return replace(alone, offsets=alone.offsets + start * np.array([[1.0], [0.0], [0.0]]))

    @cached_property
    def _starts(self) -> list[Float64[np.ndarray, "3"]]:
        return [np.zeros(3)]

    def _start(self, number: int) -> Float64[np.ndarray, "3"]:
        """Initial body offset of a block, continuous with the previous block; computes earlier blocks first."""
        while self.path == "free" and len(self._starts) <= number:
            after = len(self._starts)
            middle = np.array([after * self._block_length + FADE_SECONDS * self.fps / 2])
            step = self._alone(after - 1).at(middle)[0, 0] - self._alone(after).at(middle)[0, 0]
            self._starts.append(self._starts[-1] + step * (1.0, 0.0, 1.0))
        return self._starts[number] if self.path == "free" else self._starts[0]

    def _raw(self, number: int) -> Block:
        margin = round(MARGIN_SECONDS * self.fps)
        first = max(0, number * self._block_length - margin)
        last = number == self.num_blocks - 1
        stop = self.count if last else min(self.count, (number + 1) * self._block_length + margin)
        paths = self._paths(first, stop)
        offered = None if self.down is None else self.down(first, stop)
        limits = CAPTURED if self.path == "near" else GENERATED
        contacts = find_contacts(paths, self.fps, self.ground, offered, limits)
        return Block(first, paths, contacts, offsets_of(paths, contacts, self.ground, self.fps, self.path))


def offsets_of(
    paths: Float64[np.ndarray, "instants feet ends 3"], contacts: Contacts, ground: Ground, fps: float, path: Path
) -> Float64[np.ndarray, "instants 3 3"]:
    """The offsets of body, left and right foot at every sample of the grid, metres."""
    found = np.zeros((len(paths), 3, 3))
    both = np.minimum(contacts.hold[1:], contacts.hold[:-1])
    if contacts.sliding.any():
        found[..., [0, 2]] = _level_offsets(contacts, fps, path)
    heights = paths[..., 1]
    lowest = _lowest(heights, contacts, ground, path)
    raised = np.zeros(contacts.hold.shape)
    for _ in range(HEIGHT_ROUNDS):
        height, weight = _heights(heights, raised, lowest, contacts, ground)
        if not height.any():
            break
        wishes = Wishes(np.zeros((*both.shape, 1)), STEADY_HEIGHT * both, height[..., None], weight)
        found[..., [1]] = solve_offsets(wishes, contacts.hold, fps, HEIGHT_COSTS)
        raised = found[:, 0, [1]] + found[:, 1:, 1]
        if (heights + raised[..., None] > lowest - TOLERATED_METRES).all():
            break
    return found


def _level_offsets(contacts: Contacts, fps: float, path: Path) -> Float64[np.ndarray, "instants 3 2"]:
    """Offsets along X and Z that remove the sliding of feet in contact, where the legs can reach.

    A captured foot may slide beside one that rests.
    """
    share = contacts.sliding * (1.0 - contacts.beside) if path == "near" else contacts.sliding
    slid = contacts.velocity[..., [0, 2]] * ((1.0 - KEPT_SHARE) * share)[..., None]
    wanted = -0.5 * (slid[1:] + slid[:-1])
    found = _carried(wanted, contacts.hold, contacts.lead, fps, LEVEL_COSTS[path])
    within = _within_reach(found[:, 1:], contacts, path)
    if (within < 1.0).any():
        found = _carried(wanted, contacts.hold * within, contacts.lead * within, fps, LEVEL_COSTS[path])
    return found


def _carried(
    wanted: Float64[np.ndarray, "steps feet 2"],
    hold: Float64[np.ndarray, "instants feet"],
    lead: Float64[np.ndarray, "instants feet"],
    fps: float,
    costs: Costs,
) -> Float64[np.ndarray, "instants 3 2"]:
    """Offsets that compensate these velocities while feet are held: the body's first, then the feet's again."""
    both = np.minimum(hold[1:], hold[:-1])
    wishes = Wishes(wanted, both, np.zeros((*lead.shape, 2)), np.zeros(lead.shape))
    found = solve_offsets(wishes, hold, fps, costs)
    # The feet again with the body fixed: legs absorb the velocities of feet in transition that the body ignored.
    step = np.diff(found[:, :1], axis=0) * fps
    wishes = replace(wishes, velocity=wanted - step, velocity_weight=np.minimum(lead[1:], lead[:-1]))
    found[:, 1:] = solve_offsets(wishes, lead, fps, replace(costs, body=HELD))[:, 1:]
    return found


def _within_reach(
    feet: Float64[np.ndarray, "instants feet 2"], contacts: Contacts, path: Path
) -> Float64[np.ndarray, "instants feet"]:
    """1 if a foot stays near its original offset from the body, 0 if far; per whole contact for captures."""
    distance = np.hypot(feet[..., 0], feet[..., 1])
    if path == "near":
        distance = _largest(distance, np.asarray(contacts.down.any(axis=-1)))
    return 1.0 - smoothstep(distance, *REACH_METRES[path])


def _largest(
    values: Float64[np.ndarray, "instants feet"], during: Bool[np.ndarray, "instants feet"]
) -> Float64[np.ndarray, "instants feet"]:
    """Each segment's maximum over the whole segment; 0 between."""
    found = np.zeros_like(values)
    for foot in range(2):
        starts, stops = runs(during[:, foot])
        if len(starts):
            largest = np.maximum.reduceat(np.where(during[:, foot], values[:, foot], 0.0), starts)
            found[during[:, foot], foot] = np.repeat(largest, stops - starts)
    return found


def _lowest(
    heights: Float64[np.ndarray, "instants feet ends"], contacts: Contacts, ground: Ground, path: Path
) -> Float64[np.ndarray, "instants feet ends"]:
    """Lowest allowed foot height: the feet's level if the motion slides, the range of real feet otherwise.

    With a free path (generated motion) there is one floor, the lower foot's level. Captured feet may be far below
    theirs, at a step down or as a toe pushes off.
    """
    floor = ground.floor - BELOW_METRES
    lowest = floor + (np.maximum(ground.level - BELOW_METRES, floor) - floor) * contacts.sliding[..., None]
    if path != "near":
        one_floor = max(ground.bottom, ground.level.min()) - BELOW_METRES if path == "free" else -np.inf
        return np.asarray(np.maximum(lowest, one_floor))
    depth = (lowest - heights).max(axis=-1)
    down = smoothstep(_largest(depth, depth > 0), *STEP_DOWN_METRES) * (1.0 - contacts.sliding)
    return np.asarray(lowest - (down * np.maximum(depth, 0.0))[..., None])


def _heights(
    height: Float64[np.ndarray, "instants feet ends"],
    raised: Float64[np.ndarray, "instants feet"],
    lowest: Float64[np.ndarray, "instants feet ends"],
    contacts: Contacts,
    ground: Ground,
) -> tuple[Float64[np.ndarray, "instants feet"], Float64[np.ndarray, "instants feet"]]:
    """Target rise of each foot and its weight: for the lower end of a planted foot, and any end below the ground.

    Ends count as below the ground before or after they have been `raised`.
    """
    sliding = contacts.sliding[..., None]
    above = ABOVE_METRES[0] + (ABOVE_METRES[1] - ABOVE_METRES[0]) * sliding
    floats = np.where(contacts.down, np.maximum(height - ground.level - above, 0.0), np.inf).min(axis=-1)
    # Feet held or standing higher are on a step, on tiptoe, or in the air.
    floats = np.where(floats < HIGHEST_METRES[1], floats, 0.0)
    floats *= np.clip((HIGHEST_METRES[1] - floats) / (HIGHEST_METRES[1] - HIGHEST_METRES[0]), 0.0, 1.0)
    sunk = (lowest - height).max(axis=-1)
    is_sunk = sunk > np.minimum(raised, 0.0)
    return np.where(is_sunk, sunk, -floats), np.where(is_sunk, SUNK, FLOATING * contacts.hold)
