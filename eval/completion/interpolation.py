"""How well encoders put back the frames that a scale left out: PA-HiRes' Tables 1 and 2, measured."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from jaxtyping import Float32

from eval.completion.encoders import Completer
from eval.completion.protocol import InterpolationProtocol, scale_label
from eval.completion.scores import ClipFrames, PoseScale, Scores, scores_of
from eval.completion.takes import TrueClips, TruePoses, observations
from eval.metrics.metric import MeanStream, all_metrics, find_metric
from motionkit.core.errors import MotionkitError
from motionkit.core.skeleton import SMPL22
from motionkit.features.rotation_rows import rows_of_poses, two_columns
from motionkit.fields.completion import query_many
from motionkit.fields.motion_field import Poses

# A body that stands still is put back exactly: a clip counts with at most so many dB, which is float32's resolution.
CEILING_DB = 100.0
CLIPS_AT_ONCE = 32


def timed_metrics() -> list[str]:
    """Metrics of whole clips of joint positions and their framerate, all that are declared: velocity, acceleration …"""
    return [metric.name for metric in all_metrics().values() if metric.arguments == "predicted, target, fps"]


def measured_metrics() -> tuple[str, ...]:
    """What is measured of every answer."""
    return ("psnr", "ssim", "mpjpe_global", "rotation_angle_error", *timed_metrics())


@dataclass(frozen=True, eq=False)
class InterpolationTask:
    """One data set's clips, the scale of their numbers, and the protocol."""

    clips: TrueClips
    scale: PoseScale
    protocol: InterpolationProtocol


def measure_interpolation(
    task: InterpolationTask,
    scales: Sequence[Fraction],
    completers: Sequence[Completer],
    advance: Callable[[], None] = lambda: None,
) -> tuple[dict[str, Scores], dict[str, str]]:
    """For each completer's name its figures, by metric and by scale; and why a completer has none.

    `advance` is called once for each batch of clips (`num_batches`).
    """
    metrics = measured_metrics()
    streams = {
        completer.name: {
            scale_label(scale): {name: MeanStream(find_metric(name)) for name in metrics} for scale in scales
        }
        for completer in completers
    }
    failed: dict[str, str] = {}
    for first in range(0, task.clips.num_clips, CLIPS_AT_ONCE):
        truth = task.clips.read(slice(first, first + CLIPS_AT_ONCE))
        rotations = truth.local_rotations()
        for completer in completers:
            for scale in scales:
                if completer.name in failed:
                    continue
                try:
                    _add(streams[completer.name][scale_label(scale)], task, scale, completer, truth, rotations)
                except (MotionkitError, ValueError) as error:
                    failed[completer.name] = f"{scale_label(scale)}: {error}"
        advance()
    figures = {
        completer.name: scores_of(streams[completer.name], metrics)
        for completer in completers
        if completer.name not in failed
    }
    return figures, failed


def num_batches(clips: TrueClips) -> int:
    """How often `measure_interpolation` advances."""
    return -(-clips.num_clips // CLIPS_AT_ONCE)


def _add(
    streams: Mapping[str, MeanStream],
    task: InterpolationTask,
    scale: Fraction,
    completer: Completer,
    whole: TruePoses,
    rotations: Float32[np.ndarray, "clips frames joints 4"],
) -> None:
    protocol = task.protocol
    span = slice(0, protocol.span_frames(scale))
    truth, rotations = whole.frames(span), rotations[:, span]
    given = observations(truth, rotations, protocol.kept_frames(scale))
    made = [_with_rotations(poses) for poses in query_many(completer.encoder, given, truth.times_seconds, truth.fps)]
    positions = np.stack([poses.joint_positions for poses in made])
    turned = np.stack([poses.local_rotations for poses in made if poses.local_rotations is not None])
    vectors = np.concatenate((positions[:, :, 0], two_columns(turned)), axis=-1)
    own = ClipFrames.of(truth.vectors)
    predicted, target = (task.scale.unit_range(own.enter(rows)) for rows in (vectors, truth.vectors))
    asked, fps = protocol.synthesised(scale), float(truth.fps)
    streams["psnr"].update(predicted, target, synthesised=asked, ceiling_db=CEILING_DB)
    streams["ssim"].update(predicted, target)
    streams["mpjpe_global"].update(_frames(positions[:, asked]), _frames(truth.joint_positions[:, asked]))
    streams["rotation_angle_error"].update(_frames(turned[:, asked]), _frames(rotations[:, asked]))
    for name in timed_metrics():
        streams[name].update(positions, truth.joint_positions, fps=fps)


def _with_rotations(poses: Poses) -> Poses:
    """Poses of fields that know positions only get the rotations that all rows have: those of inverse kinematics."""
    return poses if poses.local_rotations is not None else rows_of_poses(poses, SMPL22).poses()


def _frames(clips: Float32[np.ndarray, "clips frames joints numbers"]) -> Float32[np.ndarray, "rows joints numbers"]:
    return clips.reshape(-1, *clips.shape[2:])
