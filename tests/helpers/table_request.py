"""A table's configuration from what a test says, a store for it, and its rows."""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from eval.report.results import Result
from eval.tables.table import EvalConfig
from motionkit.core.kinematics import forward_kinematics
from motionkit.core.motion import Caption, Motion
from motionkit.core.skeleton import SMPL22, Skeleton
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
            about: dict[str, Any] = {"captions": (Caption(str(number)),), "split": splits[number % len(splits)]}
            grid = TimeGrid(fps, len(positions))
            writer.add(Motion(positions, SMPL22, grid, sequence_id=f"take-{number:03d}", **about))
    return path


def body_of(turns: np.ndarray, root: np.ndarray, fps: int, skeleton: Skeleton, **about: Any) -> Motion:
    """A motion of rotation vectors [frames, joints, 3], with unsteady signs of quaternions, and a root path."""
    local = Rotation.from_rotvec(turns.reshape(-1, 3)).as_quat(scalar_first=True).reshape(*turns.shape[:2], 4)
    local = (local * np.random.default_rng(0).choice([-1, 1], (*turns.shape[:2], 1))).astype(np.float32)
    root = root.astype(np.float32)
    grid = TimeGrid(Fraction(fps), len(root))
    return Motion(forward_kinematics(local, root, skeleton), skeleton, grid, local, root, **about)


def rows_of(result: Result, block: int = 0) -> dict[str, dict[str, float]]:
    """A block's values by row and column."""
    return {row.name: {column: cell.value for column, cell in row.cells.items()} for row in result.blocks[block].rows}
