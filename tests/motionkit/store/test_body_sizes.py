"""A unit that was taken for another shows in bodies of the same joints that are of sizes no two people have."""

from dataclasses import replace

import numpy as np
import pytest

from motionkit.core.skeleton import KIT21, SMPL22, Skeleton
from motionkit.store.ingest import body_size_warning

MARKERS = replace(SMPL22, offsets=np.zeros_like(SMPL22.offsets))


@pytest.mark.parametrize(
    ("skeleton", "words"),
    [
        (SMPL22, ""),
        (SMPL22.scaled(0.6), ""),
        (SMPL22.scaled(1.4), ""),
        (SMPL22.scaled(2.54), "2.54 times as large as that of skeleton 'smpl22'"),
        (SMPL22.scaled(0.01), "100 times smaller as that of skeleton 'smpl22'"),
        (KIT21, ""),
        (MARKERS, ""),
    ],
)
def test_a_body_beside_the_first_of_its_joints(skeleton: Skeleton, words: str) -> None:
    sizes: dict[tuple[str, ...], tuple[float, str]] = {}
    assert body_size_warning(SMPL22, sizes) == ""
    warning = body_size_warning(skeleton, sizes)
    assert words in warning and bool(warning) == bool(words)


@pytest.mark.parametrize(("factor", "metres"), [(2.0, "2.96"), (0.3, "0.44")])
def test_an_impossible_body(factor: float, metres: str) -> None:
    assert body_size_warning(SMPL22.scaled(factor), {}).startswith(f"its body is {metres}")
