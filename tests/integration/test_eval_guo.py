"""`motionkit eval --evaluator guo` with files in the published layout, of narrow networks with random weights."""

import json
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motionkit.core.motion import Caption, Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import rest_positions
from motionkit.core.timegrid import TimeGrid
from motionkit.store.writer import StoreWriter
from tests.helpers.published_guo import GuoWidths, write_archive, write_glove

SMALL = GuoWidths(movement=6, motion=5, text=4, shared=8)
CLIPS = ("--clips", 64, "--replications", 1, "--sizes", "16:16")


def swaying(seed: int, num_frames: int, fps: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    time = np.arange(num_frames)[:, None, None] / fps
    sway = 0.1 * np.sin(2 * np.pi * rng.uniform(0.3, 2, (22, 3)) * time + rng.uniform(0, 6, (22, 3)))
    return (rest_positions(SMPL22) + sway + [0, 0.95, 0]).astype(np.float32)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("guo") / "store"
    with StoreWriter.create(path) as writer:
        for index in range(8):
            grid = TimeGrid(Fraction(40), 160)
            positions, split = swaying(index, 160, 40), ("train", "test")[index % 2]
            writer.add(
                Motion(joint_positions=positions, skeleton=SMPL22, timegrid=grid, split=split, sequence_id=f"m{index}")
            )
    return path


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_archive(tmp_path_factory.mktemp("published") / "t2m", SMALL)


def block(outcome: Any, title: str = "") -> dict[str, Any]:
    blocks = [each for each in json.loads(outcome.stdout)["blocks"] if "differences" not in each["title"]]
    found = [each for each in blocks if "guo" in each["title"] and title in each["title"]]
    assert len(found) == 1
    return dict(found[0])


def test_a_column_at_20_fps_and_none_elsewhere(
    motionkit: Callable[..., Any], store: Path, weights: Path, tmp_path: Path
) -> None:
    table = ("eval", "--table", 2, "--store", store, "--results", tmp_path, "--evaluator", "guo", "--weights", weights)
    outcome = motionkit(*table, *CLIPS, "--fps", "20,40", "--json")
    assert outcome.code == 0, outcome.stderr
    found = block(outcome)
    assert found["title"] == "clip-FID on the guo evaluator of HumanML3D"
    for row in found["rows"]:
        assert list(row["cells"]) == ["20 fps"] and row["cells"]["20 fps"]["value"] >= 0
    assert {"real, independent draws (P1)", "real kept at 20 fps, SLERP"} <= {row["name"] for row in found["rows"]}
    missing = json.loads(outcome.stdout)["missing"]
    assert any("40 fps, guo" in line and "was trained at 20 fps" in line for line in missing)


@pytest.fixture(scope="module")
def captioned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("guo") / "captioned"
    with StoreWriter.create(path) as writer:
        for index in range(68):
            split, grid = ("test", "val")[index // 34], TimeGrid(Fraction(20), 44 + index % 34)
            tokens = ("a/DET man/NOUN walk/VERB", "a/DET person/NOUN turn/VERB left/ADV")[index % 2]
            writer.add(
                Motion(
                    joint_positions=swaying(index, grid.num_frames, 20),
                    skeleton=SMPL22,
                    timegrid=grid,
                    captions=(Caption(f"take {index}", tokens=tokens if split == "test" else ""),),
                    split=split,
                    sequence_id=f"c{index}",
                )
            )
    return path


def test_table_1_by_the_published_evaluator(
    motionkit: Callable[..., Any], captioned: Path, weights: Path, tmp_path: Path
) -> None:
    glove = write_glove(tmp_path / "glove")
    table = ("eval", "--table", 1, "--results", tmp_path, "--protocol", "t2m", "--evaluator", "guo", "--json")
    files = ("--weights", weights, "--glove", glove)
    found = motionkit(*table, *files, "--store", captioned)
    assert found.code == 0, found.stderr
    without = motionkit(*table, "--weights", weights, "--store", captioned)
    assert without.code == 2 and "--glove DIR" in without.stderr
    without = motionkit(*table, *files, "--store", captioned, "--split", "val")
    assert without.code == 1 and "caption 'take 34' has no word/POS tokens" in " ".join(without.stderr.split())
