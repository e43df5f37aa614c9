"""`motionkit eval --table 3` by the command line: real motion, another system's samples, and what is told of faults."""

import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.store.writer import StoreWriter
from tests.helpers.acting import ACTIONS, acted

FPS = Fraction(30)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("actions") / "store"
    with StoreWriter.create(path) as writer:
        for seed in range(72):
            action, frames = ACTIONS[seed % 3], 45 + 10 * (seed % 4)
            motion = Motion(acted(action, seed, frames, 30.0), SMPL22, TimeGrid(FPS, frames), action=action)
            writer.add(replace(motion, split=("train", "test")[seed // 3 % 2], sequence_id=f"{seed:03d}"))
    return path


def write_samples(folder: Path, *, right: bool) -> Path:
    """Nine motions for each action; a system that is not right does another than it was asked for."""
    folder.mkdir()
    lines = ["file,action"]
    for index in range(27):
        asked, done = ACTIONS[index % 3], ACTIONS[(index + (not right)) % 3]
        np.save(folder / f"{index:02d}.npy", acted(done, 500 + index, 60, 30.0))
        lines.append(f"{index:02d}.npy,{asked}")
    (folder / "actions.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "samples.toml").write_text("fps = 30\n", encoding="utf-8")
    return folder


def test_systems_are_distinguished_by_accuracy(motionkit: Callable[..., Any], store: Path, tmp_path: Path) -> None:
    folders = {name: write_samples(tmp_path / name, right=name == "right") for name in ("right", "wrong")}
    samples = [part for name, folder in folders.items() for part in ("--samples", f"{name}={folder}")]
    table = ("eval", "--table", 3, "--store", store, "--results", tmp_path / "results", "--runs", tmp_path)
    outcome = motionkit(*table, *samples, "--protocol", "native,actor", "--json")
    assert outcome.code == 0, outcome.stderr
    result = json.loads(outcome.stdout)
    written = json.loads((tmp_path / "results" / "nerm-table3.json").read_text(encoding="utf-8"))
    assert result["blocks"] == written["blocks"]
    scored = [block for block in result["blocks"] if "differences" not in block["title"]]
    for block in scored[:2]:
        cells = {row["name"]: row["cells"] for row in block["rows"]}
        assert cells["real (test)"]["Accuracy"]["value"] > 0.9 and cells["right"]["Accuracy"]["value"] > 0.9
        assert cells["wrong"]["Accuracy"]["value"] < 0.1
    # Every action is there, under another's name: FID does not see it.
    assert cells["wrong"]["FID (test)"]["value"] == pytest.approx(cells["right"]["FID (test)"]["value"], rel=0.5, abs=1)
    variance = cells["right"]["Diversity"]["details"]['1.96 · variance (ACTOR\'s "±")']
    assert variance > 0
    text = (tmp_path / "results" / "nerm-table3.md").read_text(encoding="utf-8")
    assert "| wrong |" in text and "is not an interval" in text
    assert any("NeRM: there is no run" in line for line in result["missing"])


def test_samples_without_actions_cost_the_exit_code(motionkit: Callable[..., Any], store: Path, tmp_path: Path) -> None:
    folder = write_samples(tmp_path / "mine", right=True)
    (folder / "actions.csv").unlink()
    table = ("eval", "--table", 3, "--store", store, "--results", tmp_path / "results", "--runs", tmp_path)
    outcome = motionkit(*table, "--samples", f"mine={folder}")
    assert outcome.code == 1 and "| real (test) |" in outcome.stdout
    told = " ".join(outcome.stderr.split())
    assert "no row for mine: --samples mine: 27 of 27 motions have no action, the first is '00'" in told
    outcome = motionkit(*table, "--evaluator", "humanact12", "--weights", folder / "00.npy")
    assert outcome.code == 1 and "00.npy" in outcome.stderr and len(outcome.stderr.strip().splitlines()) == 1
