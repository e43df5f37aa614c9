"""Partial results: values, and why others are missing."""

import pytest

from eval.sets.partial import collect
from motionkit.core.errors import MotionkitError


def half(number: int) -> int:
    if number % 2:
        raise MotionkitError(f"{number} is odd")
    if number < 0:
        raise ValueError("negative")
    return number // 2


def test_what_is_refused_is_missing_under_its_label() -> None:
    found = collect((4, 3, 2, 5), half, "number {}".format)
    assert found.value == {4: 2, 2: 1}
    assert found.missing == ("number 3: 3 is odd", "number 5: 5 is odd")


def test_other_errors_go_through_unless_they_are_named() -> None:
    with pytest.raises(ValueError, match="negative"):
        collect((-2,), half)
    assert collect((-2,), half, errors=(ValueError,)).missing == ("-2: negative",)
