"""The order of imports that pyproject.toml's contracts describe, and that they can fail."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.repository import REPOSITORY

PACKAGES = ("motionkit", "nerm", "pahires", "peers", "eval")
LINT = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True, no_logo=True))"

ABOVE = "models and the evaluation stand above motionkit"


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    """Check the contracts of the pyproject.toml in a folder on the packages beside it."""
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    return subprocess.run(
        [sys.executable, "-c", LINT], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """All packages' modules and their contracts."""
    for package in PACKAGES:
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(REPOSITORY / package, tmp_path / package, ignore=ignored)
    shutil.copy(REPOSITORY / "pyproject.toml", tmp_path)
    return tmp_path


def test_imports_run_one_way() -> None:
    result = lint(REPOSITORY)
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.parametrize(
    ("module", "line", "contract"),
    [
        ("motionkit/core/motion.py", "import motionkit.fields.resample", "data flows one way in motionkit"),
        ("motionkit/fields/motion_field.py", "import motionkit.io.registry", "data flows one way in motionkit"),
        ("motionkit/io/registry.py", "import motionkit.store.reader", "data flows one way in motionkit"),
        ("motionkit/store/reader.py", "import motionkit.training.loop", "data flows one way in motionkit"),
        ("motionkit/training/loop.py", "import motionkit.generate.output", "data flows one way in motionkit"),
        ("motionkit/generate/request.py", "import motionkit.cli.app", "data flows one way in motionkit"),
        ("nerm/latents.py", "import nerm.network", "data flows one way in nerm"),
        ("pahires/activation.py", "import pahires.model", "data flows one way in pahires"),
        ("peers/layers.py", "import peers.mdm", "data flows one way in peers"),
        ("eval/sets/sets.py", "import eval.tables.table", "data flows one way in eval"),
        ("eval/metrics/distributions.py", "from eval import clip_fid", "data flows one way in eval"),
        ("motionkit/core/timegrid.py", "import nerm", ABOVE),
        ("pahires/temporal/training.py", "import pahires.model", "data flows one way in pahires"),
        ("eval/tables/table.py", "import nerm.model", ABOVE),
        ("pahires/model.py", "import nerm.network", ABOVE),
        ("eval/metrics/distributions.py", "import torch", "the corpus and the metrics never import torch"),
        (
            "nerm/network.py",
            "import motionkit.cli.app",
            "models and the evaluation do not know the command line",
        ),
        ("eval/tables/table.py", "import rich.progress", "nothing below the command line prints"),
        ("motionkit/store/reader.py", "import typer", "nothing below the command line prints"),
    ],
)
def test_an_import_against_the_order_is_found(copy: Path, module: str, line: str, contract: str) -> None:
    path = copy / module
    path.write_text(path.read_text(encoding="utf-8") + f"\n{line}\n", encoding="utf-8")
    result = lint(copy)
    assert result.returncode != 0
    assert f"{contract} BROKEN" in " ".join(result.stdout.split())


@pytest.mark.parametrize("package", PACKAGES)
def test_a_module_on_no_floor_is_found(copy: Path, package: str) -> None:
    (copy / package / "attic.py").write_text('"""A module."""\n', encoding="utf-8")
    result = lint(copy)
    assert result.returncode != 0
    assert f"- {package}.attic" in result.stdout
