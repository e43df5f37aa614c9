"""docs/howto/captures.md, from a folder of takes to a table: its own commands at tiny sizes, and what comes next."""

import re
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import pytest

import motionkit as mk
from benchmarks.trust.scenarios import SETTINGS
from motionkit.fields.motion_field import to_motion
from tests.helpers.analytic import analytic_motion
from tests.helpers.pages import blocks, run_blocks
from tests.helpers.repository import REPOSITORY

PAGE = REPOSITORY / "docs" / "howto" / "captures.md"
ACTIONS = {"walk": "walk", "jump": "run", "wave": "wave", "squat": "squat", "bow": "bow"}
SMALL = {"eval": "--fps 20,60 --clips 64 --replications 2 --motions 4", "generate": "-n 1 --seconds 1"}


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    """Five takes as BVH, named as files and nothing else."""
    for seed, (name, action) in enumerate(ACTIONS.items()):
        motion = to_motion(analytic_motion(action, 3.0, seed), Fraction(60))
        mk.write(replace(motion, captions=()), tmp_path / "takes" / f"{name}.bvh")
    return tmp_path / "takes"


def at_tiny_sizes(words: list[str]) -> list[str]:
    tiny = f"{SETTINGS['codebook']} {SETTINGS['evaluator']}".split() if words[0] == "train" else ()
    return [*words, *(part for each in tiny for part in ("--set", each)), *SMALL.get(words[0], "").split()]


def test_takes_without_captions_and_then_with(motionkit, takes, monkeypatch):
    monkeypatch.chdir(takes.parent)
    said = []

    def run(words):
        outcome = motionkit(*at_tiny_sizes(words))
        assert outcome.code == 0, (words, outcome.stderr)
        said.append((words[0], outcome.stdout))

    without, with_captions = (block for block in blocks(PAGE) if block.language == "bash")
    run_blocks([without], PAGE, run)
    follows = [re.findall(r"^next: motionkit (\w+)", text, re.MULTILINE) for _, text in said]
    names = [name for name, _ in said]
    assert names == ["ingest", "info", "split", "train", "eval", "generate", "view", "report"]
    assert follows == [["split"], [], ["train"], ["eval"], [], [], [], []]
    assert "real, disjoint halves" in said[4][1]
    assert len(list(Path("made").glob("*.bvh"))) == 1
    page = Path("results/report.html").read_text(encoding="utf-8")
    assert "Run nano" in page and page.count("<iframe ") == 2 and "real motion" in page
    assert page.count('<img class="figure"') == 2, "the training and the table"
    said.clear()
    run_blocks([with_captions], PAGE, run)
    assert [re.findall("next: motionkit (.*)", text) for _, text in said] == [["split"], ["train"]]
    sequences = mk.Store.open("store").sequences
    assert set(sequences.groupby("subject")["split"].nunique()) == {1} and set(sequences["captions"].map(len)) == {1}


def test_readme_has_the_same_commands():
    readme = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    block = re.search(r"Five takes as BVH.*?```\n(.*?)```", readme, re.DOTALL)
    assert block is not None
    lines = [line.partition("#")[0].strip() for line in block[1].splitlines()]
    page = blocks(PAGE)[0].text.splitlines()
    assert len(lines) == 4 and [line for line in page if line in lines] == lines
