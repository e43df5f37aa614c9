"""What packages import is declared, goes one way, and is named in no string of a package below."""

import ast
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from tests.helpers.repository import REPOSITORY

OWN = {"motionkit", "nerm", "pahires", "peers", "eval", "benchmarks", "tests"}
# Imported where the user has them, with a message that names the extra or the package; jaxtyping where it is loaded.
OPTIONAL = {
    *("huggingface_hub", "imageio_ffmpeg", "jaxtyping", "motionmcp", "ray", "rerun", "tokenizers", "torchmetrics"),
    *("transformers", "uvicorn"),
}


def imported(folder: str) -> set[str]:
    found: set[str] = set()
    for path in (REPOSITORY / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found.update(alias.name.split(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module.split(".")[0])
    return found - OWN - set(sys.stdlib_module_names)


def plain(name: str) -> str:
    return re.split(r"[\[<>=; ]", name)[0].lower().replace("_", "-")


@pytest.mark.parametrize("folder", sorted(OWN))
def test_what_is_imported_is_declared(folder: str) -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared, wanted = {plain(each) for each in project["dependencies"]}, imported(folder)
    if folder in ("tests", "benchmarks"):
        declared |= {plain(each) for extra in project["optional-dependencies"].values() for each in extra}
    else:
        wanted -= OPTIONAL
    names = packages_distributions()
    missing = {package for package in wanted if not declared & {plain(each) for each in names.get(package, [package])}}
    assert not missing, f"{folder}/ imports {sorted(missing)}, which pyproject.toml does not declare"


# In eval a paper and its page in docs may be named, but no module of a model.
# A command may be named, as a person types it.
FORBIDDEN = {
    "motionkit": re.compile(r"\b(nerm|pahires|peers)\b|(?<!^motionkit )(?<!^split train )\beval\b"),
    "peers": re.compile(r"\b(nerm|pahires|eval)\.(?!md\b)[a-z]"),
    "eval": re.compile(r"(?<!^eval\.tables\.)\b(nerm|pahires|peers)\.(?!md\b)[a-z]|^(nerm|pahires|peers):"),
}


def strings(source: str) -> Iterator[tuple[int, str]]:
    """Every string of a module, docstrings too, with its line."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value


def named(package: str, source: str) -> list[tuple[int, str]]:
    return [(line, text) for line, text in strings(source) if FORBIDDEN[package].search(text)]


@pytest.mark.parametrize("package", FORBIDDEN)
def test_no_string_names_a_package_above(package: str) -> None:
    found = {
        f"{path.relative_to(REPOSITORY)}:{line}": text
        for path in sorted((REPOSITORY / package).rglob("*.py"))
        for line, text in named(package, path.read_text(encoding="utf-8"))
    }
    assert found == {}


PACKAGES = ("motionkit", "nerm", "pahires", "peers", "eval")
LINT = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True, no_logo=True))"
# A module of each contract, a line against it, and the contract.
BROKEN = (
    ("motionkit/core/motion.py", "import motionkit.fields.resample", "data flows one way in motionkit"),
    ("nerm/latents.py", "import nerm.network", "data flows one way in nerm"),
    ("pahires/temporal/training.py", "import pahires.model", "data flows one way in pahires"),
    ("peers/layers.py", "import peers.diffusion", "data flows one way in peers"),
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
