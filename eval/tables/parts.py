"""Parts of tables that are computed once and kept: rows that several tables share, and what a stopped table had.

A part lies in RESULTS/parts/ under the hash of all that it depends on; whatever of this changes, it is computed anew.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from eval.report.results import Cell, parse_cell
from motionkit.core.files import require_no_link
from motionkit.core.sealed import read_json, write_json
from motionkit.core.warn import warn
from motionkit.errors import DamagedFileError

FOLDER = "parts"
FORMAT = "motionkit-part/1"


@dataclass(frozen=True)
class Part:
    """Numbers by row and column, and why some are not there."""

    rows: Mapping[str, Mapping[str, Cell]]
    missing: tuple[str, ...] = ()


def kept(results: Path, name: str, terms: Mapping[str, Any], compute: Callable[[], Part]) -> Part:
    """The part `name` for these terms (plain values), read where it was computed before, else computed and written."""
    part = find_part(results, name, terms)
    if part is None:
        part = compute()
        keep_part(results, name, terms, part)
    return part


def find_part(results: Path, name: str, terms: Mapping[str, Any]) -> Part | None:
    """The part that was kept for these terms; None where there is none, or a damaged one, which is warned of."""
    path, key = _place(results, name, terms)
    if not path.is_file():
        return None
    try:
        document = read_json(path, "computing it anew")
        return _part(document) if document["key"] == key else None
    except DamagedFileError as error:
        warn(str(error))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        warn(f"{path} is no part of a table ({error!r}): computing it anew")
    return None


def keep_part(results: Path, name: str, terms: Mapping[str, Any], part: Part) -> None:
    """Write a part for `find_part`; raises `LinkError` where the folder of parts is a link."""
    path, key = _place(results, name, terms)
    require_no_link(path.parent, "delete the link, or name another folder with --results")
    write_json(path, {"key": key, **asdict(part)})


def _part(document: dict[str, Any]) -> Part:
    rows = {
        row: {column: parse_cell(cell) for column, cell in cells.items()} for row, cells in document["rows"].items()
    }
    return Part(rows, tuple(map(str, document["missing"])))


def _place(results: Path, name: str, terms: Mapping[str, Any]) -> tuple[Path, Any]:
    key = json.loads(json.dumps({"format": FORMAT, "name": name, **terms}))
    digest = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()
    return results / FOLDER / f"{name}-{digest[:16]}.json", key
