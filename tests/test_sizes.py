"""Files, functions, signatures and folders stay of a size that is read at one go."""

import ast
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("motionkit", "nerm", "pahires", "peers", "eval")
MAX_FILE_LINES = 400
MAX_FUNCTION_LINES = 60
MAX_PARAMETERS = 8
MAX_MODULES = 16
COMMANDS = (Path("motionkit/cli"), Path("eval/commands"))
"""Folders of commands: a command has as many parameters as options."""
LISTS = (*COMMANDS, Path("eval/metrics"))


def modules(*folders: str) -> Iterator[Path]:
    for folder in folders:
        yield from sorted((ROOT / folder).rglob("*.py"))


@cache
def functions(path: Path) -> tuple[ast.FunctionDef | ast.AsyncFunctionDef, ...]:
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return tuple(node for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))


def num_parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    given = function.args
    names = [each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    return len(names) - (names[:1] in (["self"], ["cls"])) + (given.vararg is not None) + (given.kwarg is not None)


def test_no_file_is_too_long() -> None:
    lengths = {
        path: len(path.read_text(encoding="utf-8").splitlines()) for path in modules(*PACKAGES, "benchmarks", "tests")
    }
    assert not {str(path.relative_to(ROOT)): length for path, length in lengths.items() if length > MAX_FILE_LINES}


def test_no_function_is_too_long() -> None:
    lengths = {
        f"{path.relative_to(ROOT)}:{each.name}": (each.end_lineno or each.lineno) - each.lineno + 1
        for path in modules(*PACKAGES, "benchmarks", "tests")
        for each in functions(path)
    }
    assert not {name: length for name, length in lengths.items() if length > MAX_FUNCTION_LINES}


def test_no_signature_is_too_long() -> None:
    numbers = {
        f"{path.relative_to(ROOT)}:{each.name}": num_parameters(each)
        for path in modules(*PACKAGES)
        if path.parent.relative_to(ROOT) not in COMMANDS
        for each in functions(path)
    }
    assert not {name: number for name, number in numbers.items() if number > MAX_PARAMETERS}


def test_no_folder_holds_too_many_modules() -> None:
    counts = Counter(path.parent.relative_to(ROOT) for path in modules(*PACKAGES))
    assert not {str(folder): count for folder, count in counts.items() if count > MAX_MODULES and folder not in LISTS}
