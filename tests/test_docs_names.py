"""What the documentation names is there: files, modules, links and headings; and it names all that there is."""

import ast
import importlib
import re
from collections import defaultdict
from functools import cache
from pathlib import Path

import pytest

import eval
import motionkit

ROOT = Path(__file__).parents[1]
PAGES = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md")))
LINK = re.compile(r"\]\((?!\w+:)([^)#\s]*)(?:#([^)\s]+))?\)")
CODE = re.compile(r"^```.*?^```|`[^`\n]+`", re.MULTILINE | re.DOTALL)
PACKAGES = ("motionkit", "nerm", "pahires", "peers", "eval")
FOLDERS = (*PACKAGES, "benchmarks", "tests")
PATH = re.compile(rf"`((?:{'|'.join(FOLDERS)})/[\w/.-]*)`")
SCRIPT = re.compile(r"(?<![\w/.])(?:[\w-]+/)*[\w-]+\.py\b")
NAME = re.compile(r"`([A-Za-z_]\w*(?:\.\w+)+)(?:\([^`]*\))?`")
RUN = re.compile(r"python -m ([\w.]+)")
# The group of entry points, and what stands in text for any name.
NOT_MODULES = re.compile(r"motionkit\.(plugins|recipes)$")
# Scripts of other projects, and of the example package.
FOREIGN = re.compile(
    r"(standstill|kimodo|utils|sample)/|(smplx_to_robot|csv_to_npz|convert_amass_to_proto|batch_gmr_pkl_to_csv|test|"
    r"gen_t2m|GPT_eval_multi)\.py$"
)
# First parts of names that are no modules of ours: libraries, settings and variables.
OBJECTS = {"denoiser", "field", "np", "pandas", "torch", "torchmetrics", "training", "motion", "z"}


@cache
def files() -> tuple[str, ...]:
    return tuple(f"/{path.relative_to(ROOT)}" for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))


@cache
def definitions() -> dict[str, set[str]]:
    """The last names of the modules that define each function or class of the packages."""
    found = defaultdict(set)
    for path in (path for folder in PACKAGES for path in (ROOT / folder).rglob("*.py")):
        module = path.parent.name if path.stem == "__init__" else path.stem
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                found[node.name].add(module)
    return found


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


def is_there(name: str) -> bool:
    """Whether a name of the packages exists; of others, whether a module `a` of `a.b` has `b` if any module has it."""
    name = re.sub(r"^mk\.", "motionkit.", name)
    first, (owner, last) = name.split(".")[0], name.split(".")[-2:]
    if first in PACKAGES:
        return bool(NOT_MODULES.match(name)) or exists(name)
    return first in OBJECTS or last not in definitions() or owner in {*definitions()[last], *definitions()}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_a_page_names_is_there(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert not [path for path in PATH.findall(text) if not (ROOT / path).exists()]
    scripts = [each for each in set(SCRIPT.findall(text)) if not FOREIGN.match(each)]
    assert not [each for each in scripts if not any(path.endswith(f"/{each}") for path in files())]
    assert not [name for name in set(NAME.findall(text)) if not is_there(name)]
    assert not [name for name in RUN.findall(text) if name.startswith(FOLDERS) and not exists(name)]


def test_nobody_is_sent_to_an_index_that_lacks_the_package() -> None:
    sources = [path for folder in PACKAGES for path in (ROOT / folder).rglob("*") if path.suffix in (".py", ".j2")]
    texts = {path: path.read_text(encoding="utf-8") for path in (*PAGES, ROOT / "docs/tutorial.ipynb", *sources)}
    assert not [path for path, text in texts.items() if re.search(r"install[^\n]*['\"`]?motionkit\[", text)]


def anchors(page: Path) -> set[str]:
    """The names that repositories' sites and the documentation give to a page's headings."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#{1,4} (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def leads_nowhere(page: Path, target: str, anchor: str) -> bool:
    file = page.parent / target if target else page
    return not file.exists() or (bool(anchor) and anchor not in anchors(file))


@pytest.mark.parametrize("page", (*PAGES, ROOT / "CHANGELOG.md"), ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    text = CODE.sub("", page.read_text(encoding="utf-8"))
    assert [link for link in LINK.findall(text) if leads_nowhere(page, *link)] == []


def test_the_reference_names_all_that_there_is() -> None:
    text = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    named = set(re.findall(r"^\.\. auto\w+:: (\w+)$", text, re.MULTILINE))
    assert named == {*motionkit.__all__, *eval.__all__} - {"__version__"}


def test_every_page_is_in_the_navigation() -> None:
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    listed = {line for tree in re.findall(r"```\{toctree\}\n(.*?)```", index, re.DOTALL) for line in tree.splitlines()}
    pages = {str(page.relative_to(ROOT / "docs").with_suffix("")) for page in (ROOT / "docs").rglob("*.md")}
    assert {page for page in pages if not page.startswith("results/")} <= listed | {"index"}
