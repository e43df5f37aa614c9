"""A table's configuration from what a test says, a store for it, and its rows."""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from eval.report.results import Result
from eval.tables.table import EvalConfig
from motionkit.core.motion import Caption, Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.store.writer import StoreWriter

NAMES = {"features": "evaluators", "names": "evaluators", "published": "protocol"}


def table_request(store: Path, results: Path, **values: Any) -> EvalConfig:
    """The configuration with these values; `features` are the evaluators' names, `published` is the protocol's."""
    if "protocol" in values:
        values["clips"] = values.pop("protocol")
    return EvalConfig(store=store, results=results, **{NAMES.get(name, name): value for name, value in values.items()})


def write_takes(path: Path, takes: Iterable[np.ndarray], fps: Fraction, splits: Sequence[str] = ("test",)) -> Path:
    """A store of takes [frames, 22, 3], each with its number as its caption, in these splits by turns."""
    with StoreWriter.create(path) as writer:
        for number, positions in enumerate(takes):
            about = {"captions": (Caption(str(number)),), "split": splits[number % len(splits)]}
            grid = TimeGrid(fps, len(positions))
            writer.add(Motion(positions, SMPL22, grid, sequence_id=f"take-{number:03d}", **about))
    return path


def rows_of(result: Result, block: int = 0) -> dict[str, dict[str, float]]:
    """A block's values by row and column."""
    return {row.name: {column: cell.value for column, cell in row.cells.items()} for row in result.blocks[block].rows}
