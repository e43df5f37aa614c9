"""The order of imports that pyproject.toml's contracts describe, and that they can fail."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]
PACKAGES = ("motionkit", "nerm", "pahires", "eval")
LINT = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True, no_logo=True))"


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
        ("motionkit/motion.py", "import motionkit.kinematics", "data flows one way"),
        ("nerm/latents/knots.py", "import nerm.field.network", "data flows one way in nerm"),
        ("eval/samples/sets.py", "import eval.tables.registry", "data flows one way in eval"),
        ("motionkit/timegrid.py", "import nerm", "the ground floor knows nobody above it"),
        ("eval/metrics/frechet.py", "import torch", "the corpus and the metrics never import torch"),
        ("pahires/network.py", "import nerm", "data flows one way"),
        ("eval/tables/nerm/table4.py", "import nerm.field.saved", "evaluation knows no model"),
        ("eval/tables/nerm/table4.py", "def f():\n    import pahires.stage", "evaluation knows no model"),
        (
            "nerm/generation/plan.py",
            "import nerm.settings",
            "generating knows no model",
        ),
        ("pahires/training.py", "import pahires.model", "PA-HiRes and its peers share no network"),
        ("eval/baselines/peers/liif.py", "import pahires.recipes", "PA-HiRes and its peers share no network"),
        ("motionkit/timegrid.py", "from motionkit import Store", "data flows one way"),
        ("eval/metrics/frechet.py", "from eval import clip_fid", "data flows one way in eval"),
        (
            "nerm/denoiser/diffusion.py",
            "import motionkit.cli.app",
            "models and evaluation do not know the command line",
        ),
        ("motionkit/store/cache.py", "import motionkit.console", "data flows one way"),
        (
            "eval/tables/nerm/table2.py",
            "from motionkit.console import progress",
            "models and evaluation do not know the command line",
        ),
        ("eval/tables/nerm/table2.py", "from rich.progress import Progress", "nothing below the command line prints"),
        ("motionkit/training/loop.py", "def f():\n    import rich", "nothing below the command line prints"),
    ],
)
def test_an_import_against_the_order_is_found(copy: Path, module: str, line: str, contract: str) -> None:
    path = copy / module
    path.write_text(path.read_text(encoding="utf-8") + f"\n{line}\n", encoding="utf-8")
    result = lint(copy)
    assert result.returncode != 0
    assert f"{contract} BROKEN" in " ".join(result.stdout.split())
