"""Results in the documentation say where they come from, and README's figures are those of the results."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from eval.report.results import Cell, read_result, to_markdown
from nerm.recipes import LOCAL

ROOT = Path(__file__).parents[1]
RESULTS = sorted((ROOT / "docs" / "results").rglob("*.json"))
README = (ROOT / "README.md").read_text(encoding="utf-8")
SHA256 = re.compile("[0-9a-f]{64}")


def missing(document: dict[str, Any]) -> set[str]:
    """What a result does not say of its origin: its commit, its store, the weights that it is about."""
    origin = document.get("provenance", {})
    runs = {name for name in ("run", "runs", "trained") if origin.get(name)}
    weights = {*map(str, origin.get("weights_sha256", {}).values()), *map(str, origin.get("encoders", {}).values())}
    weights |= {str(run) for run in origin.get("runs", {}).values()}
    found = {
        "commit": origin.get("environment", {}).get("commit"),
        "store": "format" not in document or SHA256.fullmatch(origin.get("store", {}).get("fingerprint", "")),
        "weights": not runs or any(SHA256.search(each) for each in weights),
    }
    return {name for name, value in found.items() if not value}


@pytest.mark.parametrize("path", RESULTS, ids=lambda path: path.stem)
def test_a_result_says_where_it_comes_from_or_that_it_does_not(path: Path) -> None:
    document = json.loads(path.read_text(encoding="utf-8"))
    if path.stem == "reliability":  # five reports, none of which has a store or weights that last
        assert all(part["environment"]["commit"] for part in document.values())
        return
    origin = document["provenance"]
    said = {"commit", "store", "weights"} if origin == "not recorded" else set(origin.get("not recorded", ()))
    assert missing(document if isinstance(origin, dict) else {}) <= said
    if said and document.get("format"):
        assert said == missing(document), "what is there is not to be called absent"


def cells_of(result: str, name: str, title: str = "") -> dict[str, Cell]:
    """A row's cells, in the block of this title or the first."""
    blocks = read_result(ROOT / f"docs/results/{result}.json").blocks
    block = next(block for block in blocks if title in ("", block.title))
    return dict({row.name: row.cells for row in block.rows}[name])


def test_readme_has_rows_of_the_tables_of_the_real_captures() -> None:
    planted, profile = f"{LOCAL}, planted", "Detail profile, 120 fps"
    seeds = [cells_of(f"grown-pack-table2{seed}", planted) for seed in ("", "-seed1", "-seed2")]
    shown = []
    for column in ("60 fps", "120 fps"):
        values = [cells[column].value for cells in seeds]
        shown.append(f"{sum(values) / 3:.2f} ({min(values):.2f} to {max(values):.2f})")
    timing = cells_of("grown-pack-table2", planted, profile)["T"].value
    detailed = cells_of("grown-pack-table2", f"{planted}, with detail", profile)["T"].value
    assert f"| NeRM, as `motionkit generate` writes it | {' | '.join(shown)} | {timing:.2f} |" in README
    assert f"| NeRM with [`--detail`](docs/detail.md) | the same | the same | {detailed:.2f} |" in README
    for said, name, result in (
        ("other real people (training takes)", "training takes, as a generator", "grown-pack-table2"),
        ("T2M (Guo et al. 2022), trained for as long, one seed", "T2M, planted", "all-systems/1800s-0/nerm-table2"),
    ):
        cells = cells_of(result, name)
        numbers = [f"{cells[column].value:.2f} ± {cells[column].ci95:.2f}" for column in ("60 fps", "120 fps")]
        timing = cells_of(result, name, profile)["T"].value
        assert f"| {said} | {' | '.join(numbers)} | {timing:.2f} |" in README


def test_readme_has_the_reconstruction_errors_of_table_4() -> None:
    block = read_result(ROOT / "docs/results/grown-pack-table4.json").blocks[0]
    training, held_out = ({f"{cell.value:.0f}" for cell in row.cells.values()} for row in block.rows)
    said = re.search(r"reconstructed to (\d+) mm and held-out ones to (\d+) mm", README)
    assert said and ({said[1]}, {said[2]}) == (training, held_out)


@pytest.mark.parametrize("task", ["physical-framerates", "physical-games"])
def test_every_table_of_physical_figures_is_on_their_page(task: str) -> None:
    page = (ROOT / "docs" / "results" / "physical.md").read_text(encoding="utf-8").splitlines()
    table = to_markdown(read_result(ROOT / "docs" / "results" / f"{task}.json")).splitlines()
    assert [line for line in table if line.startswith("| ") and line not in page] == []
