"""A recogniser of any store's actions: linear discriminants of fixed statistics of a motion, fitted in a second.

The published recognisers know two data sets' actions. This one is fitted on a store's training split, in closed form
and deterministically, so that Table 3 works for any motions with actions; the table shows its accuracy on held-out
motions. Its numbers are not comparable between stores. Source of the method: Fisher 1936; Hastie, Tibshirani &
Friedman 2009, §4.3.
"""

import hashlib
from collections import Counter

import numpy as np
from scipy.linalg import eigh

from eval.actions.recogniser import ActionRecogniser, FeaturesAndScores
from eval.clip_fid.descriptor import local_poses
from eval.sets.sets import SampleSet, middle
from motionkit.core.errors import MotionkitError
from motionkit.core.shapes import Float32, Float64
from motionkit.core.skeleton import SMPL22

VERSION = "motion-statistics/1"
MIN_FRAMES = 10
# Actions with fewer training motions are dropped: their means would be unreliable.
LEAST_TRAINING = 10
# Of the within-class covariance, towards a multiple of the identity.
SHRINKAGE = 0.1
LEAST_SPREAD = 0.01
LONGEST_SECONDS = 3
QUANTILES = (0.1, 0.9)
LEFT_HIP, RIGHT_HIP, LEFT_SHOULDER, RIGHT_SHOULDER = (
    SMPL22.index(name) for name in ("left_hip", "right_hip", "left_shoulder", "right_shoulder")
)
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
    across = (
        positions[:, LEFT_HIP] - positions[:, RIGHT_HIP] + positions[:, LEFT_SHOULDER] - positions[:, RIGHT_SHOULDER]
    )
    heading = np.unwrap(np.arctan2(-across[:, 2], across[:, 0]))
    x, y, z = (np.diff(positions[:, 0], axis=0) * fps).T
    sine, cosine = np.sin(heading[:-1]), np.cos(heading[:-1])
    return np.stack((x * cosine - z * sine, x * sine + z * cosine, y, np.diff(heading) * fps), axis=1)


def fit_linear(train: SampleSet) -> ActionRecogniser:
    """Fit on a training set's motions with actions; actions with fewer than 10 motions are left out.

    A feature vector is `(statistics − centre) / spread @ directions`: one number fewer than there are actions, each
    with a variance of 1 within actions. Scores are log posteriors up to a constant: nearness to each action's mean, and
    its share of the training motions. Raises `MotionkitError` where fewer than two actions remain.
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
