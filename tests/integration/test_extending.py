"""The package of docs/extending.md, installed and run as it is printed there."""

import json
import os
import re
import subprocess
import sys
import tomllib
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.store import StoreWriter
from tests.helpers.repository import REPOSITORY

PAGE = REPOSITORY / "docs" / "extending.md"
NAMED_BLOCK = re.compile(r"^```\w+\n# (?P<path>[\w/]+\.(?:py|toml))\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
APP = "from motionkit.cli.app import main; main()"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for sys.path that holds the package and the metadata that an installer would write."""
    folder = tmp_path_factory.mktemp("site")
    files = {found["path"]: found["text"] for found in NAMED_BLOCK.finditer(PAGE.read_text(encoding="utf-8"))}
    project = tomllib.loads(files.pop("pyproject.toml"))["project"]
    for path, text in files.items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")
    (folder / "standstill" / "__init__.py").touch()
    metadata = folder / f"{project['name']}-{project['version']}.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n", encoding="utf-8"
    )
    groups = (
        "\n".join((f"[{group}]", *(f"{name} = {value}" for name, value in entries.items())))
        for group, entries in project["entry-points"].items()
    )
    (metadata / "entry_points.txt").write_text("\n\n".join(groups) + "\n", encoding="utf-8")
    return folder


def python(site: Path, *arguments: str, installed: bool = True) -> subprocess.CompletedProcess[str]:
    """Run a program in a folder beside the package, so that only PYTHONPATH decides whether it is found."""
    folders = ([str(site)] if installed else []) + [path for path in [os.environ.get("PYTHONPATH")] if path]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(folders), "COLUMNS": "120"}
    beside = site / "beside"
    beside.mkdir(exist_ok=True)
    return subprocess.run(
        [sys.executable, "-c", *arguments], env=environment, cwd=beside, capture_output=True, text=True, check=False
    )


@pytest.fixture(scope="module")
def run(site: Path) -> Path:
    """A run folder in which the package's stage is trained by `motionkit train`."""
    rng = np.random.default_rng(0)
    body = rng.normal(0, 0.3, (22, 3)).astype(np.float32)
    body[:, 1] = np.linspace(0.0, 1.7, 22)
    with StoreWriter.create(site / "store") as writer:
        for index, fps in enumerate((30, 120)):
            path = np.array([0.5 * index, 0.0, 0.0], dtype=np.float32) + np.zeros((40, 1, 3), dtype=np.float32)
            motion = Motion(body + path, SMPL22, TimeGrid(Fraction(fps), 40), sequence_id=f"take-{index}")
            writer.add(motion)
    trained = python(
        site, APP, "train", "--stage", "standstill", "--store", "../store", "--runs", "../runs", "--run", "idle",
        "--set", "stride=4", "--json",
    )  # fmt: skip
    assert trained.returncode == 0, trained.stderr
    assert json.loads(trained.stdout)["stages"] == [{"stage": "standstill", "poses": 20}]
    return site / "runs" / "idle"


def test_help_lists_the_command_only_where_the_package_is_installed(site: Path) -> None:
    assert "standing-height" in python(site, APP, "--help").stdout
    assert "standing-height" not in python(site, APP, "--help", installed=False).stdout


def test_the_command_answers(site: Path, run: Path) -> None:
    told = python(site, APP, "standing-height", str(run), "--json")
    assert told.returncode == 0, told.stderr
    assert json.loads(told.stdout)["height_metres"] == pytest.approx(1.7, abs=1e-5)


def test_the_page_uses_it_as_any_model(site: Path, run: Path) -> None:
    (example,) = re.findall(r"```python\n(import motionkit as mk\n.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    told = python(site, f"import os; os.chdir('..')\n{example}\nprint(model, motion)")
    assert told.returncode == 0, told.stderr
    assert "MotionModel('standing still', 'runs/idle', 22 joints" in told.stdout
    assert "120 frames at 60 fps = 2.00 s" in told.stdout


def test_the_model_has_its_row_in_table_2(site: Path, run: Path) -> None:
    """By the same path as NeRM, which has none here: the table says what trains it."""
    rng = np.random.default_rng(1)
    with StoreWriter.create(site / "moving") as writer:
        for index in range(12):
            grid = TimeGrid(Fraction(60), 300)
            rate, phase = rng.uniform(0.5, 2, (22, 3)), rng.uniform(0, 6, (22, 3))
            swing = 0.05 * np.sin(2 * np.pi * rate * grid.seconds()[:, None, None] + phase)
            body = np.linspace(0.1, 1.7, 66).reshape(22, 3)
            split = ("train", "test")[index % 2]
            writer.add(
                Motion((body + swing).astype(np.float32), SMPL22, grid, split=split, sequence_id=f"take-{index}")
            )
    built = python(
        site, APP, "eval", "--table", "2", "--store", "../moving", "--runs", "../runs", "--run", "idle",
        "--fps", "20,60", "--clips", "128", "--replications", "2", "--evaluator", "kinematic",
        "--results", "../results", "--json",
    )  # fmt: skip
    assert built.returncode == 0, built.stderr
    result = json.loads(built.stdout)
    rows = {row["name"]: row["cells"] for row in result["blocks"][0]["rows"]}
    assert set(rows["standing still"]) == {"20 fps", "60 fps"}
    assert "standing still generated at 20 fps, SLERP" in rows and not any("NeRM" in name for name in rows)
    # Who stands still is far from who moves.
    floor = rows["real, independent draws (P1)"]["60 fps"]["value"]
    assert rows["standing still"]["60 fps"]["value"] > 10 * floor
    assert rows["standing still"]["60 fps"]["details"]["motions"] == 6
    assert any("NeRM" in line and "motionkit train" in line for line in result["missing"])


FORMAT = """
import motionkit as mk
motion = mk.read("in/take.xyz")
motion.save("again.xyz")
assert open("again.xyz").read() == open("in/take.xyz").read()
made = mk.complete("in/take.xyz", fps=60, model="spline")
assert made.num_frames == 19
made.resample(30).save("in/second.xyz")
print(motion.fps, motion.num_frames, mk.view("in", path="page.html").name)
"""


def test_a_format_of_one_file_is_read_ingested_and_exported(site: Path) -> None:
    """And completed, viewed, written by suffix, with no other change than the package that is installed."""
    rng = np.random.default_rng(2)
    body = np.linspace(0.1, 1.7, 66) + rng.normal(0, 0.02, (10, 66)).cumsum(axis=0)
    take = site / "beside" / "in" / "take.xyz"
    take.parent.mkdir(parents=True)
    take.write_text("fps 30\n" + "".join(" ".join(f"{value:.6f}" for value in row) + "\n" for row in body))
    used = python(site, FORMAT)
    assert used.returncode == 0, used.stderr
    assert used.stdout.split() == ["30", "10", "page.html"]
    ingested = python(site, APP, "ingest", "in", "--store", "xyz-store", "--json")
    assert ingested.returncode == 0, ingested.stderr
    exported = python(site, APP, "export", "out", "--format", "xyz", "--store", "xyz-store", "--json")
    assert exported.returncode == 0, exported.stderr
    assert json.loads(exported.stdout)["num_sequences"] == 2
    rows = [np.loadtxt(each, skiprows=1) for each in (take, site / "beside" / "out" / "in" / "take.xyz")]
    np.testing.assert_allclose(rows[0], rows[1], atol=2e-6)
    (site / "beside" / "in" / "broken.xyz").write_text("fps 30\n1 2 3\n")
    broken = python(site, APP, "ingest", "in", "--store", "another")
    assert "broken.xyz" in broken.stderr and "expected 'fps'" in broken.stderr
    without = python(site, APP, "ingest", "in", "--store", "third", installed=False)
    assert without.returncode != 0 and "no motions in this folder" in without.stderr


def test_a_stage_that_nobody_brought_is_a_usage_error(site: Path) -> None:
    told = python(site, APP, "train", "--stage", "standstill", "--store", "store", installed=False)
    assert told.returncode == 2
    assert "no stage is called 'standstill'" in told.stderr
