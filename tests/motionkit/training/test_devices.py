from dataclasses import dataclass

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from motionkit.training import loop
from motionkit.training.config import Precision
from motionkit.training.loop import (
    DealtRows,
    Ranks,
    autocast,
    with_precision_of,
)

CPU = torch.device("cpu")


@dataclass(frozen=True)
class Settings:
    precision: Precision = "auto"
    steps: int = 3


@pytest.mark.parametrize(("found", "chosen"), [(True, "bfloat16"), (False, "float32")])
def test_auto_is_bfloat16_only_where_the_processor_has_it(
    found: bool, chosen: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop, "has_bfloat16", lambda device: found)
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
