"""The first kinematic descriptor of a clip, which noise deceives (docs/results/games.md).

Fixed float64 statistics of its poses, accelerations, speeds and foot slip.

It needs no weights. A network trained to match text and motion scores upsampled or smoothed motion like clean motion;
this descriptor detects both by accelerations in bands relative to the clip's Nyquist frequency.
Every quantity is per second or relative, so its meaning does not change with the framerate.
"""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from eval.clip_fid.channels import FEET, GROUP_MEANS, JOINT_GROUPS, NUM_JOINTS, local_poses
from motionkit.core.files import whole_file
from motionkit.core.shapes import Float, Float64

VERSION = "kinematic/1"
BAND_EDGES = (0.0, 0.17, 0.34, 0.5, 0.75, 1.0)
"""Edges of the acceleration bands as fractions of the Nyquist frequency."""
NUM_POSE_COMPONENTS = 10
LEVEL_QUANTILES = (0.25, 0.75)
SLIP_QUANTILES = (0.0, 0.25, 0.5, 0.75)
SLIP_SECONDS = 0.1
MIN_POSES = 8

# Floors under the logarithms: differences below them are rounding or measurement noise, not motion.
SPREAD_FLOOR_METRES = 0.005
ACCELERATION_FLOOR = 0.05
SPEED_FLOOR = 0.01
SLIP_FLOOR = 0.005

# Minimum standard deviations for the standardisation. Real captures lie above them (logarithms 0.5 … 2, pose means
# 0.06 … 0.6 m); without them, in a corpus of perfectly planted feet any slip would be hundreds of deviations.
LEAST_LOG_SPREAD = 0.25
LEAST_POSE_SPREAD = 0.02

CHUNK_CLIPS = 256
"""Clips per batch, so that their accelerations stay in the processor's cache."""

BLOCKS: Mapping[str, slice] = {
    "pose": slice(0, 20),
    "acceleration": slice(20, 45),
    "level": slice(45, 55),
    "speed": slice(55, 60),
    "slip": slice(60, 65),
}
NUM_FEATURES = 65


@dataclass(frozen=True, eq=False)
class KinematicDescriptor:
    """The descriptor with the principal components and the standardisation fitted at one framerate.

    `pose_mean` [63] and `pose_components` [10, 63] span joint positions relative to root and heading; `centre` and
    `scale` [65] standardise each number and give every block a total variance of 1 on the clips it was fitted on (less
    where a number hardly varies).
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

    def describe(
        self, clips: Float[np.ndarray, "clips poses joints 3"], fps: Fraction
    ) -> Float64[np.ndarray, "clips features"]:
        """65 numbers per clip. Raises `ValueError` for another framerate than the fit's or fewer than 8 poses."""
        if fps != self.fps:
            raise ValueError(f"this descriptor was fitted at {self.fps} fps; clips at {fps} fps need one of their own")
        raw = _raw_features(clips, fps, self.pose_mean, self.pose_components)
        raw -= self.centre
        raw *= self.scale
        return raw

    def save(self, path: Path) -> None:
        """Write the fitted numbers as .npz, readable without pickle."""
        with whole_file(path) as temporary, temporary.open("wb") as file:
            np.savez(
                file,
                version=np.array(VERSION),
                fps=np.array(str(self.fps)),
                pose_mean=self.pose_mean,
                pose_components=self.pose_components,
                centre=self.centre,
                scale=self.scale,
                fingerprint=np.array(self.fingerprint),
            )


def fit_kinematic(clips: Iterable[Float[np.ndarray, "_clips _poses joints 3"]], fps: Fraction) -> KinematicDescriptor:
    """Fit components and standardisation on real training clips (arrays of any clip lengths) at one framerate.

    A component's sign is fixed by its largest coordinate, so that the fit does not depend on the linear algebra
    library. Raises `ValueError` for fewer than two clips.
    """
    groups = [np.asarray(group) for group in clips]
    if sum(len(group) for group in groups) < 2:
        raise ValueError("fitting the kinematic descriptor needs at least two clips")
    poses = np.concatenate([local_poses(group.astype(np.float64)).reshape(-1, 63) for group in groups])
    pose_mean = poses.mean(axis=0)
    centred = poses - pose_mean
    _, eigenvectors = np.linalg.eigh(centred.T @ centred / len(centred))
    components = eigenvectors.T[::-1][:NUM_POSE_COMPONENTS]
    largest = np.take_along_axis(components, np.abs(components).argmax(axis=1)[:, None], axis=1)
    components = np.ascontiguousarray(components * np.sign(largest))
    raw = np.concatenate([_raw_features(group, fps, pose_mean, components) for group in groups])
    least = np.full(NUM_FEATURES, LEAST_LOG_SPREAD)
    least[:NUM_POSE_COMPONENTS] = LEAST_POSE_SPREAD
    scale = 1.0 / np.maximum(raw.std(axis=0), least)
    for block in BLOCKS.values():
        scale[block] /= np.sqrt(block.stop - block.start)
    return KinematicDescriptor(fps, pose_mean, components, raw.mean(axis=0), scale)


def _raw_features(
    clips: Float[np.ndarray, "clips poses joints 3"],
    fps: Fraction,
    pose_mean: Float64[np.ndarray, "coordinates"],
    pose_components: Float64[np.ndarray, "components coordinates"],
) -> Float64[np.ndarray, "clips features"]:
    """All blocks side by side, before standardisation."""
    if clips.shape[2] != NUM_JOINTS:
        raise ValueError(f"clips have {clips.shape[2]} joints; the descriptor is defined on the {NUM_JOINTS} of SMPL22")
    if clips.shape[1] < MIN_POSES:
        raise ValueError(f"clips have {clips.shape[1]} poses; the descriptor needs at least {MIN_POSES}")
    result = np.empty((len(clips), NUM_FEATURES))
    for start in range(0, len(clips), CHUNK_CLIPS):
        positions = clips[start : start + CHUNK_CLIPS].astype(np.float64)
        rows = result[start : start + CHUNK_CLIPS]
        rows[:, BLOCKS["pose"]] = _pose_block(positions, pose_mean, pose_components)
        velocity = (positions[:, 1:] - positions[:, :-1]) * float(fps)
        acceleration = ((velocity[:, 1:] - velocity[:, :-1]) * float(fps)).reshape(len(positions), -1, 3 * NUM_JOINTS)
        rows[:, BLOCKS["acceleration"]] = _acceleration_block(acceleration)
        rows[:, BLOCKS["level"]] = _level_block(acceleration)
        rows[:, BLOCKS["speed"]] = _speed_block(velocity)
        rows[:, BLOCKS["slip"]] = _slip_block(positions, fps)
    return result


def _pose_block(
    positions: Float64[np.ndarray, "clips poses joints 3"],
    pose_mean: Float64[np.ndarray, "coordinates"],
    pose_components: Float64[np.ndarray, "components coordinates"],
) -> Float64[np.ndarray, "clips 20"]:
    """Mean and log spread over the clip of the principal components of root- and heading-relative poses."""
    scores = (local_poses(positions) - pose_mean) @ pose_components.T
    return np.concatenate((scores.mean(axis=1), np.log(scores.std(axis=1) + SPREAD_FLOOR_METRES)), axis=1)


@lru_cache(maxsize=64)
def _band_filters(num_samples: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Windowed Fourier rows [frequencies × 2, samples] and the band of each [bands, frequencies × 2].

    Squared products with the rows, summed over a band, are the mean square of the Hann-windowed signal in that band.
    """
    window = np.hanning(num_samples + 2)[1:-1]
    frequencies = np.arange(num_samples // 2 + 1)
    phase = 2.0 * np.pi * np.outer(frequencies, np.arange(num_samples)) / num_samples
    sided = np.where((frequencies == 0) | (2 * frequencies == num_samples), 1.0, 2.0)
    norm = np.sqrt(sided / (num_samples * (window @ window)))[:, None] * window
    rows = np.concatenate((np.cos(phase) * norm, np.sin(phase) * norm))
    relative = 2.0 * np.concatenate((frequencies, frequencies)) / num_samples
    band = np.clip(np.searchsorted(BAND_EDGES, relative, side="right") - 1, 0, len(BAND_EDGES) - 2)
    members = (band == np.arange(len(BAND_EDGES) - 1)[:, None]).astype(np.float64)
    return rows, members


def _acceleration_block(acceleration: Float64[np.ndarray, "clips samples 66"]) -> Float64[np.ndarray, "clips 25"]:
    """Log root mean square of the windowed acceleration in every band, for every group of joints (m/s²)."""
    rows, members = _band_filters(acceleration.shape[1])
    amplitudes = rows @ acceleration
    np.square(amplitudes, out=amplitudes)
    power = members @ (amplitudes @ GROUP_MEANS)
    logarithm: Float64[np.ndarray, "clips bands groups"] = np.log(power + ACCELERATION_FLOOR**2)
    return 0.5 * logarithm.reshape(len(acceleration), -1)


def _level_block(acceleration: Float64[np.ndarray, "clips samples 66"]) -> Float64[np.ndarray, "clips 10"]:
    """Log quartiles over the clip of each group's root-mean-square acceleration, two frames averaged (m/s²).

    Quartiles, not peaks: an upsampled motion hardly accelerates between two known poses, for longer the fewer they are,
    while its kinks soon reach their full height. Averaging two frames removes the Nyquist frequency, whose power in a
    native capture depends on the sampling phase.
    """
    smooth = 0.5 * (acceleration[:, 1:] + acceleration[:, :-1])
    group = np.sort(np.square(smooth) @ GROUP_MEANS, axis=1)
    quantiles = np.sqrt(_sorted_quantiles(group, LEVEL_QUANTILES))
    logarithm: Float64[np.ndarray, "clips quantiles groups"] = np.log(quantiles + ACCELERATION_FLOOR)
    return logarithm.reshape(len(acceleration), -1)


def _speed_block(velocity: Float64[np.ndarray, "clips steps joints 3"]) -> Float64[np.ndarray, "clips 5"]:
    """Mean over clip and joints of the log speed (m/s), for every group."""
    speed = np.sqrt(np.einsum("ctjx,ctjx->ctj", velocity, velocity))
    logarithm = np.log(speed + SPEED_FLOOR).mean(axis=1)
    return np.stack([logarithm[:, list(joints)].mean(axis=1) for joints in JOINT_GROUPS.values()], axis=1)


def _slip_block(
    positions: Float64[np.ndarray, "clips poses joints 3"], fps: Fraction
) -> Float64[np.ndarray, "clips 5"]:
    """Log horizontal foot speed over 0.1 s: quantiles of the steadier foot, and the least of the other one (m/s)."""
    lag = min(max(1, round(SLIP_SECONDS * float(fps))), positions.shape[1] - 2)
    horizontal = positions[:, :, [joint for foot in FEET for joint in foot]][..., [0, 2]]
    moved = np.linalg.norm(horizontal[:, lag:] - horizontal[:, :-lag], axis=-1) * (float(fps) / lag)
    feet = np.sort(moved.reshape(*moved.shape[:2], len(FEET), -1).min(axis=-1), axis=-1)
    steadiest = _sorted_quantiles(np.sort(feet[..., :1], axis=1), SLIP_QUANTILES)[..., 0]
    other = feet[..., 1].min(axis=1)[:, None]
    logarithm: Float64[np.ndarray, "clips 5"] = np.log(np.concatenate((steadiest, other), axis=1) + SLIP_FLOOR)
    return logarithm


def _sorted_quantiles(
    values: Float64[np.ndarray, "clips samples series"], quantiles: tuple[float, ...]
) -> Float64[np.ndarray, "clips quantiles series"]:
    """Linearly interpolated quantiles of values that are sorted along axis 1."""
    place = np.asarray(quantiles) * (values.shape[1] - 1)
    below = np.floor(place).astype(np.int64)
    above = np.minimum(below + 1, values.shape[1] - 1)
    fraction = (place - below)[:, None]
    result: Float64[np.ndarray, "clips quantiles series"] = (
        values[:, below] * (1.0 - fraction) + values[:, above] * fraction
    )
    return result
