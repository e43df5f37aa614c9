"""`motionkit eval --table physical`, driven as a person would, with a folder of samples."""

import json
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.core.motion import Motion
from motionkit.fields.motion_field import to_motion
from motionkit.store.writer import StoreWriter
from tests.helpers.analytic import analytic_motion


def walk(seed: int) -> Motion:
    return to_motion(analytic_motion("walk", 4.0, seed), Fraction(30))


def test_from_the_command_line_with_samples(tmp_path: Path, motionkit) -> None:
    store, folder = tmp_path / "store", tmp_path / "frozen"
    performances = [walk(seed) for seed in range(4)]
    with StoreWriter.create(store) as writer:
        for seed, motion in enumerate(performances):
            of_take = (motion.joint_positions, motion.skeleton, motion.timegrid)
            writer.add(Motion(*of_take, split="test", sequence_id=f"take-{seed}"))
    folder.mkdir()
    for seed in range(2):
        np.save(folder / f"{seed}.npy", np.repeat(performances[seed].joint_positions[:1], 60, axis=0))
    arguments = ("--store", store, "--results", tmp_path / "results", "--samples", f"frozen={folder}", "--json")
    done = motionkit("eval", "--table", "physical", "--samples-fps", 20, "--fps", 20, *arguments)
    assert done.code == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["task"] == "physical" and len(result["blocks"]) == 4
    frozen = next(row for row in result["blocks"][0]["rows"] if row["name"] == "frozen")
    assert frozen["note"] == "2 takes, 2 motions, 6 s"
    assert frozen["cells"]["Skating speed"]["value"] == 0.0
    assert frozen["cells"]["Time on the ground"]["value"] == 1.0
    text = (tmp_path / "results" / "physical.md").read_text(encoding="utf-8")
    assert "| frozen | 0" in text and "GMD skating ratio: lower is better" in text
