"""The windows of LaFAN1's benchmark, against its loop and rotation matrices."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from eval.completion.windows import (
    TEST_STEP_FRAMES,
    TEST_WINDOW_FRAMES,
    TRAIN_STEP_FRAMES,
    TRAIN_WINDOW_FRAMES,
    benchmark_windows,
)
from motionkit.core.motion import Motion
from motionkit.io.lafan1 import read_lafan1
from tests.helpers.format_samples import lafan1_text


@pytest.fixture
def take(tmp_path: Path) -> Motion:
    path = tmp_path / "walk1_subject5.bvh"
    path.write_text(lafan1_text(130))
    return read_lafan1(path)


@pytest.mark.parametrize("num_frames", [8, 65, 66, 105, 106, 107, 130])
def test_windows_begin_every_40_frames_and_end_before_the_last_frame(tmp_path: Path, num_frames: int) -> None:
    path = tmp_path / "walk1_subject5.bvh"
    path.write_text(lafan1_text(num_frames))
    windows = benchmark_windows(read_lafan1(path), window_frames=TEST_WINDOW_FRAMES, step_frames=TEST_STEP_FRAMES)
    # Counted one by one, as the benchmark's loop states it: start while start + window < number of frames.
    starts, start = [], 0
    while start + 65 < num_frames:
        starts.append(start)
        start += 40
    assert windows.start_frames.tolist() == starts
    assert windows.local_rotations.shape == (len(starts), 65, 22, 4)


def test_a_window_is_centred_and_faces_x_in_frame_9(take: Motion) -> None:
    windows = benchmark_windows(take, window_frames=TRAIN_WINDOW_FRAMES, step_frames=TRAIN_STEP_FRAMES)
    assert len(windows.start_frames) == 4
    assert np.allclose(windows.root_translation[..., ::2].mean(axis=1), 0.0, atol=1e-6)
    hips = Rotation.from_quat(windows.local_rotations[:, 9, 0], scalar_first=True).apply([0.0, 1.0, 0.0])
    assert np.allclose(hips, [1.0, 0.0, 0.0], atol=1e-6)
    # Everything below the root, heights and lengths of steps are the take's own.
    for window, start in enumerate(windows.start_frames):
        part = slice(start, start + TRAIN_WINDOW_FRAMES)
        assert take.local_rotations is not None and take.root_translation is not None
        assert np.array_equal(windows.local_rotations[window, :, 1:], take.local_rotations[part, 1:])
        steps = [np.linalg.norm(np.diff(path, axis=0), axis=-1) for path in (
            windows.root_translation[window], take.root_translation[part]
        )]  # fmt: skip
        assert np.allclose(*steps, atol=1e-5)
        # The same window by rotation matrices: turned about y by what brings the hips of frame 9 to +x.
        turns = Rotation.from_quat(take.local_rotations[part, 0], scalar_first=True)
        x, _, z = turns[9].apply([0.0, 1.0, 0.0])
        back = Rotation.from_euler("y", np.arctan2(z, x))
        centred = take.root_translation[part] - take.root_translation[part].mean(axis=0) * [1.0, 0.0, 1.0]
        assert np.allclose(back.apply(centred), windows.root_translation[window], atol=1e-5)
        found = Rotation.from_quat(windows.local_rotations[window, :, 0], scalar_first=True)
        assert np.allclose((back * turns).as_matrix(), found.as_matrix(), atol=1e-5)


def test_quaternions_run_on_without_changes_of_sign(take: Motion) -> None:
    assert take.local_rotations is not None
    flipped = take.local_rotations.copy()
    flipped[1::2] *= -1
    windows = benchmark_windows(
        Motion(take.joint_positions, take.skeleton, take.timegrid, flipped, take.root_translation),
        window_frames=50,
        step_frames=20,
    )
    products = np.sum(windows.local_rotations[:, 1:] * windows.local_rotations[:, :-1], axis=-1)
    assert (products > 0).all()


def test_what_cannot_be_windowed_is_refused(take: Motion) -> None:
    with pytest.raises(ValueError, match="no rotations"):
        benchmark_windows(Motion(take.joint_positions, take.skeleton, take.timegrid), window_frames=50, step_frames=20)
    with pytest.raises(ValueError, match="expected at least 10 every 1"):
        benchmark_windows(take, window_frames=9, step_frames=20)
