"""Windows of 65 frames at 30 fps, for in-betweening (PA-HiRes, Table 3; LaFAN1's benchmark) and extrapolation.

Windows of LaFAN1 itself and of any other data set are prepared as the benchmark prepares them. Source:
https://github.com/ubisoft/ubisoft-laforge-animation-dataset (lafan1/extract.py and utils.py: windows, centring, facing;
Harvey et al. 2020). Extrapolation has no published protocol; this is motionkit's own (docs/metrics.md).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from eval.completion.data_sets import DataSet, local_rotations, open_clips, split_remark
from eval.completion.encoders import Completer, query_many
from eval.completion.scores import Scores, add_clips
from eval.sets.motions import NoRealMotionError
from motionkit.core import kinematics
from motionkit.core.moments import stream
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32, Float64, Int64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.features.rotations import heading, to_window
from motionkit.fields.motion_field import Joints, Observation, Poses
from motionkit.io import bvh_data_sets
from motionkit.store.reader import Store, conjunction

INBETWEENING_VERSION, EXTRAPOLATION_VERSION = "inbetweening/1", "extrapolation/1"
FPS = Fraction(30)
NUM_PAST_FRAMES = 10
BENCHMARK_WINDOWS = 2232
LAFAN1 = "source_format = 'lafan1' AND fps = 30"
CLIPS_AT_ONCE, WINDOWS_AT_ONCE = 512, 64
TRAIN_WINDOW_FRAMES, TRAIN_STEP_FRAMES = 50, 20
TEST_WINDOW_FRAMES, TEST_STEP_FRAMES = 65, 40

RootPaths = Float32[np.ndarray, "windows _frames 3"]
Rotations = Float32[np.ndarray, "windows _frames joints 4"]


@dataclass(frozen=True)
class Question:
    """Given and requested frames of a window, and the table's name for them."""

    label: str
    given: Int64[np.ndarray, "given"]
    requested: Int64[np.ndarray, "requested"]


_PAST = np.arange(NUM_PAST_FRAMES)
# 10 past frames and the first future one are given, the n between them requested.
GAPS = tuple(
    Question(f"{n} frames", np.append(_PAST, NUM_PAST_FRAMES + n), np.arange(NUM_PAST_FRAMES, NUM_PAST_FRAMES + n))
    for n in (5, 15, 30, 45)
)
_SECOND = np.arange(30)
# Of 60 frames the first second is given and the n frames after it requested, or the last one and those before it.
CONTINUATIONS = (
    *(Question(f"after: {n}", _SECOND, np.arange(30, 30 + n)) for n in (5, 15, 30)),
    *(Question(f"before: {n}", _SECOND + 30, np.arange(30 - n, 30)) for n in (5, 15, 30)),
)


def benchmark_windows(motion: Motion, num_frames: int, every: int) -> tuple[RootPaths, Rotations]:
    """Cut a motion into the benchmark's windows: root paths in metres and local rotations.

    Windows start at every multiple of `every` for which start + window < number of frames; the benchmark's comparison
    is strict. Every window is centred on its mean in x and z and rotated about y so that in frame 9 the root's own y
    axis, along which LaFAN1's hips face, points to +x on the ground. Quaternions have continuous signs over the motion.
    Raises `ValueError` for a motion without rotations.
    """
    if motion.local_rotations is None or motion.root_translation is None:
        raise ValueError(f"{motion.sequence_id} has no rotations, which the benchmark is about")
    starts = np.arange(0, max(motion.num_frames - num_frames, 0), every)
    frames = starts[:, None] + np.arange(num_frames)
    rotations = kinematics.continuous_quaternions(motion.local_rotations)[frames].astype(np.float64)
    root = motion.root_translation[frames].astype(np.float64)
    root[..., ::2] -= root[..., ::2].mean(axis=1, keepdims=True)
    facing = kinematics.quaternion_rotate(rotations[:, NUM_PAST_FRAMES - 1, 0], np.array([0.0, 1.0, 0.0]))
    on_ground = facing * np.array([1.0, 0.0, 1.0])
    back = kinematics.quaternion_between(on_ground, np.array([1.0, 0.0, 0.0]))[:, None]
    rotations[:, :, 0] = kinematics.quaternion_multiply(back, rotations[:, :, 0])
    return kinematics.quaternion_rotate(back, root).astype(np.float32), rotations.astype(np.float32)


@dataclass(frozen=True, eq=False)
class PoseWindows:
    """W test windows, and the deviation of training windows' global positions, metres.

    `skeleton` has the offsets of the first training window's first frame, used for all poses, the true ones too.
    `takes` is the take of each window, `remark` names the subjects.
    """

    name: str
    skeleton: Skeleton
    root_translation: RootPaths
    local_rotations: Rotations
    takes: tuple[str, ...]
    position_std: Float64[np.ndarray, "joints 3"]
    remark: str


def lafan1_windows(store: Store) -> PoseWindows:
    """The benchmark's windows out of a store that holds LaFAN1's BVH files: subjects 1–4 train, subject 5 tests.

    The store's split is ignored. The first training window by name gives the bones of all poses. Raises
    `NoRealMotionError` where either set is empty.
    """

    def takes(subjects: tuple[str, ...], num_frames: int) -> list[Motion]:
        names = ", ".join(f"'{subject}'" for subject in subjects)
        where = conjunction(LAFAN1, f"lower(subject) IN ({names})", f"num_frames > {num_frames}")
        paths = store.columns("source_path")["source_path"].loc[store.select(where)].sort_values()
        if paths.empty:
            raise NoRealMotionError(
                f"the store has no take of LaFAN1's {' or '.join(subjects)} at 30 fps with more than {num_frames} "
                "frames (motionkit ingest FOLDER-OF-ITS-BVH)"
            )
        return [store.read(int(index)) for index in paths.index]

    training = takes(bvh_data_sets.TRAIN_SUBJECTS, TRAIN_WINDOW_FRAMES)
    windows = ((benchmark_windows(each, TRAIN_WINDOW_FRAMES, TRAIN_STEP_FRAMES), each.skeleton) for each in training)
    positions = (global_poses(*window, skeleton)[0] for window, skeleton in windows)
    moments = stream(each.reshape(-1, 3 * each.shape[2]) for each in positions)
    test = takes(bvh_data_sets.TEST_SUBJECTS, TEST_WINDOW_FRAMES)
    pairs = [benchmark_windows(motion, TEST_WINDOW_FRAMES, TEST_STEP_FRAMES) for motion in test]
    roots = np.concatenate([root for root, _ in pairs])
    expected = "" if len(roots) == BENCHMARK_WINDOWS else f" (the whole data set has {BENCHMARK_WINDOWS:,})"
    return PoseWindows(
        name="LaFAN1",
        skeleton=training[0].skeleton,
        root_translation=roots,
        local_rotations=np.concatenate([rotations for _, rotations in pairs]),
        takes=tuple(f"LaFAN1 {take}" for take, (root, _) in enumerate(pairs) for _ in root),
        position_std=moments.std.reshape(-1, 3),
        remark=f"subject 5, {len(roots):,} windows{expected}; statistics of subjects 1 to 4.",
    )


def global_poses(
    root: RootPaths, local_rotations: Rotations, skeleton: Skeleton
) -> tuple[Float64[np.ndarray, "windows frames joints 3"], Float64[np.ndarray, "windows frames joints 4"]]:
    """Global positions in metres and global quaternions by the skeleton's offsets, float64.

    A global quaternion is the product of the local ones down from the root, signs and all.
    """
    flat = local_rotations.reshape(-1, *local_rotations.shape[2:]).astype(np.float64)
    positions = kinematics.forward_kinematics(flat, root.reshape(-1, 3).astype(np.float64), skeleton)
    rotations = kinematics.global_rotations(flat, skeleton)
    shape = local_rotations.shape[:3]
    return positions.reshape(*shape, 3), rotations.reshape(*shape, 4)


def data_set_windows(store: Store, data_set: DataSet, split: str, where: str | None) -> PoseWindows:
    """The same windows of any data set in the 22-joint layout, its rotations those of rotation rows.

    Statistics are of the training split's windows, of the compared ones where there is none. Raises
    `NoRealMotionError` where the compared split has no window.
    """
    # The benchmark needs a frame after each window (strict i + window < T): equivalent to clips of one frame more.
    train_size, test_size = (TRAIN_WINDOW_FRAMES + 1, TRAIN_STEP_FRAMES), (TEST_WINDOW_FRAMES + 1, TEST_STEP_FRAMES)
    test = open_clips(store, data_set, split, where, *test_size)
    remark = f"{len(test.takes):,} windows of {len(set(test.takes)):,} takes; {split_remark(store, test, split)}"
    try:
        train = open_clips(store, data_set, "train", None, *train_size)
    except NoRealMotionError:
        train = open_clips(store, data_set, split, where, *train_size)
        remark += " There is no training split: statistics are those of the compared takes."

    def training_positions() -> Iterator[Float64[np.ndarray, "rows numbers"]]:
        for _, positions, vectors in train.read(CLIPS_AT_ONCE):
            yaw, origin = _benchmark_frame(vectors[:, :-1])
            centred = positions[:, :-1].astype(np.float64)
            centred[..., ::2] -= origin[:, None, None]
            back = kinematics.rotation_vector_to_quaternion(yaw[:, None, None, None] * np.array([0.0, -1.0, 0.0]))
            yield kinematics.quaternion_rotate(back, centred).reshape(-1, 3 * SMPL22.num_joints)

    _, positions, vectors = next(train.read(1))
    first_pose = Joints.of(Poses(positions[0, :1], local_rotations(vectors[0, :1])), SMPL22)
    windows = (vectors[:, :-1] for _, _, vectors in test.read(CLIPS_AT_ONCE))
    rows = np.concatenate([to_window(each, *_benchmark_frame(each)) for each in windows])
    return PoseWindows(
        name=data_set.label,
        skeleton=replace(SMPL22, offsets=first_pose.bones[0].astype(np.float32)),
        root_translation=rows[..., :3],
        local_rotations=_continuous(local_rotations(rows)),
        takes=test.takes,
        position_std=stream(training_positions()).std.reshape(-1, 3),
        remark=remark,
    )


def _benchmark_frame(
    vectors: Float32[np.ndarray, "windows frames numbers"],
) -> tuple[Float64[np.ndarray, "windows"], Float64[np.ndarray, "windows 2"]]:
    """Yaw and origin of the benchmark's frame: centred in x and z, frame 9 facing +x."""
    yaw = heading(vectors[:, NUM_PAST_FRAMES - 1], SMPL22)
    origin = vectors[..., (0, 2)].astype(np.float64).mean(axis=1)
    return yaw - np.pi / 2, origin


def _continuous(rotations: Rotations) -> Rotations:
    """Make quaternion signs continuous within each window."""
    frames_first = rotations.swapaxes(0, 1)
    smooth = kinematics.continuous_quaternions(frames_first.reshape(len(frames_first), -1, 4))
    return np.ascontiguousarray(smooth.reshape(frames_first.shape).swapaxes(0, 1))


def measure_windows(windows: PoseWindows, questions: Sequence[Question], completer: Completer) -> Scores:
    """An encoder's L2P, L2Q (both), NPSS and MPJPE by metric and question.

    Only local rotations and the root's position of its output are used, on the bones of the windows' skeleton. Raises
    `MotionkitError` or `ValueError` if the encoder fails, or has positions only.
    """
    scores: Scores = {}
    times = np.arange(windows.root_translation.shape[1], dtype=np.float64) / float(FPS)
    for first in range(0, len(windows.takes), WINDOWS_AT_ONCE):
        batch = slice(first, first + WINDOWS_AT_ONCE)
        root, local, takes = windows.root_translation[batch], windows.local_rotations[batch], windows.takes[batch]
        positions, rotations = global_poses(root, local, windows.skeleton)
        for question in questions:
            given, requested = question.given, question.requested
            observed = [
                Observation(times[given], Poses(*poses), windows.skeleton)
                for poses in zip(positions[:, given].astype(np.float32), local[:, given], root[:, given], strict=True)
            ]
            predicted = query_many(completer.encoder, observed, times[requested], FPS)
            own_root = np.stack([poses.joint_positions[:, 0] for poses in predicted])
            own_local = _signed_rotations(predicted, local, question)
            own_positions, own_rotations = global_poses(own_root, own_local, windows.skeleton)
            places, turns = (own_positions, positions[:, requested]), (own_rotations, rotations[:, requested])
            add_clips(scores, question.label, takes, "l2p", *places, std=windows.position_std)
            add_clips(scores, question.label, takes, "l2q", *turns)
            add_clips(scores, question.label, takes, "l2q_as_signed", *turns)
            add_clips(scores, question.label, takes, "npss", *(each.reshape(*each.shape[:2], -1) for each in turns))
            add_clips(scores, question.label, takes, "mpjpe_global", *places)
    return scores


def _signed_rotations(predicted: Sequence[Poses], local: Rotations, question: Question) -> Rotations:
    """Local rotations of an output, with continuous quaternion signs from the adjacent given pose on."""
    rotations = [poses.local_rotations for poses in predicted if poses.local_rotations is not None]
    if len(rotations) < len(predicted):
        raise ValueError("its motion has positions only, but this table needs rotations")
    # The given pose next to the requested frames: the last one before them, or the first one after them.
    before = question.given[question.given < question.requested[0]]
    beside, order = (before[-1], slice(None)) if before.size else (question.given[0], slice(None, None, -1))
    in_order = np.concatenate((local[:, [beside]], np.stack(rotations)[:, order]), axis=1)
    return np.ascontiguousarray(_continuous(in_order)[:, 1:][:, order])
