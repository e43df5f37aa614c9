"""The page about motion fields: what it shows runs, on a file with a skeleton of its own."""

import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motionkit.fields.interpolation import INTERPOLATORS
from motionkit.fields.motion_field import to_motion
from motionkit.io.bvh_writing import write_bvh
from tests.helpers.analytic import analytic_motion
from tests.helpers.repository import REPOSITORY

PAGE = REPOSITORY / "docs" / "motion-fields.md"


def test_its_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    field = analytic_motion("walk", 3.0)
    write_bvh(to_motion(field, Fraction(30)), Path("walk.bvh"))
    names: dict[str, Any] = {}
    for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL):
        exec(code, names)
    assert names["smooth"].fps == 120 and names["film"].fps == Fraction(24000, 1001)
    assert names["longer"].num_frames == names["motion"].num_frames + 15
    assert names["filled"].local_rotations is not None
    # A BVH file lists joints depth first.
    order = [field.skeleton.index(name) for name in names["motion"].skeleton.joint_names]
    truth = field.query(np.array([1.5, 0.25, 0.75])).joint_positions[:, order]
    assert np.abs(names["poses"].joint_positions - truth).max() < 0.01


def test_it_lists_every_interpolator() -> None:
    listed = re.findall(r"^\| `([a-z-]+)` \| .*\| .*\|$", PAGE.read_text(), re.MULTILINE)
    assert set(INTERPOLATORS) <= set(listed)
