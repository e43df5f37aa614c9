"""The how-tos of the documentation, run from an empty folder with small files of the kinds that they are about."""

import re
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from benchmarks.trust.scenarios import SETTINGS
from motionkit.demo_corpus import read_demo_corpus
from motionkit.fields.motion_field import to_motion
from tests.helpers import published_layouts
from tests.helpers.analytic import ACTIONS, analytic_motion
from tests.helpers.humanml3d_checkout import write_amass_tree, write_checkout
from tests.helpers.outcome import Outcome
from tests.helpers.pages import COMMAND, blocks, run_blocks, run_page, unmarked
from tests.helpers.repository import REPOSITORY
from tests.helpers.seed_samples import G1_STANDS, seed_row, soma_bvh, soma_motion, write_seed

DOCS = REPOSITORY / "docs"
HOWTOS = sorted((DOCS / "howto").glob("*.md"))
# At the sizes of a test.
SMALL = {"eval": "--fps 20,60 --clips 64 --replications 1 --motions 4"}


@pytest.fixture
def run(motionkit: Callable[..., Outcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """`run("engines")`: the blocks of a how-to, in an empty folder; every command has to succeed."""
    monkeypatch.chdir(tmp_path)

    def command(words: list[str]) -> None:
        outcome = motionkit(*words, *SMALL.get(words[0], "").split())
        assert outcome.code == 0, (words, outcome.stderr)

    def of_page(name: str) -> None:
        run_page(DOCS / "howto" / f"{name}.md", command)

    return of_page


def write_store(folder: Path, splits: tuple[str, ...] = ("train", "test")) -> None:
    """A store of walks and other actions at 60 fps."""
    with mk.StoreWriter.create(folder) as writer:
        for number in range(8):
            action = "walk" if number % 2 else list(ACTIONS)[number % len(ACTIONS)]
            motion = to_motion(analytic_motion(action, 2.5, number), Fraction(60))
            split = splits[number % 3 == 0]
            writer.add(replace(motion, sequence_id=f"takes/{number}", action=action, split=split))


def test_humanml3d(run, tmp_path):
    write_amass_tree(tmp_path / "AMASS")
    write_checkout(tmp_path / "HumanML3D")
    run("humanml3d")
    native, published = (mk.Store.open(tmp_path / name) for name in ("store", "published"))
    assert native["humanml3d/000000"].fps == 100 and published["humanml3d-20fps/000000"].fps == 20
    assert len(native) == 2 * len(published) > 0
    assert len(list((tmp_path / "HumanML3D-again" / "new_joint_vecs").glob("*.npy"))) > 0


def test_seed(run, tmp_path):
    rows = [seed_row(name, split=split) for name, split in (("a", "train"), ("a_M", "train"), ("b", "test_content"))]
    write_seed(tmp_path / "SEED", rows, {"a": [{"start_time": 0.0, "end_time": 0.1, "description": "A step."}]})
    (tmp_path / "SEED" / "splits").rename(tmp_path / "splits")
    for row in rows:
        for column, text in (("move_soma_uniform_path", soma_bvh(*soma_motion()[:2])), ("move_g1_path", G1_STANDS)):
            path = tmp_path / "SEED" / str(row[column])
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
    run("seed")
    store, robot = (mk.Store.open(tmp_path / name) for name in ("store", "robot"))
    assert list(store) == ["seed/a", "seed/a_M", "seed/b"] and list(robot) == ["seed/a", "seed/b"]
    assert store["seed/a"].fps == 120 and store["seed/b"].split == "test"


def test_evaluate(run, tmp_path):
    write_store(tmp_path / "store")
    published_layouts.write_mdm(tmp_path / "mdm")
    published_layouts.write_mld_demo(tmp_path / "mld")
    published_layouts.write_t2m_gpt(tmp_path / "t2m-gpt")
    momask = published_layouts.write_momask(tmp_path / "momask")
    (momask / "prompts.txt").rename(tmp_path / "text_prompt.txt")
    (momask / "samples.toml").unlink()
    (tmp_path / "kimodo").mkdir()
    for number, joints in enumerate(published_layouts.motions(fps=Fraction(30))):
        np.savez(tmp_path / "kimodo" / f"{number}.npz", posed_joints=joints)
    np.save(tmp_path / "joints.npy", published_layouts.motions()[0])
    run("evaluate")
    table = (tmp_path / "results" / "nerm-table2.md").read_text()
    rows = [line for line in table.splitlines() if line.startswith("| ")]
    for name in ("MDM", "MLD", "T2M-GPT", "MoMask", "Kimodo"):
        assert any(row.startswith(f"| {name}, planted |") for row in rows), table
    assert mk.read(tmp_path / "mine" / "0001.npz").fps == 60


def test_convert(run, tmp_path):
    (walk, character) = read_demo_corpus(["07_01", "49_13"])
    mk.write(walk, tmp_path / "walk.bvh")
    mk.write(walk, tmp_path / "takes" / "walk.npz")
    mk.write(character, tmp_path / "character.glb")
    run("convert")
    assert mk.read(tmp_path / "walk60.bvh").fps == 60 and (tmp_path / "hero.glb").exists()
    assert mk.read(tmp_path / "bvh" / "walk.bvh").num_frames == walk.num_frames


def test_engines(run, tmp_path):
    write_store(tmp_path / "store")
    run("engines")
    for kind in ("glb", "bvh"):
        assert len(list((tmp_path / kind).rglob(f"*.{kind}"))) == 8


def test_character(run, tmp_path):
    write_store(tmp_path / "store")
    (hero,) = read_demo_corpus(["49_13"])
    mk.write(hero, tmp_path / "hero.bvh")
    run("character")
    (first, *_), hero = sorted((tmp_path / "out").rglob("*.bvh")), mk.read(tmp_path / "hero.bvh")
    made = mk.read(first)
    assert made.fps == 60 and made.skeleton.joint_names == hero.skeleton.joint_names
    np.testing.assert_allclose(made.skeleton.offsets[1:], hero.skeleton.offsets[1:], atol=1e-4)
    assert (tmp_path / "on-hero.html").exists()


@pytest.mark.parametrize("page", [*HOWTOS, DOCS / "tutorial.md"], ids=lambda page: page.stem)
def test_blocks_that_are_not_run_say_why(page: Path) -> None:
    assert unmarked(page) == []


def test_a_block_that_is_not_run_is_noticed(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("text\n\n```\nmotionkit info\n```\n\n<!-- not run: hours -->\n\n```\nmotionkit train\n```\n")
    assert [block.text for block in unmarked(page)] == ["motionkit info\n"]
    assert [block.why for block in blocks(page)] == ["", "hours"] and COMMAND.search(blocks(page)[1].text)


PAGE = REPOSITORY / "docs" / "howto" / "captures.md"
TAKES = {"walk": "walk", "jump": "run", "wave": "wave", "squat": "squat", "bow": "bow"}
CAPTURES_SMALL = {"eval": "--fps 20,60 --clips 64 --replications 2 --motions 4", "generate": "-n 1 --seconds 1"}


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    """Five takes as BVH, named as files and nothing else."""
    for seed, (name, action) in enumerate(TAKES.items()):
        motion = to_motion(analytic_motion(action, 3.0, seed), Fraction(60))
        mk.write(replace(motion, captions=()), tmp_path / "takes" / f"{name}.bvh")
    return tmp_path / "takes"


def at_tiny_sizes(words: list[str]) -> list[str]:
    tiny = f"{SETTINGS['codebook']} {SETTINGS['evaluator']}".split() if words[0] == "train" else ()
    return [*words, *(part for each in tiny for part in ("--set", each)), *CAPTURES_SMALL.get(words[0], "").split()]


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
