"""Errors of encoders in in-betweening and extrapolation: L2P, L2Q, NPSS and MPJPE of whole windows."""

from collections.abc import Callable, Sequence

import numpy as np

from eval.completion.encoders import Completer, query_many
from eval.completion.protocol import Question
from eval.completion.scores import Scores, TakeStreams, scores_of
from eval.completion.windows import FPS, PoseWindows, global_poses
from motionkit.core.kinematics import continuous_quaternions
from motionkit.core.shapes import Float32
from motionkit.fields.motion_field import Observation, Poses

METRICS = ("l2p", "l2q", "l2q_as_signed", "npss", "mpjpe_global")
WINDOWS_AT_ONCE = 64


def measure_windows(
    windows: PoseWindows,
    questions: Sequence[Question],
    completer: Completer,
    advance: Callable[[], None] = lambda: None,
) -> Scores:
    """An encoder's figures by metric and question; `advance` is called `num_batches` times.

    Only local rotations and the root's position of its output are used: bones are those of the windows' skeleton, as
    for the truth. Raises `MotionkitError` or `ValueError` if the encoder fails, or has positions only.
    """
    streams = {question.label: TakeStreams(METRICS) for question in questions}
    times = np.arange(windows.root_translation.shape[1], dtype=np.float64) / float(FPS)
    for first in range(0, windows.num_windows, WINDOWS_AT_ONCE):
        part = slice(first, first + WINDOWS_AT_ONCE)
        root, local = windows.root_translation[part], windows.local_rotations[part]
        positions, rotations = global_poses(root, local, windows.skeleton)
        for question in questions:
            given = [
                Observation(times[question.given], Poses(*poses), windows.skeleton)
                for poses in zip(
                    positions[:, question.given].astype(np.float32),
                    local[:, question.given],
                    root[:, question.given],
                    strict=True,
                )
            ]
            made = query_many(completer.encoder, given, times[question.asked], FPS)
            made_root, made_local = _taken(made, local, question)
            predicted, turned = global_poses(made_root, made_local, windows.skeleton)
            true, true_turned = positions[:, question.asked], rotations[:, question.asked]
            for some, of_take in streams[question.label].by_take(windows.takes[part]):
                places, places_true, turns, turns_true = (each[some] for each in (predicted, true, turned, true_turned))
                of_take["l2p"].update(places, places_true, std=windows.position_std)
                of_take["l2q"].update(turns, turns_true)
                of_take["l2q_as_signed"].update(turns, turns_true)
                of_take["npss"].update(*(q.reshape(*q.shape[:2], -1) for q in (turns, turns_true)))
                of_take["mpjpe_global"].update(*(p.reshape(-1, *p.shape[2:]) for p in (places, places_true)))
        advance()
    return scores_of(streams, METRICS)


def num_batches(windows: PoseWindows) -> int:
    """Number of calls of `advance` in `measure_windows`."""
    return -(-windows.num_windows // WINDOWS_AT_ONCE)


def _taken(
    made: Sequence[Poses], given: Float32[np.ndarray, "windows frames joints 4"], question: Question
) -> tuple[Float32[np.ndarray, "windows asked 3"], Float32[np.ndarray, "windows asked joints 4"]]:
    """Root and local rotations of an output, with continuous quaternion signs from the adjacent given pose on."""
    answered = [poses.local_rotations for poses in made if poses.local_rotations is not None]
    if len(answered) < len(made):
        raise ValueError("its motion has positions only, but this table needs rotations")
    roots = np.stack(
        [poses.joint_positions[:, 0] if poses.root_translation is None else poses.root_translation for poses in made]
    )
    local = np.stack(answered)
    # From the given pose next to the stretch: the last one before it, or the first one after it.
    before = question.given[question.given < question.asked[0]]
    beside = int(before[-1]) if before.size else int(question.given[0])
    windows, frames, joints, _ = local.shape
    order = slice(None) if before.size else slice(None, None, -1)
    run = np.concatenate((given[:, beside : beside + 1], local[:, order]), axis=1)
    side_by_side = run.transpose(1, 0, 2, 3).reshape(frames + 1, windows * joints, 4)
    smooth = continuous_quaternions(side_by_side)[1:].reshape(frames, windows, joints, 4).transpose(1, 0, 2, 3)
    return roots, np.ascontiguousarray(smooth[:, order])
