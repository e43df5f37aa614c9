"""Every package that is imported is declared in pyproject.toml: those of tests alone among the extra `dev`."""

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
OWN = {"motionkit", "nerm", "pahires", "peers", "eval", "benchmarks", "tests"}
# Imported where the user has them, with a message that names the extra or the package; jaxtyping where it is loaded.
OPTIONAL = {
    "huggingface_hub",
    "imageio_ffmpeg",
    "jaxtyping",
    "ray",
    "rerun",
    "tokenizers",
    "torchmetrics",
    "transformers",
}


def imported(folder: str) -> set[str]:
    found: set[str] = set()
    for path in (ROOT / folder).rglob("*.py"):
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
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared, wanted = {plain(each) for each in project["dependencies"]}, imported(folder)
    if folder in ("tests", "benchmarks"):
        declared |= {plain(each) for extra in project["optional-dependencies"].values() for each in extra}
    else:
        wanted -= OPTIONAL
    names = packages_distributions()
    missing = {package for package in wanted if not declared & {plain(each) for each in names.get(package, [package])}}
    assert not missing, f"{folder}/ imports {sorted(missing)}, which pyproject.toml does not declare"
