"""kinematic/1 is frozen: a fixed clip's 65 numbers, and those of a fixed fit, to 1e-9.

A failure here means that the descriptor's meaning changed. That is allowed only with another `VERSION`, for scores of
two versions don't compare: raise it, say in docs/metrics.md what changed, and write the numbers anew with

    python tests/eval/clip_fid/test_kinematic_version_1.py
"""

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from eval.clip_fid import kinematic1

GOLDEN = Path(__file__).with_name("kinematic_version_1.json")
FPS = Fraction(60)


def figure(index: int, num_poses: int) -> np.ndarray:
    """A body of 22 joints in closed form (no random numbers): it swings, walks along +X, and plants one foot."""
    joint = np.arange(22)[None, :]
    seconds = np.arange(num_poses)[:, None] / float(FPS)
    phase = 0.7 * joint + 1.3 * index
    x = 0.2 * np.cos(1.9 * joint) + 0.05 * np.sin((4 + joint % 5) * seconds + phase) + (0.8 + 0.1 * index) * seconds
    y = 0.9 + 0.4 * np.sin(2.3 * joint) + 0.03 * np.sin((7 + joint % 3) * seconds + 2 * phase)
    z = 0.2 * np.sin(1.9 * joint) + 0.02 * np.cos((23 + index) * seconds + phase)
    positions = np.stack((x, y, z), axis=-1)
    positions[:, [7, 10]] = positions[:1, [7, 10]] + 0.01 * (1 + index) * seconds[:, :, None] * [1.0, 0.0, 0.5]
    return positions


def numbers() -> dict[str, list[float]]:
    """Raw numbers of one clip of 32 poses on plain axes, and standardised ones after a fit on 24 clips."""
    clips = [np.stack([figure(index, size) for index in range(12)]) for size in (16, 40)]
    raw = kinematic1._raw_features(figure(3, 32)[None], FPS, np.zeros(63), np.eye(10, 63))[0]
    fitted = kinematic1.fit_kinematic(clips, FPS)
    return {"raw": raw.tolist(), "standardised": fitted.describe(figure(20, 32)[None], FPS)[0].tolist()}


def test_a_change_of_the_descriptor_needs_another_version() -> None:
    golden = json.loads(GOLDEN.read_text(encoding="utf-8"))
    assert golden.pop("version") == kinematic1.VERSION, "another version needs golden numbers of its own"
    found = numbers()
    assert found.keys() == golden.keys()
    for name, expected in golden.items():
        assert len(expected) == kinematic1.NUM_FEATURES
        assert found[name] == pytest.approx(expected, rel=1e-9, abs=1e-9), f"{name}: raise kinematic1.VERSION"


def test_every_number_depends_on_the_clip() -> None:
    """None of the 65 sits on a floor where a changed formula would go unnoticed."""
    both = [kinematic1._raw_features(figure(k, 32)[None], FPS, np.zeros(63), np.eye(10, 63))[0] for k in (3, 4)]
    assert (np.abs(both[1] - both[0]) > 1e-6).all()


if __name__ == "__main__":
    GOLDEN.write_text(json.dumps({"version": kinematic1.VERSION} | numbers(), indent=1) + "\n", encoding="utf-8")
