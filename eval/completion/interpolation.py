"""Errors of encoders in interpolating dropped frames: PA-HiRes' Tables 1 and 2, measured."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from eval.completion.encoders import Completer, query_many
from eval.completion.protocol import InterpolationProtocol, scale_label
from eval.completion.scores import ClipFrames, PoseScale, Scores, TakeStreams, scores_of
from eval.completion.takes import TrueClips, TruePoses, observations
from eval.metrics.metric import MeanStream, all_metrics
from motionkit.core.shapes import Bool, Float32, Float64, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.features.rotations import rows_of_poses, two_columns
from motionkit.fields.motion_field import Poses

# A still body is reconstructed exactly: dB per clip are capped, at about float32's resolution.
CEILING_DB = 100.0
CLIPS_AT_ONCE = 32


def timed_metrics() -> list[str]:
    """Metrics of whole clips of joint positions and their framerate, all that are declared: velocity, acceleration …"""
    return [metric.name for metric in all_metrics().values() if metric.arguments == "predicted, target, fps"]


def measured_metrics() -> tuple[str, ...]:
    """The metrics of an output."""
    return ("psnr", "ssim", "mpjpe_global", "rotation_angle_error", *timed_metrics())


def measure_interpolation(
    clips: TrueClips,
    scale: PoseScale,
    scales: Sequence[Fraction],
    completer: Completer,
    advance: Callable[[], None] = lambda: None,
) -> Scores:
    """An encoder's figures by metric and scale; numbers of poses are scaled by `scale`.

    `advance` is called once for each batch of clips (`num_batches`). Raises `MotionkitError` or `ValueError` if the
    encoder fails.
    """
    protocol, metrics = InterpolationProtocol(), measured_metrics()
    streams = {scale_label(each): TakeStreams(metrics) for each in scales}
    for first in range(0, clips.num_clips, CLIPS_AT_ONCE):
        part = slice(first, first + CLIPS_AT_ONCE)
        truth, takes = clips.read(part), clips.takes[part]
        rotations = truth.local_rotations()
        for each in scales:
            made = _answered(scale, protocol, each, completer, truth, rotations)
            for chosen, of_take in streams[scale_label(each)].by_take(takes):
                _add(of_take, protocol.synthesised(each), made.of(chosen))
        advance()
    return scores_of(streams, metrics)


def num_batches(clips: TrueClips) -> int:
    """Number of calls of `advance` in `measure_interpolation`."""
    return -(-clips.num_clips // CLIPS_AT_ONCE)


@dataclass(frozen=True, eq=False)
class _Answered:
    """Predicted and true clips: numbers in the unit range, positions, local rotations."""

    fps: float
    predicted: Float64[np.ndarray, "clips frames numbers"]
    target: Float64[np.ndarray, "clips frames numbers"]
    positions: Float32[np.ndarray, "clips frames joints 3"]
    true_positions: Float32[np.ndarray, "clips frames joints 3"]
    turned: Float32[np.ndarray, "clips frames joints 4"]
    true_turned: Float32[np.ndarray, "clips frames joints 4"]

    def of(self, clips: Int64[np.ndarray, "chosen"]) -> "_Answered":
        """Some of the clips."""
        arrays = {name: each[clips] for name, each in vars(self).items() if name != "fps"}
        return _Answered(self.fps, **arrays)


def _answered(
    unit: PoseScale,
    protocol: InterpolationProtocol,
    scale: Fraction,
    completer: Completer,
    whole: TruePoses,
    rotations: Float32[np.ndarray, "clips frames joints 4"],
) -> _Answered:
    span = slice(0, protocol.span_frames(scale))
    truth, rotations = whole.frames(span), rotations[:, span]
    given = observations(truth, rotations, protocol.kept_frames(scale))
    made = [_with_rotations(poses) for poses in query_many(completer.encoder, given, truth.times_seconds, truth.fps)]
    positions = np.stack([poses.joint_positions for poses in made])
    turned = np.stack([poses.local_rotations for poses in made if poses.local_rotations is not None])
    vectors = np.concatenate((positions[:, :, 0], two_columns(turned)), axis=-1)
    own = ClipFrames.of(truth.vectors)
    predicted, target = (unit.unit_range(own.to_window(rows)) for rows in (vectors, truth.vectors))
    return _Answered(float(truth.fps), predicted, target, positions, truth.joint_positions, turned, rotations)


def _add(streams: Mapping[str, MeanStream], asked: Bool[np.ndarray, "span"], made: _Answered) -> None:
    streams["psnr"].update(made.predicted, made.target, synthesised=asked, ceiling_db=CEILING_DB)
    streams["ssim"].update(made.predicted, made.target)
    streams["mpjpe_global"].update(_frames(made.positions[:, asked]), _frames(made.true_positions[:, asked]))
    streams["rotation_angle_error"].update(_frames(made.turned[:, asked]), _frames(made.true_turned[:, asked]))
    for name in timed_metrics():
        streams[name].update(made.positions, made.true_positions, fps=made.fps)


def _with_rotations(poses: Poses) -> Poses:
    """Poses with positions only get rotations by inverse kinematics, as all rows have."""
    return poses if poses.local_rotations is not None else rows_of_poses(poses, SMPL22).poses()


def _frames(clips: Float32[np.ndarray, "clips frames joints numbers"]) -> Float32[np.ndarray, "rows joints numbers"]:
    return clips.reshape(-1, *clips.shape[2:])
