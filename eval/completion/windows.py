"""Windows of 65 frames at 30 fps, for in-betweening (PA-HiRes, Table 3; LaFAN1's benchmark) and extrapolation.

Windows of LaFAN1 itself and of any other data set are prepared as the benchmark prepares them. Source:
https://github.com/ubisoft/ubisoft-laforge-animation-dataset (lafan1/extract.py and utils.py: windows, centring, facing;
Harvey et al. 2020). Extrapolation has no published protocol; this is motionkit's own (docs/metrics.md).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from eval.completion.data_sets import DataSet, NoTakesError, open_clips, split_remark
from eval.completion.encoders import Completer, query_many
from eval.completion.scores import Scores, add_clips
from motionkit.core import kinematics
from motionkit.core.moments import stream
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32, Float64, Int64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.features.rotations import heading, to_window
from motionkit.fields.motion_field import Observation, Poses
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
    asked: Int64[np.ndarray, "asked"]


def gaps(lengths: Sequence[int] = (5, 15, 30, 45)) -> tuple[Question, ...]:
    """10 past frames and the first future one are given, the n between them requested."""
    past = np.arange(NUM_PAST_FRAMES)
    return tuple(
        Question(f"{n} frames", np.append(past, NUM_PAST_FRAMES + n), np.arange(NUM_PAST_FRAMES, NUM_PAST_FRAMES + n))
        for n in lengths
    )


def continuations(lengths: Sequence[int] = (5, 15, 30), num_given: int = 30) -> tuple[Question, ...]:
    """A second at 30 fps is given, the n frames after it requested; and likewise backwards.

    The given second is the first one of the window, or the last one of the same 60 frames.
    """
    first, longest = np.arange(num_given), max(lengths)
    after = (Question(f"after: {n}", first, np.arange(num_given, num_given + n)) for n in lengths)
    before = (Question(f"before: {n}", first + longest, np.arange(longest - n, longest)) for n in lengths)
    return (*after, *before)


def benchmark_windows(motion: Motion, num_frames: int, every: int) -> tuple[RootPaths, Rotations]:
    """Cut a take into the benchmark's windows: root paths in metres and local rotations.

    A window starts at every multiple of `every` for which start + window < number of frames: the comparison is strict,
    so a window that ends with the last frame is left out. Every window is centred on its mean in x and z and rotated
    about y so that in frame 9 the root's own y axis, along which LaFAN1's hips face, points to +x on the ground.
    Quaternions have continuous signs over the take. Raises `ValueError` for a motion without rotations.
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
    """W test windows, and statistics of training windows.

    `skeleton` has the offsets of the first training window's first frame, used for all poses, the true ones too.
    `position_std` [J, 3] is the deviation of training windows' global positions, metres. `remark` names the subjects.
    """

    name: str
    skeleton: Skeleton
    root_translation: RootPaths
    local_rotations: Rotations
    takes: tuple[str, ...]
    position_std: Float64[np.ndarray, "joints 3"]
    num_training_windows: int
    remark: str

    @property
    def num_windows(self) -> int:
        """Number of test windows W."""
        return len(self.root_translation)


def lafan1_windows(store: Store) -> PoseWindows:
    """The benchmark's windows out of a store that holds LaFAN1's BVH files: subjects 1–4 train, subject 5 tests.

    Subjects decide, not the store's split. Takes come in the order of their names, so that the first training window,
    whose bones all poses get, is that of the first name. Raises `NoTakesError` where either set is empty.
    """
    training = [
        motion
        for motion in _lafan1_takes(store, bvh_data_sets.TRAIN_SUBJECTS)
        if motion.num_frames > TRAIN_WINDOW_FRAMES
    ]
    if not training:
        raise NoTakesError(f"no training take is longer than {TRAIN_WINDOW_FRAMES} frames")
    windows = (benchmark_windows(motion, TRAIN_WINDOW_FRAMES, TRAIN_STEP_FRAMES) for motion in training)
    positions = (global_poses(*each, motion.skeleton)[0] for each, motion in zip(windows, training, strict=True))
    moments = stream(each.reshape(-1, 3 * each.shape[2]) for each in positions)
    test = _lafan1_takes(store, bvh_data_sets.TEST_SUBJECTS)
    found = [benchmark_windows(motion, TEST_WINDOW_FRAMES, TEST_STEP_FRAMES) for motion in test]
    roots = np.concatenate([root for root, _ in found])
    if not len(roots):
        raise NoTakesError(f"no take of subject 5 is longer than {TEST_WINDOW_FRAMES} frames")
    expected = "" if len(roots) == BENCHMARK_WINDOWS else f" (the whole data set has {BENCHMARK_WINDOWS:,})"
    return PoseWindows(
        name="LaFAN1",
        skeleton=training[0].skeleton,
        root_translation=roots,
        local_rotations=np.concatenate([rotations for _, rotations in found]),
        takes=tuple(f"LaFAN1 {take}" for take, (root, _) in enumerate(found) for _ in root),
        position_std=moments.std.reshape(-1, 3),
        num_training_windows=moments.count // TRAIN_WINDOW_FRAMES,
        remark=f"subject 5, {len(roots):,} windows{expected}; statistics of subjects 1 to 4.",
    )


def _lafan1_takes(store: Store, subjects: tuple[str, ...]) -> list[Motion]:
    named = ", ".join(f"'{subject}'" for subject in subjects)
    chosen = store.select(conjunction(LAFAN1, f"lower(subject) IN ({named})"))
    if not len(chosen):
        raise NoTakesError(
            f"the store has no take of LaFAN1's {' or '.join(subjects)} at 30 fps (motionkit ingest FOLDER-OF-ITS-BVH)"
        )
    paths = store.columns("source_path")["source_path"].loc[chosen]
    return [store.read(int(index)) for index in paths.sort_values().index]


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

    Statistics are of the training split's windows, of the compared ones where there is none. Raises `NoTakesError`
    where the compared split has no window.
    """
    # The benchmark needs a frame after each window (strict i + window < T): equivalent to clips of one frame more.
    test = open_clips(store, data_set, split, where, TEST_WINDOW_FRAMES + 1, TEST_STEP_FRAMES)
    remark = split_remark(store, test, split)
    try:
        train = open_clips(store, data_set, "train", None, TRAIN_WINDOW_FRAMES + 1, TRAIN_STEP_FRAMES)
    except NoTakesError:
        train = open_clips(store, data_set, split, where, TRAIN_WINDOW_FRAMES + 1, TRAIN_STEP_FRAMES)
        remark += " There is no training split: statistics are those of the compared takes."

    def parts() -> Iterator[Float64[np.ndarray, "rows numbers"]]:
        for _, clips in train.read(CLIPS_AT_ONCE):
            poses = clips.frames(slice(0, -1))
            yaw, origin = _benchmark_frame(poses.vectors)
            centred = poses.joint_positions.astype(np.float64)
            centred[..., ::2] -= origin[:, None, None]
            back = kinematics.rotation_vector_to_quaternion(yaw[:, None, None, None] * np.array([0.0, -1.0, 0.0]))
            yield kinematics.quaternion_rotate(back, centred).reshape(-1, 3 * SMPL22.num_joints)

    moments = stream(parts())
    first_pose = next(train.read(1))[1].frames(slice(0, 1))
    windows = (clips.vectors[:, :-1] for _, clips in test.read(CLIPS_AT_ONCE))
    turned = [to_window(vectors, *_benchmark_frame(vectors)) for vectors in windows]
    rows = np.concatenate(turned)
    matrices = kinematics.closest_rotations(rows[..., 3:])
    rotations = kinematics.matrix_to_quaternion(matrices).astype(np.float32)
    return PoseWindows(
        name=data_set.label,
        skeleton=replace(SMPL22, offsets=_bones(first_pose.joint_positions[0], first_pose.local_rotations()[0])),
        root_translation=rows[..., :3],
        local_rotations=_continuous(rotations),
        takes=test.takes,
        position_std=moments.std.reshape(-1, 3),
        num_training_windows=moments.count // TRAIN_WINDOW_FRAMES,
        remark=f"{test.num_clips:,} windows of {test.num_takes:,} takes; {remark}",
    )


def _benchmark_frame(
    vectors: Float32[np.ndarray, "windows frames numbers"],
) -> tuple[Float64[np.ndarray, "windows"], Float64[np.ndarray, "windows 2"]]:
    """Yaw and origin of the benchmark's frame: centred in x and z, frame 9 facing +x."""
    yaw = heading(vectors[:, NUM_PAST_FRAMES - 1], SMPL22)
    origin = vectors[..., (0, 2)].astype(np.float64).mean(axis=1)
    return yaw - np.pi / 2, origin


def _bones(
    positions: Float32[np.ndarray, "1 joints 3"], rotations: Float32[np.ndarray, "1 joints 4"]
) -> Float32[np.ndarray, "joints 3"]:
    """Every joint's position in its parent's frame; the root's is the origin."""
    world = kinematics.global_rotations(rotations.astype(np.float64), SMPL22)
    parents = list(SMPL22.parents[1:])
    bones = np.zeros((SMPL22.num_joints, 3), np.float32)
    bones[1:] = kinematics.quaternion_rotate(
        kinematics.quaternion_conjugate(world[0, parents]), positions[0, 1:].astype(np.float64) - positions[0, parents]
    )
    return bones


def _continuous(rotations: Rotations) -> Rotations:
    """Make quaternion signs continuous within each window."""
    windows, frames, joints, _ = rotations.shape
    side_by_side = rotations.transpose(1, 0, 2, 3).reshape(frames, windows * joints, 4)
    smooth = kinematics.continuous_quaternions(side_by_side).reshape(frames, windows, joints, 4)
    return np.ascontiguousarray(smooth.transpose(1, 0, 2, 3))


def measure_windows(windows: PoseWindows, questions: Sequence[Question], completer: Completer) -> Scores:
    """An encoder's L2P, L2Q (both), NPSS and MPJPE by metric and question.

    Only local rotations and the root's position of its output are used: bones are those of the windows' skeleton, as
    for the truth. Raises `MotionkitError` or `ValueError` if the encoder fails, or has positions only.
    """
    scores: Scores = {}
    times = np.arange(windows.root_translation.shape[1], dtype=np.float64) / float(FPS)
    for first in range(0, windows.num_windows, WINDOWS_AT_ONCE):
        part = slice(first, first + WINDOWS_AT_ONCE)
        root, local, takes = windows.root_translation[part], windows.local_rotations[part], windows.takes[part]
        positions, rotations = global_poses(root, local, windows.skeleton)
        for question in questions:
            given, asked = question.given, question.asked
            observed = [
                Observation(times[given], Poses(*poses), windows.skeleton)
                for poses in zip(positions[:, given].astype(np.float32), local[:, given], root[:, given], strict=True)
            ]
            made = query_many(completer.encoder, observed, times[asked], FPS)
            predicted, turned = global_poses(*_root_and_rotations(made, local, question), windows.skeleton)
            places, turns = (predicted, positions[:, asked]), (turned, rotations[:, asked])
            add_clips(scores, question.label, takes, "l2p", *places, std=windows.position_std)
            add_clips(scores, question.label, takes, "l2q", *turns)
            add_clips(scores, question.label, takes, "l2q_as_signed", *turns)
            add_clips(scores, question.label, takes, "npss", *(each.reshape(*each.shape[:2], -1) for each in turns))
            add_clips(scores, question.label, takes, "mpjpe_global", *places)
    return scores


def _root_and_rotations(made: Sequence[Poses], local: Rotations, question: Question) -> tuple[RootPaths, Rotations]:
    """Root and local rotations of an output, with continuous quaternion signs from the adjacent given pose on."""
    answered = [poses.local_rotations for poses in made if poses.local_rotations is not None]
    if len(answered) < len(made):
        raise ValueError("its motion has positions only, but this table needs rotations")
    roots = np.stack(
        [poses.joint_positions[:, 0] if poses.root_translation is None else poses.root_translation for poses in made]
    )
    # The given pose next to the requested frames: the last one before them, or the first one after them.
    before = question.given[question.given < question.asked[0]]
    beside = int(before[-1]) if before.size else int(question.given[0])
    order = slice(None) if before.size else slice(None, None, -1)
    run = np.concatenate((local[:, beside : beside + 1], np.stack(answered)[:, order]), axis=1)
    return roots, np.ascontiguousarray(_continuous(run)[:, 1:][:, order])
