"""A repository with an eval/ folder without __init__.py (as motion-diffusion-model has) works beside motionkit."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.repository import REPOSITORY

FILES = ("eval_humanml.py", "eval_humanact12_uestc.py", "unconstrained/evaluate.py", "a2m/tools.py", "a2m/gru_eval.py")


def test_both_are_importable(tmp_path: Path) -> None:
    for name in FILES:
        path = tmp_path / "eval" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"WHERE = {name!r}\n", encoding="utf-8")
    script = (
        "import eval.eval_humanml, eval.a2m.tools, eval.unconstrained.evaluate\n"
        "import eval.metrics.distributions, eval.clip_fid.score\n"
        "from eval.commands.eval import evaluate\n"
        "from eval.tables.table import reported_figures\n"
        "from eval.report.results import to_html\n"
        "assert len(reported_figures('nerm', '2')) == 20 and to_html([])\n"
        "print(eval.eval_humanml.WHERE, eval.a2m.tools.WHERE, eval.metrics.distributions.__name__)\n"
    )
    for order in ("", "import eval.clip_fid.score\n"):
        done = subprocess.run(
            (sys.executable, "-c", order + script),
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(tmp_path)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout.split() == ["eval_humanml.py", "a2m/tools.py", "eval.metrics.distributions"]


def test_the_command_line_runs_beside_an_eval_package_of_somebodys(tmp_path: Path) -> None:
    (tmp_path / "eval").mkdir()
    (tmp_path / "eval" / "__init__.py").write_text("raise ImportError('this is theirs')\n", encoding="utf-8")
    command = (sys.executable, "-m", "motionkit", "report", "--results", "none")
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("motionkit: there is no result in 'none'"), done.stderr


@pytest.mark.parametrize("name", ["eval.py", "eval/__init__.py"])
def test_a_package_of_somebodys_that_hides_ours_is_reported(tmp_path: Path, name: str) -> None:
    theirs = tmp_path / name
    theirs.parent.mkdir(exist_ok=True)
    theirs.write_text("", encoding="utf-8")
    for command, hidden in (("report", True), ("info", False)):
        done = subprocess.run(
            (sys.executable, "-m", "motionkit", command, "--help"),
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": os.pathsep.join((str(tmp_path), str(REPOSITORY)))},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == int(hidden), done.stderr
        if hidden:
            (line,) = done.stderr.splitlines()
            assert str(theirs) in line and "Leave its folder out of PYTHONPATH" in line
