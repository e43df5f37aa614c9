"""Options of several commands: what they refuse names the option."""

from fractions import Fraction

import pytest

from motionkit.cli.options import parse_rate, read_options
from motionkit.core.errors import UsageError


def test_framerates_are_exact() -> None:
    assert parse_rate("30000/1001") == Fraction(30000, 1001)
    assert parse_rate(None) is None
    with pytest.raises(UsageError, match="--source-fps"):
        parse_rate("30/0", "--source-fps")


@pytest.mark.parametrize("metres", [0.0, -1.0, float("nan"), float("inf")])
def test_a_unit_is_a_positive_length(metres: float) -> None:
    with pytest.raises(UsageError, match="--unit-metres"):
        read_options(None, None, unit_metres=metres)
