"""Synthetic motions, exact at every time: sequences of actions with varied captions."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64

from motionkit.core.errors import UsageError
from motionkit.core.motion import Caption
from motionkit.core.skeleton import Skeleton
from motionkit.fields.motion_field import Poses, check_times
from motionkit.synthetic import gestures, leaps, locomotion
from motionkit.synthetic.bodies import Body
from motionkit.synthetic.curves import band_noise, constant, wave
from motionkit.synthetic.feet import FootPath, foot_path
from motionkit.synthetic.rig import pose
from motionkit.synthetic.script import SIDES, Layer, Part, Swing, Trajectory, evaluate, integrate

ActionBuilder = Callable[[np.random.Generator, Body, float, float], Part]

ACTIONS: dict[str, ActionBuilder] = {
    "walk": locomotion.walk,
    "walk_circle": locomotion.walk_circle,
    "turn_left": locomotion.turn_left,
    "turn_right": locomotion.turn_right,
    "walk_backwards": locomotion.walk_backwards,
    "sidestep": locomotion.sidestep,
    "jog": locomotion.jog,
    "run": locomotion.run,
    "march": locomotion.march,
    "turn_in_place": locomotion.turn_in_place,
    "stand": gestures.stand,
    "wave_left": gestures.wave_left,
    "wave_right": gestures.wave_right,
    "wave_both": gestures.wave_both,
    "bow": gestures.bow,
    "squat": gestures.squat,
    "sit": gestures.sit,
    "raise_arms": gestures.raise_arms,
    "clap": gestures.clap,
    "punch": gestures.punch,
    "kick": gestures.kick,
    "throw": gestures.throw,
    "stretch": gestures.stretch,
    "jump": leaps.jump,
    "jump_forward": leaps.jump_forward,
    "jumping_jacks": leaps.jumping_jacks,
}
TRAVELLING = ("walk", "walk_circle", "turn_left", "turn_right", "walk_backwards", "sidestep", "jog", "run", "march")
SUBJECTS = ("a person", "someone", "the person", "a figure")
SHORTEST_ACTION_SECONDS = 2.0
SHORTEST_PART_SECONDS = 1.5
RUN_IN_SECONDS = 3.0


@dataclass(frozen=True, eq=False)
class SyntheticMotion:
    """A `MotionField` on [0, end_seconds] with exact ground truth: all framerates sample the same functions of time.

    The floor is y = 0; the pelvis starts above the origin with a heading of `heading` radians about +Y (0 faces +Z).
    """

    body: Body
    end_seconds: float
    layers: tuple[Layer, ...]
    swings: tuple[Swing, ...]
    heading: float = 0.0
    action: str = ""
    captions: tuple[Caption, ...] = ()

    @property
    def skeleton(self) -> Skeleton:
        """The body's skeleton."""
        return self.body.skeleton

    @property
    def start_seconds(self) -> float:
        """0."""
        return 0.0

    @cached_property
    def trajectory(self) -> Trajectory:
        """The path on the floor, some seconds longer than the motion at both ends, for steps that cross these."""
        return integrate(self.layers, -RUN_IN_SECONDS, self.end_seconds + RUN_IN_SECONDS, self.heading)

    def query(self, times_seconds: Float64[np.ndarray, "times"]) -> Poses:
        """Poses at any times in [0, end_seconds]; raises `ValueError` outside."""
        check_times(self, times_seconds)
        feet = {side: self._foot(side, times_seconds) for side in SIDES}
        return pose(self.body, self.trajectory, feet, evaluate(self.layers, times_seconds), times_seconds)

    def contacts(self, times_seconds: Float64[np.ndarray, "times"]) -> Bool[np.ndarray, "times 4"]:
        """Ground-truth contacts of left ankle, left toe, right ankle, right toe: stationary on the floor."""
        check_times(self, times_seconds)
        planted = [self._foot(side, times_seconds) for side in SIDES]
        return np.stack([contact for foot in planted for contact in (foot.ankle_planted, foot.toe_planted)], axis=-1)

    def _foot(self, side: str, times: Float64[np.ndarray, "times"]) -> FootPath:
        return foot_path(side, self.swings, self.trajectory, self.body, times)


def perform(rng: np.random.Generator, body: Body, actions: Sequence[str], duration_seconds: float) -> SyntheticMotion:
    """A random performance of one action or a sequence of several, with captions and an action label.

    The label is the first action's. Raises `UsageError` for an unknown action, and for less than two seconds per
    action.
    """
    unknown = [action for action in actions if action not in ACTIONS]
    if unknown or not actions:
        raise UsageError(f"no action is called {unknown or 'nothing'}; there are {', '.join(ACTIONS)}")
    if duration_seconds < SHORTEST_ACTION_SECONDS * len(actions):
        raise UsageError(f"{len(actions)} actions need {SHORTEST_ACTION_SECONDS * len(actions)} s or more")
    parts = _sequence(rng, body, actions, duration_seconds)
    layers = tuple(layer for part in parts for layer in part.layers)
    swings = tuple(swing for part in parts for swing in part.swings)
    return SyntheticMotion(
        body=body,
        end_seconds=duration_seconds,
        layers=(*posture(rng), *layers),
        swings=swings,
        heading=float(rng.uniform(-np.pi, np.pi)),
        action=actions[0],
        captions=_captions(rng, parts, duration_seconds),
    )


def _sequence(rng: np.random.Generator, body: Body, actions: Sequence[str], duration: float) -> list[Part]:
    """The parts in order of time; a single locomotion action may begin before 0 and end after the end."""
    if len(actions) == 1:
        under_way = actions[0] in TRAVELLING and rng.random() < 0.5
        start = -float(rng.uniform(1.0, 2.0)) if under_way else float(rng.uniform(0.05, 0.2))
        end = duration + (float(rng.uniform(1.0, 2.0)) if under_way and rng.random() < 0.7 else -0.05)
        return [ACTIONS[actions[0]](rng, body, start, end)]
    shares = rng.uniform(0.8, 1.2, len(actions))
    free = duration - SHORTEST_ACTION_SECONDS * len(actions)
    planned = np.cumsum(SHORTEST_ACTION_SECONDS + free * shares / shares.sum()) - 0.25
    parts: list[Part] = []
    start = 0.05
    for action, planned_end in zip(actions, planned, strict=True):
        part = ACTIONS[action](rng, body, start, max(float(planned_end), start + SHORTEST_PART_SECONDS))
        # A jump or a last step may take longer than planned: the next action waits for it.
        start = max([part.end, *(swing.touchdown for swing in part.swings)]) + 0.15
        parts.append(part)
    return parts


def posture(rng: np.random.Generator) -> tuple[Layer, ...]:
    """Posture and breathing of a performer: constant angles, slow sway, and a tremor of up to 45 Hz."""
    slouch = float(rng.normal(0.03, 0.03))
    breath = float(rng.uniform(0.2, 0.35))
    layers = [
        Layer("spine_pitch", constant(slouch)),
        Layer("spine_pitch", wave(breath, float(rng.uniform(0, 5)), 0.012)),
        Layer("head_pitch", constant(float(rng.normal(0.05, 0.05)))),
        Layer("pelvis_pitch", constant(float(rng.normal(0.02, 0.02)))),
    ]
    for side in SIDES:
        layers += [
            Layer(f"{side}_arm_elevation", constant(float(rng.uniform(0.08, 0.20)))),
            Layer(f"{side}_arm_azimuth", constant(float(rng.uniform(0.8, 1.1)))),
            Layer(f"{side}_elbow", constant(float(rng.uniform(0.15, 0.35)))),
            Layer(f"{side}_arm_elevation", band_noise(rng, 0.030, 0.1, 3.0)),
            Layer(f"{side}_elbow", band_noise(rng, 0.040, 0.1, 4.0)),
            Layer(f"{side}_elbow", band_noise(rng, 0.0030, 8.0, 45.0)),
            Layer(f"{side}_arm_elevation", band_noise(rng, 0.0015, 8.0, 45.0)),
        ]
    for channel, sway in (("spine_pitch", 0.015), ("spine_roll", 0.012), ("spine_yaw", 0.02), ("head_yaw", 0.05)):
        layers.append(Layer(channel, band_noise(rng, sway, 0.1, 2.5)))
    for channel, tremor in (("spine_pitch", 0.0012), ("spine_roll", 0.0012), ("head_pitch", 0.002)):
        layers.append(Layer(channel, band_noise(rng, tremor, 8.0, 45.0)))
    layers += [Layer(f"pelvis_{way}", band_noise(rng, 0.006, 0.1, 1.5)) for way in ("left", "forward")]
    layers += [Layer(f"pelvis_{way}", band_noise(rng, 0.0004, 8.0, 40.0)) for way in ("left", "forward")]
    return tuple(layers)


def _captions(rng: np.random.Generator, parts: Sequence[Part], duration: float) -> tuple[Caption, ...]:
    """Three captions of the whole motion; for several actions also one of each, with its seconds."""
    captions = []
    subjects = (*SUBJECTS, "a man" if rng.random() < 0.5 else "a woman")
    for index in rng.permutation(max(3, len(parts[0].phrases)))[:3]:
        phrases = [part.phrases[int(index) % len(part.phrases)] for part in parts]
        subject = subjects[int(rng.integers(len(subjects)))]
        captions.append(Caption(f"{subject} {_joined(rng, phrases)}"))
    if len(parts) > 1:
        for part in parts:
            subject = subjects[int(rng.integers(len(subjects)))]
            start, end = max(part.start, 0.0), min(part.end, duration)
            phrase = part.phrases[int(rng.integers(len(part.phrases)))]
            # Hundredths of a second, rounded down: the last caption must not end after the motion.
            captions.append(Caption(f"{subject} {phrase}", math.floor(100 * start) / 100, math.floor(100 * end) / 100))
    return tuple(captions)


def _joined(rng: np.random.Generator, phrases: Sequence[str]) -> str:
    joint = (", then ", " and then ", ", after that ")[int(rng.integers(3))]
    return joint.join(phrases)
