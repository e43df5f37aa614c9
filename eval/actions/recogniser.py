"""Recognisers of actions: their interface, their names, and the one that is fitted on a store.

`fit_linear` fits linear discriminants of a motion's statistics on a training split: in closed form, in a second. Table
3 shows its accuracy on held-out motions; its numbers are not comparable between stores. Source: Fisher 1936; Hastie,
Tibshirani & Friedman 2009, §4.3.
"""

import hashlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from scipy.linalg import eigh

from eval.clip_fid.score import local_poses
from eval.sets.sets import SampleSet, middle
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.kinematics import rotate_about_y
from motionkit.core.shapes import Float32, Float64
from motionkit.core.skeleton import SMPL22
from motionkit.features.field import heading
from motionkit.io import joints_npy, uestc

FeaturesAndScores = tuple[Float64[np.ndarray, "sequences features"], Float64[np.ndarray, "sequences actions"]]


@dataclass(frozen=True, eq=False)
class ActionRecogniser:
    """Classifies motions at `fps` by `actions`; a motion's row depends on that motion alone.

    `fingerprint` is a hash of definition, weights and settings. `describe` gives features, and scores in the order of
    the actions.
    """

    name: str
    fps: Fraction
    actions: tuple[str, ...]
    fingerprint: str
    describe: Callable[[SampleSet], FeaturesAndScores]

    def recognise(self, samples: SampleSet) -> FeaturesAndScores:
        """Features and scores of every sequence. Raises `MotionkitError` for an unsupported framerate or skeleton."""
        if self.fps != samples.fps:
            raise MotionkitError(
                f"{samples.name}: motions at {samples.fps} fps, but the recogniser {self.name!r} was trained at "
                f"{self.fps} fps only; resample them first"
            )
        return self.describe(samples)


@dataclass(frozen=True)
class RecogniserSource:
    """A kind of recogniser; `dataset` is the paper's name of the data set that a published one knows.

    `needs_rotations`: it sees joint rotations, not positions.
    """

    name: str
    title: str
    fps: Fraction
    note: str
    dataset: str = ""
    needs_rotations: bool = False


SOURCES = (
    RecogniserSource(
        "linear",
        "linear discriminants fitted on the training split",
        Fraction(20),
        "Features have a variance of 1 within actions, and there is one fewer than actions. The recogniser belongs to "
        "this store: compare these numbers with no others. What it is worth is its accuracy on real motion.",
    ),
    RecogniserSource(
        "humanact12",
        "Action2Motion's GRU for HumanAct12",
        joints_npy.HUMANACT12_FPS,
        "Heading counts for this recogniser, and motions without hands get straight ones. Its hidden state begins at "
        "zero, in the published code at random.",
        dataset="HumanAct12",
    ),
    RecogniserSource(
        "uestc",
        "ACTOR's ST-GCN for UESTC",
        uestc.FPS,
        "It takes joint rotations only, and depends on the heading.",
        dataset="UESTC",
        needs_rotations=True,
    ),
)


def find_recogniser(name: str) -> RecogniserSource:
    """A recogniser by name. Raises `UsageError` that lists the known names."""
    known = {source.name: source for source in SOURCES}
    if name not in known:
        raise UsageError(f"there is no recogniser of actions {name!r}: {', '.join(known)}")
    return known[name]


VERSION = "motion-statistics/1"
MIN_FRAMES = 10
# Actions with fewer training motions are dropped: their means would be unreliable.
LEAST_TRAINING = 10
# Of the within-class covariance, towards a multiple of the identity.
SHRINKAGE = 0.1
LEAST_SPREAD = 0.01
LONGEST_SECONDS = 3
QUANTILES = (0.1, 0.9)
FEET = tuple(SMPL22.index(name) for name in ("left_ankle", "left_foot", "right_ankle", "right_foot"))


def motion_statistics(positions: Float32[np.ndarray, "frames 22 3"], fps: float) -> Float64[np.ndarray, "numbers"]:
    """Mean, spread, quantiles and speed of every coordinate, and mean and spread of how the root moves (325 numbers).

    `positions` in metres, y up, 10 frames or more.
    """
    wide = positions.astype(np.float64)
    poses = local_poses(wide[None])[0]
    root = _root_motion(wide, fps)
    height = wide[:, 0, 1] - wide[:, list(FEET), 1].min()
    return np.concatenate(
        (
            poses.mean(axis=0),
            poses.std(axis=0),
            np.quantile(poses, QUANTILES, axis=0).reshape(-1),
            root.mean(axis=0),
            root.std(axis=0),
            (height.mean(), height.std()),
            np.abs(np.diff(poses, axis=0)).mean(axis=0) * fps,
        )
    )


def _root_motion(positions: Float64[np.ndarray, "frames 22 3"], fps: float) -> Float64[np.ndarray, "steps 4"]:
    """Velocity to the left, forwards and upwards (m/s), and turning (rad/s), step by step."""
    yaw = np.unwrap(heading(positions))
    left, up, ahead = rotate_about_y(np.diff(positions[:, 0], axis=0) * fps, -yaw[:-1]).T
    return np.stack((left, ahead, up, np.diff(yaw) * fps), axis=1)


def fit_linear(train: SampleSet) -> ActionRecogniser:
    """Fit on a training set's motions with actions; actions with fewer than 10 motions are left out.

    A feature vector is `(statistics − centre) / spread @ directions`: one number fewer than there are actions, each of
    variance 1 within actions. Scores are log posteriors up to a constant. Raises `MotionkitError` where fewer than two
    actions remain.
    """
    enough = {action for action, count in Counter(train.actions).items() if action and count >= LEAST_TRAINING}
    actions = tuple(sorted(enough))
    if len(actions) < 2:
        raise MotionkitError(
            f"{train.name}: {len(actions)} actions have {LEAST_TRAINING} motions or more at {train.fps} fps; a "
            "recogniser needs two (`motionkit info` lists the actions, `motionkit split` makes a training split)"
        )
    known = train.select([index for index, action in enumerate(train.actions) if action in enough])
    labels = np.array([actions.index(action) for action in known.actions])
    raw = statistics_of(known)
    centre, spread = raw.mean(axis=0), raw.std(axis=0) + LEAST_SPREAD
    standard = (raw - centre) / spread
    means = np.stack([standard[labels == label].mean(axis=0) for label in range(len(actions))])
    within = standard - means[labels]
    covariance = within.T @ within / len(standard)
    size = len(covariance)
    covariance = (1 - SHRINKAGE) * covariance + SHRINKAGE * np.trace(covariance) / size * np.eye(size)
    between = means[labels].T @ means[labels] / len(standard)
    _, vectors = eigh(between, covariance, subset_by_index=(max(0, size - len(actions) + 1), size - 1))
    vectors = vectors[:, ::-1]
    # Signs are fixed by each direction's largest coefficient.
    largest = np.take_along_axis(vectors, np.abs(vectors).argmax(axis=0)[None], axis=0)
    directions = np.ascontiguousarray(vectors * np.sign(largest))
    centres, log_shares = means @ directions, np.log(np.bincount(labels) / len(labels))
    digest = hashlib.sha256(f"linear/1 {VERSION} {known.fps} {actions}".encode())
    for array in (centre, spread, directions, centres, log_shares):
        digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())

    def describe(samples: SampleSet) -> FeaturesAndScores:
        features = ((statistics_of(samples) - centre) / spread) @ directions
        distances = ((features[:, None] - centres) ** 2).sum(axis=2)
        return features, log_shares - 0.5 * distances

    return ActionRecogniser("linear", known.fps, actions, digest.hexdigest()[:16], describe)


def statistics_of(samples: SampleSet) -> Float64[np.ndarray, "sequences numbers"]:
    """`motion_statistics` of every sequence's middle 3 s; hands are left out."""
    longest, fps = int(LONGEST_SECONDS * samples.fps), float(samples.fps)
    bodies = [middle(sequence[:, : SMPL22.num_joints], longest) for sequence in samples.sequences]
    return np.stack([motion_statistics(body, fps) for body in bodies])
