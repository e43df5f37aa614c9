"""Handing a value from one process to another: nothing changes on the way."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from motionkit.workers.parcel import pack, unpack

FLOATS = arrays.arrays(np.float32, arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4))
BYTES = arrays.arrays(np.uint8, st.integers(0, 70))


@given(st.lists(st.tuples(st.text(max_size=3), FLOATS | BYTES), max_size=4), st.integers(0, 400) | st.none())
@settings(max_examples=100)
def test_a_value_comes_back_whatever_the_size_of_the_memory(value: list[object], size: int | None) -> None:
    memory = None if size is None else memoryview(bytearray(size))
    there = unpack(pack(value, memory), memory)
    assert repr(there) == repr(value)


def test_arrays_travel_in_the_memory_and_stay_there() -> None:
    memory = memoryview(bytearray(10_000))
    sent = pack({"frames": np.arange(1000.0), "turned": np.arange(6.0).reshape(2, 3).T}, memory)
    assert len(sent.message) < 1000
    value = unpack(sent, memory)
    assert np.array_equal(value["frames"], np.arange(1000.0))
    assert value["turned"].tolist() == [[0.0, 3.0], [1.0, 4.0], [2.0, 5.0]]
    memory[:] = bytes(10_000)
    assert not value["frames"].any() and not value["turned"].any()


@pytest.mark.parametrize("size", [0, 63, 64, 127])
def test_what_does_not_fit_travels_in_the_message(size: int) -> None:
    memory = memoryview(bytearray(size))
    sent = pack([np.arange(9.0), np.arange(2.0)], memory)
    assert sent.sizes == ()
    assert [array.tolist() for array in unpack(sent, memory)] == [list(range(9)), [0.0, 1.0]]
