"""Settings by KEY=VALUE and back; the precision of a processor; rows dealt to ranks."""

import dataclasses
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from motionkit.core.errors import UsageError
from motionkit.training import networks
from motionkit.training.config import Precision, apply_overrides, flatten, from_plain, setting_text, to_plain
from motionkit.training.networks import DealtRows, Ranks, autocast, with_precision_of


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


CPU = torch.device("cpu")


@dataclass(frozen=True)
class Settings:
    precision: Precision = "auto"
    steps: int = 3


@pytest.mark.parametrize(("found", "chosen"), [(True, "bfloat16"), (False, "float32")])
def test_auto_is_bfloat16_only_where_the_processor_has_it(found, chosen, monkeypatch):
    monkeypatch.setattr(networks, "has_bfloat16", lambda device: found)
    settings = with_precision_of(Settings(), CPU)
    assert settings == Settings(chosen)  # type: ignore[arg-type]
    assert with_precision_of(Settings("float32"), CPU).precision == "float32"
    with autocast("auto", CPU):
        assert (torch.ones(2, 2) @ torch.ones(2, 2)).dtype == getattr(torch, chosen)


@given(st.integers(1, 9), st.integers(0, 50))
def test_parts_are_all_rows_once(size: int, more: int) -> None:
    count = size + more
    parts = [Ranks(rank, size).rows_of(count) for rank in range(size)]
    assert [row for part in parts for row in range(count)[part]] == list(range(count))
    lengths = [len(range(count)[part]) for part in parts]
    assert max(lengths) - min(lengths) <= 1


@given(st.integers(1, 5), st.lists(st.floats(0.5, 10.0), min_size=1, max_size=40), st.randoms())
def test_rows_are_dealt_once_each_and_in_balance(size: int, weights: list[float], random: np.random.Generator) -> None:
    order = np.arange(len(weights))
    random.shuffle(order)
    weight = np.array(weights)
    dealt = [DealtRows(Ranks(rank, size), weight, order) for rank in range(size)]
    rows = torch.cat([each.rows for each in dealt])
    assert sorted(rows.tolist()) == list(range(len(weights)))
    # A rank's rows are neighbours in the given order, and its weight is its share but for a row at either end.
    place = np.argsort(order)
    for each in dealt:
        places = np.sort(place[each.rows.numpy()])
        assert len(places) == 0 or places[-1] - places[0] == len(places) - 1
        assert abs(weight[each.rows.numpy()].sum() - weight.sum() / size) <= weight.max() + 1e-9
