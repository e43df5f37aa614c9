"""Hostile results and generated folders: links where motionkit writes, tables that name foreign files."""

import csv
import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from benchmarks.trust.scenarios import EVAL_PAHIRES, GENERATE, RUN
from tests.hostile.scene import EVIL, Scene, Spoil, edited, links, text

MADE = ((*GENERATE, "--resume"), (*GENERATE, "--overwrite"), GENERATE)
COMPLETE = ("complete", "long/take-0.bvh", "--fps", "90", "--overwrite", "--model", "pahires", *RUN)
REPORTS = tuple(
    ("report", "--results", "results", *rest)
    for rest in ((), ("--format", "png"), ("--format", "markdown"), ("--format", "csv"), ("--json",))
)


def _row(**cells: str) -> Spoil:
    """motions.csv with a first row of these cells."""

    def spoil(inside: Path, outside: Path) -> None:
        path = inside / "made/motions.csv"
        rows = [dict(row) for row in csv.DictReader(path.read_text().splitlines())]
        changed = {name: cell.replace("OUTSIDE", str(outside)) for name, cell in cells.items()}
        rows[0] |= changed
        table = io.StringIO(newline="")
        writer = csv.DictWriter(table, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        path.write_text(table.getvalue())

    return spoil


def _generation(**changes: object) -> Spoil:
    return edited("made/generation.json", lambda document: document.update(changes))


def _part(edit: Callable[[dict[str, Any]], None]) -> Spoil:
    """Every kept part of a table, signed again."""

    def spoil(inside: Path, outside: Path) -> None:
        for path in (inside / "results/parts").iterdir():
            edited(path.relative_to(inside).as_posix(), edit)(inside, outside)

    return spoil


def _each_cell(document: dict[str, Any], **values: object) -> None:
    for cells in document["rows"].values():
        for cell in cells.values():
            cell.update(values)


def _result(name: str, value: object) -> Spoil:
    def edit(document: dict[str, Any]) -> None:
        row = document["blocks"][0]["rows"][0]
        if name in document:
            document[name] = value
        elif name in row:
            row[name] = value
        else:
            next(iter(row["cells"].values()))[name] = value

    return edited("results/pahires-table2.json", edit)


def _result_text(old: str, new: str) -> Spoil:
    def spoil(inside: Path, outside: Path) -> None:
        path = inside / "results/pahires-table2.json"
        document = json.loads(path.read_bytes())
        path.write_text(json.dumps(document).replace(old, new, 1))

    return spoil


GENERATED: dict[str, Spoil] = {
    "motions.csv names files above": _row(file="../../outside/mine.npz"),
    "motions.csv names an absolute file": _row(file="OUTSIDE/mine.npz"),
    "motions.csv names a file of a zero byte": _row(file="a\0b.npz"),
    "motions.csv names a file of 100,000 letters": _row(file="x" * 100_000),
    "motions.csv of odd numbers": _row(fps="1e999", seconds="nan", num_frames="9" * 5000),
    "captions of escape sequences": _row(captions=json.dumps([EVIL]), action=EVIL),
    "captions nested without end": _row(captions="[" * 100_000),
    "motions.csv is a link": links({"made/motions.csv": "made/motions.csv"}),
    "motions are links": links({"made/0000-walk.npz": "mine.npz", "made/0001-jump.npz": "mine.npz"}),
    "generation.json is a link": links({"made/generation.json": "made/generation.json"}),
}
GENERATIONS: dict[str, dict[str, object]] = {
    "files above the folder": {"files": ["../../outside/mine.npz"]},
    "files that are none": {"files": 7},
    "conditions of escape sequences": {"conditions": [{"seconds": EVIL, "text": EVIL, "action": EVIL}]},
    "a count without end": {"count": 10**30},
}
PARTS: dict[str, Spoil] = {
    "values that are texts": _part(lambda document: _each_cell(document, value=EVIL, ci95=EVIL)),
    "weights of 400 digits": _part(lambda document: _each_cell(document, details={"weight": 10**400})),
    "rows of escape sequences": _part(lambda document: document.update(rows={EVIL: {EVIL: {"value": 1}}})),
    "what is missing of escape sequences": _part(lambda document: document.update(missing=[EVIL])),
}
RESULTS: dict[str, Spoil] = {
    "a value of 1e999": _result_text('"value": ', '"value": 1e999, "x": '),
    "a value of 400 digits": _result("value", 10**400),
    "an interval that is a list": _result("ci95", [1, 2]),
    "a name of script": _result("name", "<script>alert(1)</script>"),
    "a figure above the folder": _result("figure", "../../outside/mine.png"),
    "a task above the folder": _result("task", "../../outside/mine"),
    "a title that is a number": _result("title", 7),
    "an origin of escape sequences": _result("origin", EVIL),
    "blocks that are none": _result("blocks", 7),
    "nested without end": text("results/deep.json", "[" * 100_000),
    "the page is a link": links({"results/report.html": "mine.txt"}),
    "pictures are links": links({"results/pahires-table2.png": "mine.txt"}),
    "parts are a link": links({"results/parts": "results/parts"}),
    "the table is a link": links({"results/pahires-table2.md": "mine.txt"}),
}


def scenes() -> Iterator[Scene]:
    """All of them."""
    for name, spoil in GENERATED.items():
        yield Scene(
            f"generated: {name}",
            spoil,
            (*MADE, ("ingest", "made", "--store", "new", "--workers", "1"), ("view", "made")),
        )
    for name, values in GENERATIONS.items():
        yield Scene(f"generated: {name}", _generation(**values), MADE)
    for name, spoil in PARTS.items():
        yield Scene(f"parts of tables: {name}", spoil, (EVAL_PAHIRES,))
    for name, spoil in RESULTS.items():
        yield Scene(f"results: {name}", spoil, (*REPORTS, EVAL_PAHIRES))
    yield Scene("completed: the output is a link", links({"long/take-0.completed.bvh": "mine.txt"}), (COMPLETE,))
    yield Scene(
        "page: the output is a link",
        links({"take-0.view.html": "mine.txt"}),
        (("view", "long/take-0.bvh", "--overwrite"),),
    )
