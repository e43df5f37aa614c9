"""The three conventions of pose vectors: what is encoded comes back, mirrored and between frames too, and trains."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from eval.tables.nerm.reconstruction import window_truth
from motionkit.core.motion import mirror_positions
from motionkit.data.windows import WindowPoses, cut_windows, open_frames, training_rig, training_vectors, with_rotations
from motionkit.features import field, native
from motionkit.fields.motion_field import to_motion
from motionkit.store.cache import PositionCache
from tests.helpers.analytic import analytic_motion

NAMES = ("field", "native", "rotations")
RATES = (60, 30, 120)
# Millimetres off: float32, integration by the trapezoidal rule at 30 fps, float32.
TOLERANCE_MM = {"field": 0.01, "native": 4.0, "rotations": 0.5}


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> mk.Store:
    """One body with rotations at three framerates, and one motion without."""
    path = tmp_path_factory.mktemp("vectors") / "store"
    with mk.StoreWriter.create(path) as writer:
        for index, rate in enumerate(RATES):
            motion = to_motion(analytic_motion("walk", 4.0), Fraction(rate))
            writer.add(replace(motion, sequence_id=f"m{index}", split="train"))
        bare = replace(motion, local_rotations=None, root_translation=None)
        writer.add(replace(bare, sequence_id="bare", split="train"))
    return mk.Store.open(path)


def _opened(store: mk.Store, name: str, *, mirrored: bool = False) -> tuple[PositionCache, WindowPoses]:
    cache, frames = open_frames(training_vectors(name, store, None), store, None)  # type: ignore[arg-type]
    pairs = mk.SMPL22.left_right_pairs if mirrored else None
    return cache, WindowPoses(cut_windows(cache, max_duration_seconds=4.0, mirror_pairs=pairs), frames)


@pytest.mark.parametrize("name", NAMES)
def test_what_is_encoded_comes_back_in_the_window_s_frame(store: mk.Store, name: str) -> None:
    cache, poses = _opened(store, name, mirrored=True)
    windows, vectors = poses.windows, poses.frames.vectors
    assert len(windows) == 2 * (3 if name == "rotations" else 4)
    for row in range(len(windows)):
        count = int(windows.num_frames[row])
        batch = poses.at_frames(np.array([row]), np.arange(count)[None])
        assert batch.vectors.shape == (1, count, vectors.num_features)
        seconds = np.arange(count) / windows.fps[row]
        decoded = vectors.decode(batch.vectors[0], seconds, seconds)
        truth = window_truth(cache, windows, row, windows.exact_fps(row))
        apart = np.linalg.norm(decoded.joint_positions - truth, axis=-1)
        # A body that is not symmetric has no mirror image on its own bones.
        allowed = 14.0 if name == "rotations" and windows.mirrored[row] else TOLERANCE_MM[name]
        assert apart.max() * 1000 < allowed


@pytest.mark.parametrize("name", NAMES)
def test_between_frames_poses_lie_between(store: mk.Store, name: str) -> None:
    cache, poses = _opened(store, name)
    vectors, row = poses.frames.vectors, np.array([0])
    ticks = np.arange(0, 170)[None]
    batch = poses.at_rate(row, ticks, Fraction(45))
    seconds = ticks[0] / 45
    decoded = vectors.decode(batch.vectors[0], seconds, seconds).joint_positions
    start, count = int(poses.windows.start_row[0]), int(poses.windows.num_frames[0])
    native_frames = cache.positions[None, start : start + count]
    world = np.stack(
        [
            [np.interp(seconds, np.arange(native_frames.shape[1]) / 60, native_frames[0, :, j, c]) for c in range(3)]
            for j in range(22)
        ]
    ).transpose(2, 0, 1)
    truth = field.to_window(world[None], poses.windows.yaw[:1], poses.windows.origin[:1])[0]
    assert np.linalg.norm(decoded - truth, axis=-1).max() < 0.004


class TestNative:
    def test_a_mirrored_vector_is_that_of_the_mirrored_motion(self) -> None:
        motion = to_motion(analytic_motion("walk", 4.0), Fraction(60))
        mirrored = mirror_positions(motion.joint_positions, mk.SMPL22.left_right_pairs)
        vectors = native.vectors(motion.joint_positions, "smpl22", motion.fps)
        expected = native.vectors(mirrored, "smpl22", motion.fps)
        mirror = native.NativeVectors().mirror
        np.testing.assert_allclose(mirror(vectors), expected, atol=2e-4)
        np.testing.assert_array_equal(mirror(mirror(vectors)), vectors)

    def test_the_path_is_integrated_over_the_time_stamps(self) -> None:
        motion = to_motion(analytic_motion("walk", 4.0), Fraction(240))
        vectors = native.vectors(motion.joint_positions, "smpl22", motion.fps)
        some = np.sort(np.random.default_rng(1).choice(np.arange(1, len(vectors)), 300, replace=False))
        some = np.concatenate(([0], some))
        uneven = native.positions_at(vectors[some], "smpl22", some / 240)
        even = native.positions_at(vectors, "smpl22", motion.timegrid.seconds())
        # Gaps of up to a tenth of a second cost millimetres; taking them for equal ones would cost decimetres.
        np.testing.assert_allclose(uneven, even[some], atol=8e-3)
        equal = native.positions_at(vectors[some], "smpl22", np.arange(len(vectors[some])) / 75)
        assert np.abs(equal - even[some]).max() > 0.05


class TestRotations:
    def test_a_store_without_rotations_is_reported(self, store: mk.Store) -> None:
        with pytest.raises(mk.UsageError):
            with_rotations(store, "sequence_id = 'bare'")

    def test_rest_poses_that_differ_are_reported(self, tmp_path: Path) -> None:
        motion = to_motion(analytic_motion("walk", 2.0), Fraction(30))
        offsets = motion.skeleton.offsets.copy()
        for elbow in (18, 19):
            offsets[elbow] = (np.linalg.norm(offsets[elbow]) * (1 if elbow == 18 else -1), 0, 0)
        other = replace(motion.skeleton, name="arms-out", offsets=offsets)
        with mk.StoreWriter.create(tmp_path / "store") as writer:
            writer.add(replace(motion, sequence_id="a"))
            writer.add(replace(motion, sequence_id="b", skeleton=other))
        with pytest.raises(mk.UsageError, match="arms-out"):
            training_rig(mk.Store.open(tmp_path / "store"), None)


@pytest.mark.parametrize("name", NAMES)
def test_a_rank_without_a_window_in_the_batch_has_nothing_to_encode(store: mk.Store, name: str) -> None:
    vectors = training_vectors(name, store, None)
    _, frames = open_frames(vectors, store, None)
    nothing = frames.gather(np.zeros((0, 8), np.int64), np.zeros(0, np.bool_))
    between = vectors.between(nothing, nothing, np.zeros((0, 8), np.float32))
    encoded = vectors.encode(between, np.zeros(0, np.float32), np.zeros((0, 2), np.float32))
    assert encoded.shape == (0, 8, vectors.num_features)
