"""Cached parts of tables: rows that several tables share, and those of an interrupted table.

A part is in RESULTS/parts/ under the hash of everything it depends on; when any of this changes, it is recomputed.
"""

import csv
import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from eval.report.results import Cell, Row, parse_cell
from motionkit.core.errors import DamagedFileError
from motionkit.core.files import read_json, write_json
from motionkit.core.progress import warn

FOLDER = "parts"
FORMAT = "motionkit-part/1"


@dataclass(frozen=True)
class Part:
    """Numbers by row and column, and why some are missing."""

    rows: Mapping[str, Mapping[str, Cell]]
    missing: tuple[str, ...] = ()


def kept(results: Path, name: str, terms: Mapping[str, Any], compute: Callable[[], Part]) -> Part:
    """The part `name` for these terms (plain values): read if it is cached, else computed and written."""
    part = find_part(results, name, terms)
    if part is None:
        part = compute()
        keep_part(results, name, terms, part)
    return part


def find_part(results: Path, name: str, terms: Mapping[str, Any]) -> Part | None:
    """The cached part for these terms; None if there is none, or with a warning if it is damaged."""
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
    """Write a part for `find_part`."""
    path, key = _place(results, name, terms)
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


SOURCES = {
    "nerm": "Wei et al., NeRM: Learning Neural Representations for High-Framerate Human Motion Synthesis, ICLR 2024",
    "pahires": "Xu et al., Towards Arbitrary Motion Completing via Hierarchical Continuous Representation",
    "lafan1": "Harvey et al., Robust Motion In-betweening, ACM TOG 2020 (its benchmark's code)",
    "delta-interp": "Oreshkin et al., Motion In-betweening via Deep Δ-Interpolator, IEEE TVCG 2023",
    "ts-former": "Qin et al., Motion In-betweening via Two-stage Transformers, ACM TOG 2022",
}


@dataclass(frozen=True)
class Reported:
    """One printed figure; `value` or `ci95` is None if the paper prints none or it is illegible."""

    paper: str
    table: str
    dataset: str
    method: str
    metric: str
    setting: str
    value: float | None
    ci95: float | None
    note: str


def reported_figures(paper: str, table: str) -> list[Reported]:
    """Every figure of one paper's table, in the order of the file."""
    text = (files("eval") / "data" / "reported.csv").read_text(encoding="utf-8")
    return [
        Reported(**{**dict[str, Any](row), "value": _number(row["value"]), "ci95": _number(row["ci95"])})
        for row in csv.DictReader(text.splitlines())
        if (row["paper"], row["table"]) == (paper, table)
    ]


def printed_rows(
    figures: Iterable[Reported],
    column: Callable[[Reported], str],
    name: Callable[[Reported], str] = lambda figure: figure.method,
    factor: float = 1.0,
) -> tuple[Row, ...]:
    """Rows of a paper's figures, times a factor; missing or illegible ones are left out."""
    cells: dict[str, dict[str, Cell]] = {}
    for figure in figures:
        if figure.value is not None:
            cells.setdefault(name(figure), {})[column(figure)] = Cell(factor * figure.value, figure.ci95)
    return tuple(Row(f"{row} (paper)", "paper", found) for row, found in cells.items())


def _number(text: str) -> float | None:
    return float(text) if text else None
