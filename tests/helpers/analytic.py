"""Analytic motion: a body of the 22-joint layout whose pose is a closed-form function of time, at any framerate."""

from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.core import kinematics as km
from motionkit.core.motion import Caption, Motion
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.fields.motion_field import Poses, to_motion
from motionkit.store.writer import StoreWriter

ACTIONS: dict[str, dict[str, float]] = {
    "walk": {"speed": 0.8, "lift": 0.08, "dip": 0.02, "arms": 0.4},
    "circle": {"speed": 0.7, "turn": 0.7, "lift": 0.08, "dip": 0.02, "arms": 0.4},
    "run": {"speed": 1.6, "frequency": 1.4, "stance": 0.4, "lift": 0.2, "dip": 0.04, "arms": 0.7},
    "squat": {"frequency": 0.25, "dip": 0.3, "arms": 0.1},
    "bow": {"frequency": 0.4, "bow": 0.9},
    "wave": {"wave": 2.4},
}
# In SMPL22's rest pose the toes are as high as the ankles. Here they are 6 cm lower, on the floor y = 0.
BODY = replace(SMPL22, offsets=SMPL22.offsets - np.float32([[0, 0.06 * (joint in (10, 11)), 0] for joint in range(22)]))


@dataclass(frozen=True)
class AnalyticMotion:
    """A `MotionField` on [0, end_seconds] in metres, radians and strides of `frequency` hertz.

    The root moves at `speed` along its heading, which turns left at `turn` rad/s from `start_heading` (0 faces +z).
    Its height falls by `dip` twice a stride. A foot stands still on the floor for the share `stance` of each stride.
    """

    end_seconds: float
    skeleton: Skeleton = BODY
    start_heading: float = 0.0
    speed: float = 0.0
    turn: float = 0.0
    frequency: float = 1.0
    stance: float = 0.6
    lift: float = 0.0
    dip: float = 0.0
    bow: float = 0.0
    wave: float = 0.0
    arms: float = 0.0
    start_seconds: float = 0.0

    def heading(self, times: np.ndarray) -> np.ndarray:
        """Radians about +y, of the shape of `times`."""
        return np.asarray(self.start_heading + self.turn * times)

    def root(self, times: np.ndarray) -> np.ndarray:
        """Positions of the pelvis [..., 3]."""
        chord, direction = self.speed * times * np.sinc(self.turn * times / (2 * np.pi)), self.heading(times / 2)
        bones = self.skeleton.offsets.astype(float)
        half_step = (self.speed + 0.2 * self.turn) * self.stance / (2 * self.frequency)
        standing = 0.97 * np.sqrt((bones[4, 1] + bones[7, 1]) ** 2 - half_step**2) - bones[10, 1]
        height = standing - self.dip * np.sin(2 * np.pi * self.frequency * times) ** 2
        return np.stack((chord * np.sin(direction), height, chord * np.cos(direction)), axis=-1)

    def root_velocity(self, times: np.ndarray) -> np.ndarray:
        """Derivative of `root` in m/s [..., 3]."""
        heading, cycle = self.heading(times), 2 * np.pi * self.frequency
        upward = -cycle * self.dip * np.sin(2 * cycle * times)
        return np.stack((self.speed * np.sin(heading), upward, self.speed * np.cos(heading)), axis=-1)

    def feet(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Left and right ankle [T, 2, 3], yaw of the foot [T, 2], and whether ankle and toes stand still [T, 2]."""
        strides = self.frequency * times[:, None] - (0, 0.5)
        swing = np.clip((strides % 1 - self.stance) / (1 - self.stance), 0, 1)
        moved = swing**3 * (10 - 15 * swing + 6 * swing**2)
        # A foot stands under where its hip is in the middle of the stance.
        middle = (np.floor(strides) + self.stance / 2 + (0, 0.5)) / self.frequency
        hips = self.skeleton.offsets[[1, 2]].astype(float)
        before, after = (
            self.root(at) + km.quaternion_rotate(_about(1, self.heading(at)), hips)
            for at in (middle, middle + 1 / self.frequency)
        )
        ankles = before + moved[..., None] * (after - before)
        ankles[..., 1] = self.lift * (4 * swing * (1 - swing)) ** 3 - self.skeleton.offsets[10, 1]
        return ankles, self.heading(middle + moved / self.frequency), (swing == 0) | (self.lift == 0)

    def query(self, times: np.ndarray) -> Poses:
        """Poses at times in seconds [T]."""
        bones, root, cycle = self.skeleton.offsets.astype(float), self.root(times), 2 * np.pi * self.frequency * times
        ankles, yaws, _ = self.feet(times)
        turns = np.zeros((len(times), 22, 3))
        turns[:, 0, 1] = self.heading(times)
        turns[:, [3, 6, 9], 0] = self.bow * np.sin(cycle / 2)[:, None] ** 2 / 3
        turns[:, [16, 17], 0] = self.arms * np.sin(cycle)[:, None] * (1, -1)
        turns[:, [18, 19], 0] = turns[:, [16, 17], 0] - self.arms - 0.3
        turns[:, 17, 2] = self.wave * (0.1 * np.sin(4 * cycle) - np.sin(np.pi * times / self.end_seconds) ** 2)
        local = km.rotation_vector_to_quaternion(turns)
        pelvis, thighs, shins = local[:, :1], bones[[4, 5]], bones[[7, 8]]
        reach = km.quaternion_rotate(km.quaternion_conjugate(pelvis), ankles - root[:, None]) - bones[[1, 2]]
        cosine = (np.sum(reach**2 - thighs**2 - shins**2, axis=-1)) / (2 * thighs * shins)[:, 1]
        knees = _about(0, np.arccos(np.clip(cosine, -1, 1)))
        hips = km.quaternion_between(thighs + km.quaternion_rotate(knees, shins), reach)
        legs = km.quaternion_multiply(pelvis, km.quaternion_multiply(hips, knees))
        local[:, [1, 2]], local[:, [4, 5]] = hips, knees
        local[:, [7, 8]] = km.quaternion_multiply(km.quaternion_conjugate(legs), _about(1, yaws))
        positions = km.forward_kinematics(local, root, self.skeleton)
        return Poses(_rounded(positions, 20), _rounded(local, 23), _rounded(root, 20))


def analytic_motion(action: str = "walk", seconds: float = 4.0, seed: int = 0) -> AnalyticMotion:
    """An action by a body whose size, heading and tempo depend on the seed."""
    size, heading, tempo = np.modf(seed * np.array([0.8192, 0.6711, 0.5498]))[0]
    found = AnalyticMotion(seconds, BODY.scaled(0.9 + 0.2 * size), 6 * heading, **ACTIONS[action])
    return replace(found, frequency=found.frequency * (0.9 + 0.2 * tempo), speed=found.speed * (0.9 + 0.2 * tempo))


def capture(fps: Fraction, action: str = "walk", seconds: float = 6.0, noise: float = 0.0, seed: int = 0) -> Motion:
    """An action sampled at a framerate, with white noise of a standard deviation in metres on every joint."""
    motion = to_motion(analytic_motion(action, seconds, seed), fps)
    shaken = motion.joint_positions + noise * np.random.default_rng([seed, 5]).standard_normal(
        (motion.num_frames, 22, 3)
    )
    return replace(motion, joint_positions=shaken.astype(np.float32))


def write_analytic_store(path: Path, sequences: int = 12, seconds: float = 4.0) -> Path:
    """A store of captioned sequences, by turns of each action, framerate (120, 30, 60, 20 fps) and split.

    Two thirds are for training; twelve sequences have every action and every framerate among those.
    """
    with StoreWriter.create(path) as writer:
        for seed in range(sequences):
            action, fps = list(ACTIONS)[seed % len(ACTIONS)], Fraction((120, 30, 60, 20)[seed % 4])
            motion = to_motion(analytic_motion(action, seconds, seed), fps)
            captions = (Caption(f"a person does a {action}"), Caption(f"the {action} begins", 0.0, seconds / 2))
            split = ("train", "train", "test", "train", "val", "train", "train")[seed % 7]
            writer.add(replace(motion, captions=captions, action=action, split=split, sequence_id=f"sequence-{seed}"))
    return path


def _about(axis: int, radians: np.ndarray) -> np.ndarray:
    return km.rotation_vector_to_quaternion(radians[..., None] * np.eye(3)[axis])


def _rounded(values: np.ndarray, bits: int) -> np.ndarray:
    """Multiples of 2^-bits: sines that differ in their last digit become equal, and −0 becomes 0."""
    return (np.round(values * 2**bits) / 2**bits + 0.0).astype(np.float32)
