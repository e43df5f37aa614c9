"""The windows of LaFAN1's in-betweening benchmark.

Source: https://github.com/ubisoft/ubisoft-laforge-animation-dataset (lafan1/extract.py and utils.py: windows, centring,
facing).
"""

from dataclasses import dataclass

import numpy as np

from motionkit.core import kinematics
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32, Float64, Int64

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
