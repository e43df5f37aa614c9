"""LaFAN1: BVH in centimetres at 30 fps, `walk1_subject1.bvh`, and the windows of its in-betweening benchmark.

Source: https://github.com/ubisoft/ubisoft-laforge-animation-dataset (README.md: names and themes; evaluate.py: the
actors of both sets; lafan1/extract.py and utils.py: windows, centring, facing). The same names at 60 fps are
https://github.com/orangeduck/lafan1-resolved, which is read the same way.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from motionkit.core import kinematics
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32, Float64, Int64
from motionkit.io.bvh import BvhDocument, read_bvh, read_document
from motionkit.io.registry import FileHead, Format, ReadOptions, of_path

THEMES = (
    *("aiming", "dance", "fallAndGetUp", "fight", "fightAndSports", "ground", "jumps", "multipleActions", "obstacles"),
    *("push", "pushAndFall", "pushAndStumble", "run", "sprint", "walk"),
)
NAME = re.compile(rf"(?P<theme>{'|'.join(THEMES)})(?P<take>\d+)_(?P<subject>subject\d+)", re.IGNORECASE)
TRAIN_SUBJECTS = ("subject1", "subject2", "subject3", "subject4")
TEST_SUBJECTS = ("subject5",)

TRAIN_WINDOW_FRAMES, TRAIN_STEP_FRAMES = 50, 20
TEST_WINDOW_FRAMES, TEST_STEP_FRAMES = 65, 40
NUM_PAST_FRAMES = 10


@dataclass(frozen=True)
class BenchmarkWindows:
    """Windows of one take as the benchmark prepares them: `start_frames` in the take, root path in metres, rotations.

    Every window is centred on its mean in x and z and rotated about y so that in frame 9 the root's own y axis, along
    which LaFAN1's hips face, points to +x on the ground. Quaternions have continuous signs over the take.
    """

    start_frames: Int64[np.ndarray, "windows"]
    root_translation: Float32[np.ndarray, "windows frames 3"]
    local_rotations: Float32[np.ndarray, "windows frames joints 4"]


def accepts(head: FileHead) -> bool:
    """Whether a BVH file has one of LaFAN1's names: a theme, a take number and a subject."""
    return NAME.fullmatch(head.path.stem) is not None


def read_lafan1(path: Path, options: ReadOptions | None = None) -> Motion:
    """Read one take with its theme as the action, its subject, and the benchmark's split: subject 5 is the test set.

    The root's OFFSET, a take's starting position, is set to zero, so that takes of one subject share their skeleton;
    position channels replace it anyway. Raises `FormatError` as `read_bvh` does.
    """
    return _labelled(read_bvh(path, options), path)


def read_lafan1_document(path: Path, options: ReadOptions | None = None) -> BvhDocument:
    """The same with the file's text; raises `FormatError` as `read_document` does."""
    document = read_document(path, options)
    return replace(document, motion=_labelled(document.motion, path))


def _labelled(motion: Motion, path: Path) -> Motion:
    offsets = motion.skeleton.offsets.copy()
    offsets[0] = 0.0
    name = NAME.fullmatch(path.stem)
    subject = name["subject"].lower() if name else ""
    return replace(
        motion,
        skeleton=replace(motion.skeleton, name="lafan1", offsets=offsets),
        action=name["theme"] if name else "",
        split="test" if subject in TEST_SUBJECTS else "train" if subject in TRAIN_SUBJECTS else "",
        provenance=replace(motion.provenance, source_format="lafan1", subject=subject),
    )


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


FORMAT = Format(
    name="lafan1",
    read=of_path(read_lafan1),
    document=read_lafan1_document,
    suffixes=(".bvh",),
    accepts=accepts,
    turns_up=True,
)
