"""`motionkit --help` and `motionkit train --help` load nothing heavy, whatever is installed; `info` little."""

import subprocess
import sys
from pathlib import Path

import pytest

from motionkit.store.ingest import ingest
from tests.helpers.format_samples import bvh_text

HEAVY = ("torch", "pandas", "scipy", "matplotlib", "pyarrow", "duckdb", "sklearn", "transformers", "rich.progress")
HELP = """
import sys
from motionkit.cli.app import build_app
try:
    build_app()({arguments!r})
except SystemExit as stop:
    assert not stop.code, stop.code
print("loaded:", *sorted(set(sys.modules) & set({heavy!r})), *{extra})
"""


def loaded(arguments: list[str], extra: str = "[]") -> list[str]:
    """Heavy modules that a fresh interpreter holds after the command; `extra` is an expression to add to them."""
    script = HELP.format(arguments=arguments, heavy=("numpy", *HEAVY), extra=extra)
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert "Usage" in result.stdout
    return result.stdout.rstrip().splitlines()[-1].removeprefix("loaded:").split()


@pytest.mark.parametrize("arguments", [["--help"], ["train", "--help"]])
def test_help_loads_nothing_heavy(arguments: list[str]) -> None:
    assert loaded(arguments) == []


def test_what_is_loaded_would_be_seen() -> None:
    assert loaded(["--help"], extra="[__import__('scipy').__name__]") == ["scipy"]


def test_what_is_installed_is_listed_without_loading_anything_heavy() -> None:
    script = (
        "import sys; from motionkit.core import plugins; from motionkit.generate.models import installed_models\n"
        "print(*plugins.names('STAGES'), *plugins.names('TABLES'), *installed_models())\n"
        f"print('loaded:', *sorted(set(sys.modules) & set({HEAVY!r})))"
    )
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    names, heavy = result.stdout.splitlines()
    assert {"evaluator", "nerm-2", "mdm"} <= set(names.split())
    assert heavy == "loaded:"


def test_a_summary_of_a_store_loads_little(tmp_path: Path) -> None:
    source = tmp_path / "takes"
    source.mkdir()
    (source / "walk.bvh").write_text(bvh_text())
    store = str(tmp_path / "store")
    ingest([source], Path(store), num_workers=1)
    script = (
        "import sys; from motionkit.cli.app import build_app\n"
        f"build_app()(['info', '--store', {store!r}, '--json'], standalone_mode=False)\n"
        "print('loaded:', *sorted(set(sys.modules) & {'jaxtyping', 'pandas', 'torch', 'scipy'}))"
    )
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert '"num_sequences": 1' in result.stdout
    assert result.stdout.splitlines()[-1] == "loaded:"
