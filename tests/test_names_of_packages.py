"""Nothing names a package above it, not in a string either: what is installed is found by its plugin module."""

import ast
import re
from collections.abc import Iterator

import pytest

from tests.helpers.repository import REPOSITORY

# In eval a paper and its page in docs may be named, but no module of a model.
# A command may be named, as a person types it.
FORBIDDEN = {
    "motionkit": re.compile(r"\b(nerm|pahires|peers)\b|(?<!^motionkit )\beval\b"),
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


@pytest.mark.parametrize(
    ("package", "source"),
    [
        ("motionkit", '"""A module for nerm."""'),
        ("motionkit", 'load_model("nerm", run)'),
        ("motionkit", 'print(f"motionkit train --stage pahires --run {run}")'),
        ("eval", 'import_module("nerm.field")'),
        ("eval", 'def f():\n    """A docstring."""\n    return "pahires.model:load"'),
    ],
)
def test_such_a_string_is_found(package: str, source: str) -> None:
    assert len(named(package, source)) == 1
    assert named(package, '"""A module for models such as NeRM."""') == []
