"""Parts of tables that are computed once and kept: rows that several tables share, and what a stopped table had.

A part lies in RESULTS/parts/ under the hash of all that it depends on; whatever of this changes, it is computed anew.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from eval.report.results import Cell
from motionkit.training.run import write_json

FOLDER = "parts"
FORMAT = "motionkit-part/1"


@dataclass(frozen=True)
class Part:
    """Numbers by row and column, and why some are not there."""

    rows: Mapping[str, Mapping[str, Cell]]
    missing: tuple[str, ...] = ()


def kept(results: Path, name: str, terms: Mapping[str, Any], compute: Callable[[], Part]) -> Part:
    """The part `name` for these terms (plain values), read where it was computed before, else computed and written."""
    key = json.loads(json.dumps({"format": FORMAT, "name": name, **terms}))
    digest = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()
    path = results / FOLDER / f"{name}-{digest[:16]}.json"
    if path.is_file():
        document = json.loads(path.read_text(encoding="utf-8"))
        if document["key"] == key:
            rows = {
                row: {column: Cell(**cell) for column, cell in cells.items()} for row, cells in document["rows"].items()
            }
            return Part(rows, tuple(document["missing"]))
    part = compute()
    write_json(path, {"key": key, **asdict(part)})
    return part
