"""The kinematic descriptor, version 3: what bodies do below 8 Hz, by its distribution.

Poses and their spread, power in three slow bands, speeds, sliding feet, height above the floor, and the direction of
time. Nothing above 8 Hz: a sum that sees fast motion is won by adding noise, and one that does not see it is blind. So
fast motion has figures of its own (`eval.detail`; docs/results/games.md).
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property

import numpy as np

from eval.clip_fid.channels import (
    NUM_GROUPS,
    SLOW_BANDS,
    SLOW_NOISE_METRES,
    Channels,
    channels,
    noise_power,
)
from eval.clip_fid.threads import in_threads
from eval.sets.sets import Ragged, SampleSet
from motionkit.core.shapes import Float, Float32, Float64

VERSION = "kinematic/3"
NUM_POSE_COMPONENTS = 10

SIZES: Mapping[str, int] = {
    "pose": NUM_POSE_COMPONENTS,
    "spread": NUM_POSE_COMPONENTS,
    "slow": 2 * NUM_GROUPS,
    "upper slow": NUM_GROUPS,
    "speed": NUM_GROUPS,
    "slip": 2,
    "height": 1,
    "direction": 1 + NUM_GROUPS,
}
"""Number of features of each block, in order."""
# Weights were chosen on training takes alone (docs/metrics.md): every block's total variance on real training clips.
WEIGHTS: Mapping[str, float] = {
    "pose": 1.0,
    "spread": 1.0,
    "slow": 5.5,
    "upper slow": 0.45,
    "speed": 1.0,
    "slip": 1.3,
    "height": 1.0,
    "direction": 1.0,
}

SPREAD_FLOOR_METRES = 0.005
LEAST_LOG_SPREAD = 0.25
LEAST_POSE_SPREAD = 0.02
LEAST_SPREADS: Mapping[str, float] = {"pose": LEAST_POSE_SPREAD, "height": LEAST_POSE_SPREAD, "direction": 0.1}
"""Minimum standard deviations for the standardisation: metres, metres per second; `LEAST_LOG_SPREAD` for logarithms."""


def _blocks() -> dict[str, slice]:
    stops = np.cumsum(list(SIZES.values())).tolist()
    return {name: slice(stop - size, stop) for (name, size), stop in zip(SIZES.items(), stops, strict=True)}


BLOCKS: Mapping[str, slice] = _blocks()
NUM_FEATURES = sum(SIZES.values())


@dataclass(frozen=True, eq=False)
class KinematicDescriptor:
    """The descriptor fitted at one framerate.

    `pose_mean` [63] and `pose_components` [10, 63] span poses relative to root and heading; `centre` and `scale`
    standardise the features, and weigh them.
    """

    fps: Fraction
    pose_mean: Float64[np.ndarray, "coordinates"]
    pose_components: Float64[np.ndarray, "components coordinates"]
    centre: Float64[np.ndarray, "features"]
    scale: Float64[np.ndarray, "features"]

    @property
    def name(self) -> str:
        """Name for tables."""
        return "kinematic"

    @cached_property
    def fingerprint(self) -> str:
        """First 16 hex digits of the sha256 over version, framerate and every fitted number."""
        digest = hashlib.sha256(f"{VERSION} {self.fps}".encode())
        for array in (self.pose_mean, self.pose_components, self.centre, self.scale):
            digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return digest.hexdigest()[:16]

    def frames(self, samples: SampleSet) -> Ragged:
        """A row for every pose of the motions, of which clips are averages: [rows, numbers], float32."""
        if samples.fps != self.fps:
            raise ValueError(f"this descriptor was fitted at {self.fps} fps; {samples.name} is at {samples.fps} fps")
        return Ragged.of(list(in_threads(lambda motion: self.rows(channels(motion, self.fps)), samples.sequences)))

    def rows(self, motion: Channels) -> Float32[np.ndarray, "frames numbers"]:
        """A row for every pose of a motion, of which clips are averages."""
        scores = (motion.pose - self.pose_mean) @ self.pose_components.T
        power = motion.power.reshape(len(scores), -1)
        averaged = (motion.log_speed, motion.log_foot_speed, motion.height, motion.direction)
        return np.concatenate((scores, np.square(scores), power, *averaged), axis=1, dtype=np.float32)

    def describe(
        self, clips: Float[np.ndarray, "clips poses numbers"], fps: Fraction
    ) -> Float64[np.ndarray, "clips features"]:
        """Features of clips of the output of `frames`. Raises `ValueError` for another framerate."""
        if fps != self.fps:
            raise ValueError(f"this descriptor was fitted at {self.fps} fps; clips at {fps} fps need one of their own")
        described: Float64[np.ndarray, "clips features"] = (_raw_features(clips) - self.centre) * self.scale
        return described


def fit_kinematic(motions: Sequence[Channels], fps: Fraction) -> KinematicDescriptor:
    """Fit the components on real training motions at one framerate; `standardised` does the rest.

    A component's sign is fixed by its largest coordinate, so that the fit does not depend on the linear algebra
    library. Raises `ValueError` for no motion.
    """
    if not motions:
        raise ValueError("fitting the kinematic descriptor needs at least one motion")
    poses = np.concatenate([motion.pose for motion in motions])
    pose_mean = poses.mean(axis=0)
    _, eigenvectors = np.linalg.eigh((poses - pose_mean).T @ (poses - pose_mean) / len(poses))
    components = eigenvectors.T[::-1][:NUM_POSE_COMPONENTS]
    largest = np.take_along_axis(components, np.abs(components).argmax(axis=1)[:, None], axis=1)
    signed = np.ascontiguousarray(components * np.sign(largest))
    return KinematicDescriptor(fps, pose_mean, signed, np.zeros(NUM_FEATURES), np.ones(NUM_FEATURES))


def standardised(fitted: KinematicDescriptor, described: Float64[np.ndarray, "clips features"]) -> KinematicDescriptor:
    """The descriptor with centre and weights measured on training clips, which `fitted` has described."""
    spread, scale = described.std(axis=0), np.empty(NUM_FEATURES)
    for name, block in BLOCKS.items():
        least = LEAST_SPREADS.get(name, LEAST_LOG_SPREAD)
        scale[block] = np.sqrt(WEIGHTS[name] / SIZES[name]) / np.maximum(spread[block], least)
    return replace(fitted, centre=described.mean(axis=0), scale=scale)


def _raw_features(clips: Float[np.ndarray, "clips poses numbers"]) -> Float64[np.ndarray, "clips features"]:
    """Means over the clip, those of powers as logarithms above their floors, before standardisation."""
    means = clips.mean(axis=1, dtype=np.float64)
    sizes = np.cumsum((NUM_POSE_COMPONENTS, NUM_POSE_COMPONENTS, NUM_GROUPS * len(SLOW_BANDS)))
    pose, squares, power, others = np.split(means, sizes, axis=1)
    spread = 0.5 * np.log(np.maximum(squares - np.square(pose), 0.0) + SPREAD_FLOOR_METRES**2)
    floors = np.concatenate(
        [noise_power((band,), metres) for band, metres in zip(SLOW_BANDS, SLOW_NOISE_METRES, strict=True)]
    )
    log_power = 0.5 * np.log(np.maximum(power, 0.0) + np.repeat(floors, NUM_GROUPS))
    return np.concatenate((pose, spread, log_power, others), axis=1)
