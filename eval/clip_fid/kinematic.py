"""The kinematic descriptor, version 2: slow motion by its distribution, fast motion by when it happens.

White noise has as much power above 12 Hz as captured motion has, and so has the noise of any other take: a score that
compares amounts of power there is won by adding it. What noise does not have is the right moment: in real motion power
above 12 Hz comes with impacts and with fast movement, and slow motion tells when. So the descriptor predicts the log
power above 12 Hz from the motion below 6 Hz, by least squares on training motion, and compares by how much the power
that is there follows the prediction. Amounts of power count for little, and above a floor of noise. Noise that follows
slow motion wins this score, too (docs/results/games.md).

Version 1, which compares amounts, is `eval.clip_fid.kinematic1`.
"""

import hashlib
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from eval.clip_fid.channels import (
    HIGH_NOISE_METRES,
    LOW_NOISE_METRES,
    MIDDLE_NOISE_METRES,
    NUM_GROUPS,
    Bands,
    Channels,
    channels,
    noise_power,
)
from eval.clip_fid.clips import Distance
from eval.clip_fid.threads import in_threads
from eval.metrics.gaussian import Gaussian, frechet_distance
from eval.sets.sets import Ragged, SampleSet
from motionkit.core.errors import DamagedFileError
from motionkit.core.files import whole_file
from motionkit.core.shapes import Float, Float32, Float64

VERSION = "kinematic/2"
NUM_POSE_COMPONENTS = 10
NUM_SLOW = 2
"""Number of bands with the smallest floor; higher ones have that of the middle band."""
NUM_TIMING = 2
"""Means over a clip of the product of log power and its prediction, and of the squared prediction."""

# Weights were chosen on training takes alone (docs/metrics.md): every block's total variance on real training clips.
WEIGHTS: Mapping[str, float] = {
    "pose": 1.0,
    "spread": 1.0,
    "slow": 5.5,
    "upper slow": 0.45,
    "middle": 0.01,
    "high": 0.01,
    "speed": 1.0,
    "slip": 1.3,
}
TIMING_WEIGHT = 0.25
"""The timing score of a set whose fast motion does not follow its slow motion at all."""

SPREAD_FLOOR_METRES = 0.005
LEAST_LOG_SPREAD = 0.25
LEAST_POSE_SPREAD = 0.02
"""Minimum standard deviations for the standardisation."""
RIDGE = 0.003
PREDICTION_FLOOR = 0.05
"""Added to a set's squared prediction, as a share of that of training motion: a set that stands still has no timing."""
LEAST_FOLLOWING = 0.25
"""The minimum of real motion's timing, of which losses are a share: motion without power above 12 Hz loses none."""


@dataclass(frozen=True, eq=False)
class KinematicDescriptor:
    """The descriptor fitted at one framerate.

    `pose_mean` [63] and `pose_components` [10, 63] span poses relative to root and heading; `predictor` gives log power
    from slow motion, and `least_prediction` is added to its mean square; `centre` and `scale` standardise the features
    that are compared by their distribution, and weigh them.
    """

    fps: Fraction
    pose_mean: Float64[np.ndarray, "coordinates"]
    pose_components: Float64[np.ndarray, "components coordinates"]
    predictor: Float64[np.ndarray, "channels timing"]
    least_prediction: Float64[np.ndarray, "1"]
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
        for array in self._arrays().values():
            digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return digest.hexdigest()[:16]

    @property
    def num_distance(self) -> int:
        """Number of features that are compared by their distribution; timing follows them."""
        return self.centre.size

    @property
    def blocks(self) -> dict[str, slice]:
        """Slices of the features of each kind."""
        return _blocks(Bands.at(self.fps))

    def frames(self, samples: SampleSet) -> Ragged:
        """A row for every pose of the motions, of which clips are averages: [rows, numbers], float32."""
        if samples.fps != self.fps:
            raise ValueError(f"this descriptor was fitted at {self.fps} fps; {samples.name} is at {samples.fps} fps")
        return Ragged.of(list(in_threads(lambda motion: self.rows(channels(motion, self.fps)), samples.sequences)))

    def rows(self, motion: Channels) -> Float32[np.ndarray, "frames numbers"]:
        """A row for every pose of a motion, of which clips are averages."""
        scores = (motion.pose - self.pose_mean) @ self.pose_components.T
        power = motion.power.reshape(len(scores), -1)
        prediction = _inputs(motion) @ self.predictor
        timing = np.stack([(motion.timing * prediction).sum(axis=1), np.square(prediction).sum(axis=1)], axis=1)
        return np.concatenate(
            (scores, np.square(scores), power, motion.log_speed, motion.log_foot_speed, timing),
            axis=1,
            dtype=np.float32,
        )

    def describe(
        self, clips: Float[np.ndarray, "clips poses numbers"], fps: Fraction
    ) -> Float64[np.ndarray, "clips features"]:
        """Features of clips of the output of `frames`, timing last. Raises `ValueError` for another framerate."""
        if fps != self.fps:
            raise ValueError(f"this descriptor was fitted at {self.fps} fps; clips at {fps} fps need one of their own")
        raw = _raw_features(clips, Bands.at(fps))
        raw[:, : self.num_distance] -= self.centre
        raw[:, : self.num_distance] *= self.scale
        return raw

    def score(self, real: Gaussian, other: Gaussian, distance: Distance = frechet_distance) -> float:
        """Fréchet distance of the features, plus the squared relative loss of how well fast motion follows slow motion.

        Following it more closely than real motion is not rewarded: kinks and filters could win that, and added noise
        would hide it.
        """
        features = slice(0, self.num_distance)
        follows = max(self.following(real), LEAST_FOLLOWING)
        lost = max(0.0, self.following(real) - self.following(other)) / follows
        return distance(real.part(features), other.part(features)) + TIMING_WEIGHT * lost**2

    def following(self, of: Gaussian) -> float:
        """The regression slope of log power on its prediction: near 1 for real motion, 0 for noise."""
        product, square = of.mean[self.num_distance :]
        return float(product / max(square + self.least_prediction[0], 1e-12))

    def save(self, path: Path) -> None:
        """Write the fitted numbers as .npz, readable without pickle."""
        about = {"version": VERSION, "fps": str(self.fps), "fingerprint": self.fingerprint}
        arrays: dict[str, Any] = {name: np.array(text) for name, text in about.items()} | self._arrays()
        with whole_file(path) as temporary, temporary.open("wb") as file:
            np.savez(file, **arrays)

    def _arrays(self) -> dict[str, npt.NDArray[np.float64]]:
        return {each.name: getattr(self, each.name) for each in fields(self) if each.name != "fps"}


def load_kinematic(path: Path) -> KinematicDescriptor:
    """Read a descriptor that `save` wrote.

    Raises `DamagedFileError` for a damaged file, and `ValueError` for another version.
    """
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            arrays = dict(file)
        version, fps = str(arrays.pop("version")), Fraction(str(arrays.pop("fps")))
        written = str(arrays.pop("fingerprint"))
        descriptor = KinematicDescriptor(fps, **arrays) if version == VERSION else None
    except (ArithmeticError, BadZipFile, EOFError, KeyError, TypeError, ValueError) as error:
        raise DamagedFileError(path, str(error), "fit it again") from None
    if descriptor is None:
        raise ValueError(f"{path} holds a descriptor of version {version}, this is {VERSION}: fit it again")
    if written != descriptor.fingerprint:
        raise DamagedFileError(path, "its numbers do not match its fingerprint", "fit it again")
    return descriptor


def fit_kinematic(motions: Sequence[Channels], fps: Fraction) -> KinematicDescriptor:
    """Fit components and predictors on real training motions at one framerate; `standardised` does the rest.

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
    predictor = _fit_predictor(motions)
    squares = np.concatenate([np.square(_inputs(motion) @ predictor).sum(axis=1) for motion in motions])
    num_features = max(block.stop for block in _blocks(Bands.at(fps)).values())
    return KinematicDescriptor(
        fps,
        pose_mean,
        np.ascontiguousarray(components * np.sign(largest)),
        predictor,
        PREDICTION_FLOOR * squares.mean(keepdims=True),
        np.zeros(num_features),
        np.ones(num_features),
    )


def standardised(fitted: KinematicDescriptor, described: Float64[np.ndarray, "clips features"]) -> KinematicDescriptor:
    """The descriptor with centre and weights measured on training clips."""
    raw = described[:, : fitted.num_distance]
    least = np.full(fitted.num_distance, LEAST_LOG_SPREAD)
    least[fitted.blocks["pose"]] = LEAST_POSE_SPREAD
    scale = 1.0 / np.maximum(raw.std(axis=0), least)
    for name, block in fitted.blocks.items():
        scale[block] *= np.sqrt(WEIGHTS[name] / max(1, block.stop - block.start))
    return replace(fitted, centre=raw.mean(axis=0), scale=scale)


def _blocks(bands: Bands) -> dict[str, slice]:
    bands_of = {
        "slow": len(bands.low[:NUM_SLOW]),
        "upper slow": len(bands.low[NUM_SLOW:]),
        "middle": len(bands.middle),
        "high": len(bands.high),
    }
    sizes = {"pose": NUM_POSE_COMPONENTS, "spread": NUM_POSE_COMPONENTS}
    sizes |= {name: NUM_GROUPS * number for name, number in bands_of.items()} | {"speed": NUM_GROUPS, "slip": 2}
    stops = np.cumsum(list(sizes.values())).tolist()
    return {name: slice(stop - size, stop) for (name, size), stop in zip(sizes.items(), stops, strict=True)}


def _raw_features(
    clips: Float[np.ndarray, "clips poses numbers"], bands: Bands
) -> Float64[np.ndarray, "clips features"]:
    """Means over the clip, those of powers as logarithms above their floors, before standardisation."""
    means = clips.mean(axis=1, dtype=np.float64)
    pose, squares, rest = np.split(means, [NUM_POSE_COMPONENTS, 2 * NUM_POSE_COMPONENTS], axis=1)
    spread = 0.5 * np.log(np.maximum(squares - np.square(pose), 0.0) + SPREAD_FLOOR_METRES**2)
    floors = np.concatenate(
        (
            noise_power(bands.low[:NUM_SLOW], LOW_NOISE_METRES),
            noise_power((*bands.low[NUM_SLOW:], *bands.middle), MIDDLE_NOISE_METRES),
            noise_power(bands.high, HIGH_NOISE_METRES),
        )
    )
    power, others = np.split(rest, [NUM_GROUPS * len(floors)], axis=1)
    log_power = 0.5 * np.log(np.maximum(power, 0.0) + np.repeat(floors, NUM_GROUPS))
    return np.concatenate((pose, spread, log_power, others), axis=1)


def _inputs(motion: Channels) -> Float64[np.ndarray, "frames channels"]:
    return np.concatenate((motion.steady, motion.sudden), axis=1)


def _fit_predictor(motions: Sequence[Channels]) -> Float64[np.ndarray, "channels timing"]:
    """Ridge regression of log power on the residual of the sudden channels given the steady ones.

    Speed alone would be a good predictor, but noise that is added where joints are fast follows speed too.
    """
    steady, sudden, timing = (
        np.concatenate([getattr(motion, name) for motion in motions]) for name in ("steady", "sudden", "timing")
    )
    steady_scale, sudden_scale = (1.0 / (values.std(axis=0) + 1e-9) for values in (steady, sudden))
    steady, sudden = steady * steady_scale, sudden * sudden_scale
    shared = _ridge(steady, sudden)
    weights = _ridge(sudden - steady @ shared, timing)
    return np.concatenate((-steady_scale[:, None] * (shared @ weights), sudden_scale[:, None] * weights))


def _ridge(
    predictors: Float64[np.ndarray, "frames predictors"], target: Float64[np.ndarray, "frames targets"]
) -> Float64[np.ndarray, "predictors targets"]:
    penalty = RIDGE * len(predictors) * np.eye(predictors.shape[1])
    return np.linalg.solve(predictors.T @ predictors + penalty, predictors.T @ target)
