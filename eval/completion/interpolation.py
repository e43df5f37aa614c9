"""Interpolating dropped frames, PA-HiRes' Tables 1 and 2: given frames, scaling of pose vectors, errors of encoders.

A clip has 16 given frames: at scale s its frame ⌊i·s⌋ is the i-th given one, at its true time. Clips start at every
multiple of the largest scale's span, so that all scales of both tables use the same parts of the same takes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from eval.completion.data_sets import TrueClips, Vectors, local_rotations
from eval.completion.encoders import Completer, query_many
from eval.completion.scores import Scores, add_clips
from motionkit.core.kinematics import two_columns
from motionkit.core.moments import stream
from motionkit.core.shapes import Bool, Float32, Float64, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.features import rotations
from motionkit.fields.motion_field import Observation, Poses

VERSION = "interpolation/1"
INTEGER_SCALES = tuple(Fraction(scale) for scale in (2, 3, 4, 5))
OTHER_SCALES = tuple(Fraction(scale) for scale in ("1.2", "2.4", "3.6", "4.8"))
NUM_GIVEN, LARGEST_SCALE = 16, Fraction(5)
# Metrics of whole clips of joint positions.
TIMED_METRICS = ("velocity_error", "acceleration_error", "jerk_error")
# A still body is reconstructed exactly: dB per clip are capped, at about float32's resolution.
CEILING_DB = 100.0
CLIPS_AT_ONCE, TRAINING_CLIPS_AT_ONCE = 32, 512

ROOT_PATH, ROOT_HEIGHT, ROOT_ROTATION, JOINT_ROTATIONS = slice(0, 3, 2), slice(1, 2), slice(3, 9), slice(9, None)
GROUPS = (ROOT_PATH, ROOT_HEIGHT, ROOT_ROTATION, JOINT_ROTATIONS)
# Deviations are at least this share of their group's: otherwise the noise of joints that hardly turn would count as
# much as a leg's swing.
FLOOR_SHARE = 0.25
# A smaller deviation is float32 rounding: a leaf of the skeleton, which has no bone to rotate.
CONSTANT = 1e-5


def given_frames(scale: Fraction) -> Int64[np.ndarray, "given"]:
    """⌊i·s⌋ for i = 0 … 15, exactly."""
    return np.array([index * scale.numerator // scale.denominator for index in range(NUM_GIVEN)])


CLIP_FRAMES = int(given_frames(LARGEST_SCALE)[-1]) + 1


def scale_label(scale: Fraction) -> str:
    """×2, ×2.4."""
    return f"×{float(scale):g}"


@dataclass(frozen=True, eq=False)
class PoseScale:
    """Mean and deviation of the numbers that vary; the others are ignored."""

    mean: Float64[np.ndarray, "numbers"]
    std: Float64[np.ndarray, "numbers"]
    varies: Bool[np.ndarray, "all_numbers"]

    def unit_range(self, vectors: Vectors) -> Float64[np.ndarray, "clips frames varying"]:
        """0.5 + (x − μ)/(4σ) of the numbers that vary, not clipped: ± 2σ of the training clips span the range of 1."""
        return np.asarray(0.5 + (vectors[..., self.varies].astype(np.float64) - self.mean) / (4.0 * self.std))


def in_first_frame(vectors: Vectors, first: Float32[np.ndarray, "clips numbers"]) -> Vectors:
    """Vectors of the world in each clip's own frame: origin under the root of its first pose, which faces Z+."""
    return rotations.to_window(vectors, rotations.heading(first, SMPL22), first[:, (0, 2)].astype(np.float64))


def measure_scale(clips: TrueClips) -> PoseScale:
    """Mean and deviation of all frames of training clips, each clip in its own frame.

    The root's x and z share a deviation; a number has at least a quarter of its group's (root mean square over those
    that vary). Groups: the root's path, its height, its rotation, the joints' rotations.
    """
    batches = clips.read(TRAINING_CLIPS_AT_ONCE)
    moments = stream(in_first_frame(rows, rows[:, 0]).reshape(-1, rows.shape[-1]) for _, _, rows in batches)
    variance = moments.std**2
    varies = variance > CONSTANT**2
    variance[ROOT_PATH] = variance[ROOT_PATH].mean()
    for group in GROUPS:
        present = variance[group][varies[group]]
        if present.size:
            variance[group] = np.maximum(variance[group], FLOOR_SHARE**2 * present.mean())
    return PoseScale(moments.mean[varies], np.sqrt(variance[varies]), varies)


def measure_interpolation(
    clips: TrueClips, scale: PoseScale, scales: Sequence[Fraction], completer: Completer
) -> Scores:
    """An encoder's figures by metric and scale; pose vectors are scaled by `scale`.

    Predicted poses without rotations get them by inverse kinematics. Raises what the encoder raises.
    """
    scores: Scores = {}
    for batch, whole_positions, whole_vectors in clips.read(CLIPS_AT_ONCE):
        takes, whole_rotations = clips.takes[batch], local_rotations(whole_vectors)
        for each in scales:
            given = given_frames(each)
            frames = np.arange(given[-1] + 1)
            times = frames.astype(np.float64) * clips.fps.denominator / clips.fps.numerator
            synthesised = np.isin(frames, given, invert=True)
            true_positions, true_rotations = whole_positions[:, frames], whole_rotations[:, frames]
            observed = [
                Observation(times[given], Poses(positions[given], local[given], positions[given, 0]), SMPL22)
                for positions, local in zip(true_positions, true_rotations, strict=True)
            ]
            predicted = [
                poses if poses.local_rotations is not None else rotations.rows_of_poses(poses, SMPL22).poses()
                for poses in query_many(completer.encoder, observed, times, clips.fps)
            ]
            positions = np.stack([poses.joint_positions for poses in predicted])
            turned = np.stack([poses.local_rotations for poses in predicted if poses.local_rotations is not None])
            vectors = np.concatenate((positions[:, :, 0], two_columns(turned)), axis=-1)
            both = (vectors, whole_vectors[:, frames])
            pair = [scale.unit_range(in_first_frame(rows, whole_vectors[:, 0])) for rows in both]
            label = scale_label(each)
            add_clips(scores, label, takes, "psnr", *pair, synthesised=synthesised, ceiling_db=CEILING_DB)
            add_clips(scores, label, takes, "ssim", *pair)
            joints = (positions[:, synthesised], true_positions[:, synthesised])
            add_clips(scores, label, takes, "mpjpe_global", *joints)
            turns = (turned[:, synthesised], true_rotations[:, synthesised])
            add_clips(scores, label, takes, "rotation_angle_error", *turns)
            for name in TIMED_METRICS:
                add_clips(scores, label, takes, name, positions, true_positions, fps=float(clips.fps))
    return scores
