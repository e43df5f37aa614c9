"""Windows of 65 frames as LaFAN1's benchmark prepares them: of LaFAN1 itself, and of any data set at 30 fps.

Source: https://github.com/ubisoft/ubisoft-laforge-animation-dataset (lafan1/extract.py and utils.py: windows, centring,
facing).
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from eval.completion.protocol import NUM_PAST_FRAMES
from eval.completion.scores import split_remark
from eval.completion.takes import DataSet, NoTakesError, open_clips
from motionkit.core import kinematics
from motionkit.core.moments import Moments, stream
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32, Float64, Int64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.features.rotations import heading, to_window
from motionkit.io import lafan1
from motionkit.store.sql import conjunction

if TYPE_CHECKING:
    from motionkit.store.reader import Store

FPS = Fraction(30)
BENCHMARK_WINDOWS = 2232
LAFAN1 = "source_format = 'lafan1' AND fps = 30"
CLIPS_AT_ONCE = 512
TRAIN_WINDOW_FRAMES, TRAIN_STEP_FRAMES = 50, 20
TEST_WINDOW_FRAMES, TEST_STEP_FRAMES = 65, 40


@dataclass(frozen=True)
class BenchmarkWindows:
    """Windows of one take as the benchmark prepares them: `start_frames` in the take, root path in metres, rotations.

    Every window is centred on its mean in x and z and rotated about y so that in frame 9 the root's own y axis, along
    which LaFAN1's hips face, points to +x on the ground. Quaternions have continuous signs over the take.
    """

    start_frames: Int64[np.ndarray, "windows"]
    root_translation: Float32[np.ndarray, "windows frames 3"]
    local_rotations: Float32[np.ndarray, "windows frames joints 4"]


def benchmark_windows(motion: Motion, *, window_frames: int, step_frames: int) -> BenchmarkWindows:
    """Cut a take into the benchmark's windows (test: 65 frames every 40; training: 50 every 20).

    A window starts at every multiple of the step for which start + window < number of frames: the comparison is strict,
    so a window that ends with the last frame is left out. Raises `ValueError` for a motion without rotations, or for
    windows too short to have the frame that sets their heading.
    """
    if motion.local_rotations is None or motion.root_translation is None:
        raise ValueError(f"{motion.sequence_id} has no rotations, which the benchmark is about")
    if window_frames < NUM_PAST_FRAMES or step_frames < 1:
        raise ValueError(f"windows of {window_frames} frames every {step_frames}, expected at least 10 every 1")
    starts = np.arange(0, max(motion.num_frames - window_frames, 0), step_frames)
    frames = starts[:, None] + np.arange(window_frames)
    rotations = kinematics.continuous_quaternions(motion.local_rotations)[frames].astype(np.float64)
    root = motion.root_translation[frames].astype(np.float64)
    root[..., ::2] -= root[..., ::2].mean(axis=1, keepdims=True)
    back = _turn_to_x(rotations[:, NUM_PAST_FRAMES - 1, 0])[:, None]
    rotations[:, :, 0] = kinematics.quaternion_multiply(back, rotations[:, :, 0])
    return BenchmarkWindows(
        start_frames=starts,
        root_translation=kinematics.quaternion_rotate(back, root).astype(np.float32),
        local_rotations=rotations.astype(np.float32),
    )


def _turn_to_x(root: Float64[np.ndarray, "windows 4"]) -> Float64[np.ndarray, "windows 4"]:
    forward = kinematics.quaternion_rotate(root, np.array([0.0, 1.0, 0.0])) * np.array([1.0, 0.0, 1.0])
    return kinematics.quaternion_between(forward, np.array([1.0, 0.0, 0.0]))


@dataclass(frozen=True, eq=False)
class PoseWindows:
    """W test windows, and statistics of training windows.

    `skeleton` has the offsets of the first training window's first frame, used for all poses, the true ones too.
    `position_std` [J, 3] is the deviation of training windows' global positions, metres. `remark` names the subjects.
    """

    name: str
    skeleton: Skeleton
    root_translation: Float32[np.ndarray, "windows frames 3"]
    local_rotations: Float32[np.ndarray, "windows frames joints 4"]
    takes: tuple[str, ...]
    position_std: Float64[np.ndarray, "joints 3"]
    num_training_windows: int
    remark: str

    @property
    def num_windows(self) -> int:
        """Number of test windows W."""
        return len(self.root_translation)


def lafan1_windows(store: "Store", advance: Callable[[], None] = lambda: None) -> PoseWindows:
    """The benchmark's windows out of a store that holds LaFAN1's BVH files: subjects 1–4 train, subject 5 tests.

    Subjects decide, not the store's split. Takes come in the order of their names, so that the first training window,
    whose bones all poses get, is that of the first name. Raises `NoTakesError` where either set is empty.
    """
    training = _lafan1_takes(store, lafan1.TRAIN_SUBJECTS)
    test = _lafan1_takes(store, lafan1.TEST_SUBJECTS)
    moments, skeleton = _training_statistics(_advancing(training, advance))
    found = [benchmark_windows(motion, **_TEST) for motion in _advancing(test, advance)]
    roots = np.concatenate([windows.root_translation for windows in found])
    if not len(roots):
        raise NoTakesError(f"no take of subject 5 is longer than {TEST_WINDOW_FRAMES} frames")
    expected = "" if len(roots) == BENCHMARK_WINDOWS else f" (the whole data set has {BENCHMARK_WINDOWS:,})"
    return PoseWindows(
        name="LaFAN1",
        skeleton=skeleton,
        root_translation=roots,
        local_rotations=np.concatenate([windows.local_rotations for windows in found]),
        takes=tuple(f"LaFAN1 {take}" for take, each in enumerate(found) for _ in each.root_translation),
        position_std=moments.std.reshape(-1, 3),
        num_training_windows=moments.count // TRAIN_WINDOW_FRAMES,
        remark=f"subject 5, {len(roots):,} windows{expected}; statistics of subjects 1 to 4.",
    )


_TEST = {"window_frames": TEST_WINDOW_FRAMES, "step_frames": TEST_STEP_FRAMES}
_TRAIN = {"window_frames": TRAIN_WINDOW_FRAMES, "step_frames": TRAIN_STEP_FRAMES}


def num_lafan1_takes(store: "Store") -> int:
    """Number of calls of `advance` in `lafan1_windows`."""
    subjects = (*lafan1.TRAIN_SUBJECTS, *lafan1.TEST_SUBJECTS)
    return len(store.select(_of_subjects(subjects)))


def _of_subjects(subjects: Iterable[str]) -> str:
    named = ", ".join(f"'{subject}'" for subject in subjects)
    return conjunction(LAFAN1, f"lower(subject) IN ({named})")


def _lafan1_takes(store: "Store", subjects: tuple[str, ...]) -> list[Motion]:
    chosen = store.select(_of_subjects(subjects))
    if not len(chosen):
        raise NoTakesError(
            f"the store has no take of LaFAN1's {' or '.join(subjects)} at 30 fps (motionkit ingest FOLDER-OF-ITS-BVH)"
        )
    paths = store.columns("source_path")["source_path"].loc[chosen]
    return [store.read(int(index)) for index in paths.sort_values().index]


def _advancing(motions: Iterable[Motion], advance: Callable[[], None]) -> Iterator[Motion]:
    for motion in motions:
        yield motion
        advance()


def _training_statistics(motions: Iterable[Motion]) -> tuple[Moments, Skeleton]:
    """Moments of the global positions of all training windows' frames, and the first take's skeleton."""
    skeletons: list[Skeleton] = []

    def parts() -> Iterator[Float32[np.ndarray, "rows numbers"]]:
        for motion in motions:
            windows = benchmark_windows(motion, **_TRAIN)
            if not len(windows.start_frames):
                continue
            skeletons.append(motion.skeleton)
            positions = global_poses(windows.root_translation, windows.local_rotations, motion.skeleton)[0]
            yield positions.reshape(-1, positions.shape[2] * 3)

    try:
        return stream(parts()), skeletons[0]
    except ValueError:
        raise NoTakesError(f"no training take is longer than {TRAIN_WINDOW_FRAMES} frames") from None


def global_poses(
    root: Float32[np.ndarray, "windows frames 3"],
    local_rotations: Float32[np.ndarray, "windows frames joints 4"],
    skeleton: Skeleton,
) -> tuple[Float64[np.ndarray, "windows frames joints 3"], Float64[np.ndarray, "windows frames joints 4"]]:
    """Global positions in metres and global quaternions by the skeleton's offsets, float64.

    A global quaternion is the product of the local ones down from the root, signs and all.
    """
    flat = local_rotations.reshape(-1, *local_rotations.shape[2:]).astype(np.float64)
    positions = kinematics.forward_kinematics(flat, root.reshape(-1, 3).astype(np.float64), skeleton)
    rotations = kinematics.global_rotations(flat, skeleton)
    shape = local_rotations.shape[:3]
    return positions.reshape(*shape, 3), rotations.reshape(*shape, 4)


def data_set_windows(store: "Store", data_set: DataSet, split: str, where: str | None) -> PoseWindows:
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

    def parts() -> Iterator[Float32[np.ndarray, "rows numbers"]]:
        for first in range(0, train.num_clips, CLIPS_AT_ONCE):
            poses = train.read(slice(first, first + CLIPS_AT_ONCE)).frames(slice(0, -1))
            yaw, origin = _benchmark_frame(poses.vectors)
            yield _turned_positions(poses.joint_positions, yaw, origin).reshape(-1, 3 * SMPL22.num_joints)

    moments = stream(parts())
    first_pose = train.read(slice(0, 1)).frames(slice(0, 1))
    turned = []
    for first in range(0, test.num_clips, CLIPS_AT_ONCE):
        vectors = test.vectors(slice(first, first + CLIPS_AT_ONCE))[:, :-1]
        turned.append(to_window(vectors, *_benchmark_frame(vectors)))
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


def _turned_positions(
    positions: Float32[np.ndarray, "windows frames joints 3"],
    yaw: Float64[np.ndarray, "windows"],
    origin: Float64[np.ndarray, "windows 2"],
) -> Float64[np.ndarray, "windows frames joints 3"]:
    x, z = (positions[..., axis] - origin[:, None, None, place] for place, axis in ((0, 0), (1, 2)))
    sine, cosine = np.sin(-yaw)[:, None, None], np.cos(-yaw)[:, None, None]
    return np.stack((cosine * x + sine * z, positions[..., 1].astype(np.float64), cosine * z - sine * x), axis=-1)


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


def _continuous(
    rotations: Float32[np.ndarray, "windows frames joints 4"],
) -> Float32[np.ndarray, "windows frames joints 4"]:
    """Make quaternion signs continuous within each window."""
    windows, frames, joints, _ = rotations.shape
    side_by_side = rotations.transpose(1, 0, 2, 3).reshape(frames, windows * joints, 4)
    smooth = kinematics.continuous_quaternions(side_by_side).reshape(frames, windows, joints, 4)
    return np.ascontiguousarray(smooth.transpose(1, 0, 2, 3))
