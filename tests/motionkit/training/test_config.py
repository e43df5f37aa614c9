import dataclasses
from dataclasses import dataclass, field
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motionkit.core.errors import UsageError
from motionkit.training.config import apply_overrides, flatten, from_plain, setting_text, to_plain


@dataclass(frozen=True)
class Inner:
    steps: int = 10
    rate: float = 1e-3
    activation: Literal["relu", "silu"] = "silu"
    widths: tuple[int, ...] = (1, 2)
    limit: float | None = None


@dataclass(frozen=True)
class Outer:
    name: str = "x"
    fast: bool = False
    field: Inner = field(default_factory=Inner)


def test_overrides_reach_nested_settings_by_their_types() -> None:
    changed = apply_overrides(
        Outer(), ["field.steps=7", "field.rate=2", "field.widths=3,4,5", "fast=true", "field.limit=0.5", "name=a=b"]
    )
    assert changed == Outer("a=b", True, Inner(7, 2.0, "silu", (3, 4, 5), 0.5))
    assert apply_overrides(changed, ["field.limit=none"]).field.limit is None


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("field.step=1", r"no setting is called 'field.step', perhaps field.steps; there are: name, fast, field.steps"),
        ("field.steps=many", r"field.steps must be a whole number, not 'many'"),
        ("field.limit=inf", r"field.limit must be a number, not 'inf'"),
        ("field.activation=gelu", r"field.activation must be one of relu, silu"),
        ("fast=1", r"fast must be true or false"),
        ("fast", r"KEY=VALUE"),
    ],
)
def test_a_wrong_override_is_refused_with_what_there_is(override: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        apply_overrides(Outer(), [override])


def outers(texts: st.SearchStrategy[str], floats: st.SearchStrategy[float]) -> st.SearchStrategy[Outer]:
    widths = st.lists(st.integers(0, 9)).map(tuple)
    inner = st.builds(
        Inner, st.integers(-(2**40), 2**40), floats, st.sampled_from(["relu", "silu"]), widths, st.none() | floats
    )
    return st.builds(Outer, texts, st.booleans(), inner)


@given(outers(st.text(), st.floats(allow_nan=False)))
def test_plain_values_round_trip(config: Outer) -> None:
    assert from_plain(Outer, to_plain(config)) == config


@given(outers(st.text("abc_./ ", min_size=1).map(str.strip), st.floats(allow_nan=False, allow_infinity=False)))
def test_settings_given_are_set(config: Outer) -> None:
    settings = [f"{key}={setting_text(value)}" for key, value in flatten(config).items()]
    assert apply_overrides(Outer(), settings) == config


def test_a_value_that_the_dataclass_itself_refuses_is_a_usage_error() -> None:
    @dataclass(frozen=True)
    class Positive:
        steps: int = 1

        def __post_init__(self) -> None:
            if self.steps < 1:
                raise ValueError("steps must be positive")

    with pytest.raises(UsageError, match="steps=-1: steps must be positive"):
        apply_overrides(Positive(), ["steps=-1"])
    assert dataclasses.astuple(apply_overrides(Positive(), ["steps=4"])) == (4,)
