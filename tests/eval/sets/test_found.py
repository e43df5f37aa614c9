"""What could be had, beside why the rest could not."""

import pytest

from eval.sets.found import each_found
from motionkit.core.errors import MotionkitError


def half(number: int) -> int:
    if number % 2:
        raise MotionkitError(f"{number} is odd")
    if number < 0:
        raise ValueError("negative")
    return number // 2


def test_what_is_refused_is_missing_under_its_label() -> None:
    found = each_found((4, 3, 2, 5), half, "number {}".format)
    assert found.value == {4: 2, 2: 1}
    assert found.missing == ("number 3: 3 is odd", "number 5: 5 is odd")


def test_other_errors_go_through_unless_they_are_named() -> None:
    with pytest.raises(ValueError, match="negative"):
        each_found((-2,), half)
    assert each_found((-2,), half, refusals=(ValueError,)).missing == ("-2: negative",)
