"""Results: one JSON file per table, holding every number with what it means and where it comes from."""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from motionkit.errors import MotionkitError
from motionkit.training.run import commit, versions, write_json

FORMAT = "motionkit-result/1"
Origin = Literal["ours", "reference", "paper"]


class ResultError(MotionkitError):
    """A result file that cannot be read."""


@dataclass(frozen=True)
class Cell:
    """One number: `ci95` half its 95 % interval (None: there is none), `details` further metrics by name.

    A count is an int, and is shown with all its digits.
    """

    value: float | int
    ci95: float | None = None
    details: Mapping[str, float | int] = field(default_factory=dict)


@dataclass(frozen=True)
class Row:
    """One line of a table; a column that is absent from `cells` has no number.

    `origin`: "ours" was computed here, "reference" was computed here from real motion, "paper" is printed in a paper.
    """

    name: str
    origin: Origin
    cells: Mapping[str, Cell]
    note: str = ""


@dataclass(frozen=True)
class Block:
    """Rows that may be compared with one another; numbers of different blocks may not."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[Row, ...]
    lower_is_better: bool = True
    note: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Result:
    """One table: blocks of rows, the definition of its numbers, what is missing, and where everything came from.

    `task` names it ("nerm-table2"), `version` is raised when its meaning changes. `provenance` holds store, run, seed,
    environment. `figure` is the name of a picture beside the file, "" where there is none.
    """

    task: str
    version: str
    title: str
    caption: str
    blocks: tuple[Block, ...]
    definition: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    figure: str = ""


def environment() -> dict[str, Any]:
    """Versions, processors, time, and the commit where this runs from a git checkout."""
    return {
        "versions": versions(),
        "processors": os.cpu_count(),
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": commit(),
    }


def write_result(result: Result, folder: Path) -> Path:
    """Write `folder/TASK.json`, whole or not at all; raises `ValueError` for NaN."""
    path = folder / f"{result.task}.json"
    write_json(path, {"format": FORMAT, **asdict(result)})
    return path


def read_result(path: Path) -> Result:
    """Read what `write_result` wrote. Raises `ResultError` for other files or another version."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        found = document.pop("format", None) if isinstance(document, dict) else None
        if found != FORMAT:
            raise ResultError(f"{path}: not a result of format {FORMAT} (found {found!r}); run the evaluation again")
        blocks = tuple(_block(block) for block in document.pop("blocks"))
        notes, missing = tuple(document.pop("notes")), tuple(document.pop("missing"))
        return Result(**document, blocks=blocks, notes=notes, missing=missing)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ResultError(f"{path}: cannot be read as a result: {error}") from None


def read_results(folder: Path) -> list[Result]:
    """Every result in a folder, by task; other JSON files in it are passed over."""
    results = []
    for path in sorted(folder.glob("*.json")):
        try:
            is_result = json.loads(path.read_text(encoding="utf-8")).get("format", "").startswith("motionkit-result/")
        except (ValueError, AttributeError):
            continue
        if is_result:
            results.append(read_result(path))
    return results


def _block(document: dict[str, Any]) -> Block:
    rows = tuple(
        Row(**{**row, "cells": {column: Cell(**cell) for column, cell in row["cells"].items()}})
        for row in document["rows"]
    )
    return Block(**{**document, "rows": rows, "columns": tuple(document["columns"])})
