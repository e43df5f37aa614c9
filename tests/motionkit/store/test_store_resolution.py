"""Stored numbers lie on a grid of 2^-22: nearest, idempotent, the same bytes the second time, far below any capture."""

from fractions import Fraction

import numpy as np
import pyarrow.parquet as pq
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.store import Store, StoreWriter
from motionkit.store.schema import RESOLUTION_BITS, rounded

GRID = 2.0**-RESOLUTION_BITS
finite = st.floats(width=32, allow_nan=False, allow_infinity=False)


@given(arrays(np.float32, st.integers(1, 40), elements=finite))
def test_the_nearest_multiple_and_nothing_the_second_time(values):
    found = rounded(values)
    assert (np.abs(found.astype(np.float64) - values) <= GRID / 2).all()
    steps = found.astype(np.float64) / GRID
    np.testing.assert_array_equal(steps, np.rint(steps))
    np.testing.assert_array_equal(rounded(found), found)


def test_two_metres_from_the_origin_float32_has_the_grid_already():
    values = np.nextafter(np.float32(2), np.float32(np.inf), dtype=np.float32) * np.float32([1, 1.37, 512, -1e30])
    np.testing.assert_array_equal(rounded(values), values)
    assert np.spacing(np.float32(2)) == GRID


def smooth(num_frames: int, fps: int) -> Motion:
    time = np.arange(num_frames) / fps
    wave = np.sin(2 * np.pi * 0.5 * time[:, None, None] + np.arange(22 * 3).reshape(22, 3))
    return Motion(wave.astype(np.float32), SMPL22, TimeGrid(Fraction(fps), num_frames), sequence_id="smooth")


def test_a_store_read_and_written_again_has_the_same_bytes(tmp_path):
    with StoreWriter.create(tmp_path / "first") as writer:
        writer.add(smooth(700, 120))
    first = Store.open(tmp_path / "first")
    with StoreWriter.create(tmp_path / "second") as writer:
        for motion in first.read_many(first.select()):
            writer.add(motion)
    assert Store.open(tmp_path / "second").fingerprint == first.fingerprint


def test_jerk_at_250_fps_stays_below_what_float32_itself_adds():
    """The third difference of white rounding noise: √20 · grid / √12 · fps³ = 4.8 m/s³, root mean square."""
    motion = smooth(2000, 250)
    error = rounded(motion.joint_positions).astype(np.float64) - motion.joint_positions
    jerk = np.diff(error, 3, axis=0) * 250**3
    assert np.sqrt(np.mean(jerk**2)) < 6.0
    far = (motion.joint_positions + np.float32(3.0)).astype(np.float64) - (
        motion.joint_positions.astype(np.float64) + 3
    )
    assert np.sqrt(np.mean((np.diff(far, 3, axis=0) * 250**3) ** 2)) > 4.0


def test_the_part_says_its_units_and_resolution(small_store):
    field = pq.read_schema(small_store / "segments" / "part-00000.parquet").field("joint_positions")
    assert field.metadata[b"unit"] == b"metre"
    assert field.metadata[b"resolution"] == b"2^-22"
