"""The suffix of `--out` decides the format of `complete` and `plant`."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import pytest

import motionkit as mk
from tests.helpers.analytic import capture
from tests.helpers.outcome import Outcome

Run = Callable[..., Outcome]


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    capture(Fraction(30), "walk", seconds=2.0).save(tmp_path / "walk.bvh")
    return tmp_path / "walk.bvh"


@pytest.mark.parametrize("command", [("complete", "--fps", "60", "--model", "slerp"), ("plant",)])
@pytest.mark.parametrize("suffix", [".bvh", ".npz", ".csv", ".glb", ".npy"])
def test_the_suffix_of_out_decides_the_format(
    motionkit: Run, walk: Path, command: tuple[str, ...], suffix: str
) -> None:
    name, *options = command
    out = walk.parent / f"made{suffix}"
    outcome = motionkit(name, walk, *options, "--out", out)
    assert outcome.code == 0 and outcome.stdout.split() == [str(out)]
    if suffix == ".glb":  # the rest can be read again
        assert out.read_bytes()[:4] == b"glTF"
    else:
        assert mk.read(out).fps == (60 if name == "complete" else 30)
