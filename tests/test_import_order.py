"""The order of imports that pyproject.toml's contracts describe, and that they can fail."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from tests.helpers.repository import REPOSITORY

PACKAGES = ("motionkit", "nerm", "pahires", "peers", "eval")
LINT = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True, no_logo=True))"
# A module of each contract, a line against it, and the contract.
BROKEN = (
    ("motionkit/core/motion.py", "import motionkit.fields.resample", "data flows one way in motionkit"),
    ("nerm/latents.py", "import nerm.network", "data flows one way in nerm"),
    ("pahires/temporal/training.py", "import pahires.model", "data flows one way in pahires"),
    ("peers/layers.py", "import peers.mdm", "data flows one way in peers"),
    ("eval/sets/sets.py", "import eval.tables.table", "data flows one way in eval"),
    ("eval/tables/table.py", "import nerm.model", "models and the evaluation stand above motionkit"),
    ("eval/tables/table.py", "import pahires.model", "nerm and eval know nothing of pahires"),
    ("eval/metrics/distributions.py", "import torch", "the corpus and the metrics never import torch"),
    ("nerm/network.py", "import motionkit.cli.app", "models and the evaluation do not know the command line"),
    ("motionkit/store/reader.py", "import typer", "nothing below the command line prints"),
)


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    """Check the contracts of the pyproject.toml in a folder on the packages beside it."""
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    return subprocess.run(
        [sys.executable, "-c", LINT], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def test_imports_run_one_way() -> None:
    result = lint(REPOSITORY)
    assert result.returncode == 0, result.stdout + result.stderr


def test_imports_against_the_order_and_modules_on_no_floor_are_found(tmp_path: Path) -> None:
    for package in PACKAGES:
        shutil.copytree(REPOSITORY / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
        (tmp_path / package / "attic.py").write_text('"""A module."""\n', encoding="utf-8")
    shutil.copy(REPOSITORY / "pyproject.toml", tmp_path)
    whole = lint(tmp_path).stdout
    assert [package for package in PACKAGES if f"- {package}.attic" not in whole] == []
    for package in PACKAGES:
        (tmp_path / package / "attic.py").unlink()
    for module, line, _ in BROKEN:
        with (tmp_path / module).open("a", encoding="utf-8") as source:
            source.write(f"\n{line}\n")
    said = " ".join(lint(tmp_path).stdout.split())
    assert [contract for *_, contract in BROKEN if f"{contract} BROKEN" not in said] == []
