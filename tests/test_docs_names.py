"""Files and modules that the documentation names are there."""

import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md")))
PACKAGES = "motionkit|nerm|pahires|peers|eval"
PATH = re.compile(rf"`((?:{PACKAGES}|benchmarks|tests)/[\w/.-]*)`")
NAME = re.compile(rf"`((?:{PACKAGES})(?:\.\w+)+)(?:\([^`]*\))?`")
# Groups of entry points, and what stands in text for any name.
NOT_MODULES = re.compile(
    r"motionkit\.(commands|stages|models|encoders|text_encoders|tables|ablations|formats|toml|recipes)$"
)


def exists(name: str) -> bool:
    """Whether a dotted name can be imported, its last parts as attributes."""
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:length]))
        except ImportError:
            continue
        try:
            for attribute in parts[length:]:
                found = getattr(found, attribute)
        except AttributeError:
            return False
        return True
    return False


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_a_page_names_is_there(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert not [path for path in PATH.findall(text) if not (ROOT / path).exists()]
    assert not [name for name in set(NAME.findall(text)) if not NOT_MODULES.match(name) and not exists(name)]
