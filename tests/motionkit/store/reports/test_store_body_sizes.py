"""A unit that was taken for another shows in bodies of the same joints that are of sizes no two people have."""

from dataclasses import replace

import numpy as np
import pytest

from motionkit.core.skeleton import KIT21, SMPL22
from motionkit.store.reports.summary import BodySizes


@pytest.mark.parametrize("factor", [1.0, 0.6, 1.4])
def test_people_of_all_sizes(factor: float) -> None:
    assert BodySizes([SMPL22]).warning_of(SMPL22.scaled(factor)) == ""


@pytest.mark.parametrize(("factor", "words"), [(2.54, "2.54 times as large"), (0.01, "100 times smaller")])
def test_an_inch_for_a_centimetre_and_a_centimetre_for_a_metre(factor: float, words: str) -> None:
    sizes = BodySizes([SMPL22])
    assert f"{words} as that of skeleton 'smpl22'" in sizes.warning_of(replace(SMPL22.scaled(factor), name="other"))
    assert sizes.warning_of(SMPL22) == ""


def test_other_joints_and_markers_are_not_compared() -> None:
    sizes = BodySizes([SMPL22])
    assert sizes.warning_of(KIT21) == ""
    markers = replace(SMPL22, offsets=np.zeros_like(SMPL22.offsets))
    assert sizes.warning_of(markers) == "" and BodySizes([markers]).warning_of(SMPL22) == ""


@pytest.mark.parametrize(("factor", "size"), [(2.0, "2.96"), (0.3, "0.44")])
def test_an_impossible_body_is_reported(factor: float, size: str) -> None:
    told = BodySizes([]).warning_of(SMPL22.scaled(factor))
    assert told.startswith(f"its body is {size}") and "from ankle to head: is that its unit?" in told
