"""P1: BVH file → joint positions: motionkit, upc-pymotion, numpy with scipy, and pyarrow's CSV reader, in one process.

    python -m benchmarks.formats.bvh FILE_OR_FOLDER… [--files 20] [--repeats 3]

CPU seconds of one thread. In a repeat each of the four reads all files, as a corpus is read; it begins with no header
remembered, so that the first file of a corpus pays for the header that the others share. The best repeat of each file
counts. A table goes to stderr, JSON to stdout. `numpy_scipy` is what somebody writes in twenty-five lines: `np.loadtxt`
on the numbers, `Rotation.from_euler`, and a loop over the joints. `pyarrow_csv` parses the same motion block as a table
of float64 columns: the floor under any reader that goes through Arrow. It computes no rotation and no position.
"""

import os
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.command import arguments_parser, print_table_and_json

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pyarrow as pa
import pymotion.ops.skeleton as peer_skeleton
from pyarrow import csv
from pymotion.io.bvh import BVH
from rich.table import Table
from scipy.spatial.transform import Rotation

from motionkit.io.bvh import parse_hierarchy, read_bvh

pa.set_cpu_count(1)


def ours(path: Path) -> np.ndarray:
    return read_bvh(path).joint_positions


def peer(path: Path) -> np.ndarray:
    file = BVH()
    file.load(str(path))
    rotations, places, parents, offsets, _, _ = file.get_data()
    positions: np.ndarray = peer_skeleton.fk(rotations, places[:, 0], offsets, parents)[0]
    return positions


def numpy_scipy(path: Path) -> np.ndarray:
    """Positions in file units; the unit, the up axis and moving bones are not found, and no fault is explained."""
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    start = next(number for number, line in enumerate(lines) if line.strip().startswith("Frame Time"))
    joints: list[tuple[int, list[float], list[str]]] = []  # parent, offset, channels
    open_joints: list[int] = []
    for line in lines[:start]:
        match line.split():
            case ["ROOT" | "JOINT", *_]:
                joints.append((open_joints[-1] if open_joints else -1, [], []))
                open_joints.append(len(joints) - 1)
            case ["End", *_]:
                open_joints.append(-1)
            case ["OFFSET", *numbers] if open_joints[-1] >= 0:
                joints[open_joints[-1]][1].extend(map(float, numbers))
            case ["CHANNELS", _, *names]:
                joints[open_joints[-1]][2].extend(names)
            case ["}"]:
                open_joints.pop()
    table = np.loadtxt(lines[start + 1 :], ndmin=2)
    world: list[tuple[np.ndarray, Rotation]] = []
    column = 0
    for parent, offset, names in joints:
        values = dict(zip(names, table[:, column : column + len(names)].T, strict=True))
        column += len(names)
        place = np.stack(
            [values.get(f"{axis}position", np.full(len(table), offset[i])) for i, axis in enumerate("XYZ")]
        )
        turns = [name for name in names if name.endswith("rotation")]
        angles = np.stack([values[name] for name in turns], axis=-1)
        rotation = Rotation.from_euler("".join(name[0] for name in turns), angles, degrees=True)
        if parent >= 0:
            place, rotation = (world[parent][0] + world[parent][1].apply(place.T)).T, world[parent][1] * rotation
        world.append((place.T, rotation))
    return np.stack([place for place, _ in world], axis=1)


def motion_block(path: Path) -> bytes:
    data = path.read_bytes()
    start = data.index(b"\n", data.index(b"Frame Time")) + 1
    return b"\n".join(b" ".join(line.split()) for line in data[start:].splitlines()) + b"\n"


def arrow(block: bytes) -> pa.Table:
    return csv.read_csv(
        pa.py_buffer(block),
        read_options=csv.ReadOptions(use_threads=False, autogenerate_column_names=True, block_size=len(block) + 1),
        parse_options=csv.ParseOptions(delimiter=" ", quote_char=False),
    )


def cpu_seconds(work: Callable[[Any], object], argument: object) -> float:
    start = time.process_time()
    work(argument)
    return time.process_time() - start


def measure(files: list[Path], repeats: int) -> dict[str, Any]:
    seconds = dict.fromkeys(("motionkit", "pymotion", "numpy_scipy", "pyarrow_csv"), 0.0)
    frames = num_bytes = 0
    blocks = [motion_block(path) for path in files]
    ours(files[0]), peer(files[0]), numpy_scipy(files[0]), arrow(blocks[0])
    best = [dict.fromkeys(seconds, float("inf")) for _ in files]
    for _ in range(repeats):
        parse_hierarchy.cache_clear()
        for name, work, arguments in (
            ("motionkit", ours, files),
            ("pymotion", peer, files),
            ("numpy_scipy", numpy_scipy, files),
            ("pyarrow_csv", arrow, blocks),
        ):
            for argument, quickest in zip(arguments, best, strict=True):
                quickest[name] = min(quickest[name], cpu_seconds(work, argument))
    for path, block, quickest in zip(files, blocks, best, strict=True):
        for name, value in quickest.items():
            seconds[name] += value
        frames += block.count(b"\n")
        num_bytes += path.stat().st_size
    return {
        "files": len(files),
        "frames": frames,
        "megabytes": round(num_bytes / 1e6, 2),
        "cpu_seconds": {name: round(value, 4) for name, value in seconds.items()},
        "megabytes_per_second": {name: round(num_bytes / 1e6 / value, 1) for name, value in seconds.items()},
        "frames_per_second": {name: round(frames / value) for name, value in seconds.items()},
        "times_pymotion": round(seconds["pymotion"] / seconds["motionkit"], 1),
        "times_numpy_scipy": round(seconds["numpy_scipy"] / seconds["motionkit"], 1),
    }


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("sources", nargs="+", type=Path)
    parser.add_argument("--files", type=int, default=20, help="at most this many files of a folder, evenly spread")
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    results: dict[str, Any] = {}
    for source in arguments.sources:
        files = sorted(source.rglob("*.bvh")) if source.is_dir() else [source]
        picked = [files[index] for index in np.linspace(0, len(files) - 1, min(arguments.files, len(files)), dtype=int)]
        results[source.name] = measure(picked, arguments.repeats)
    report = {"benchmark": "bvh", "machine": platform.processor() or platform.machine(), "sources": results}
    rates = ("motionkit MB/s", "pymotion MB/s", "numpy and scipy MB/s", "pyarrow CSV MB/s")
    table = Table("source", "files", "MB", *rates, "× pymotion", "× numpy and scipy")
    for name, result in results.items():
        rate = result["megabytes_per_second"]
        columns = (result["files"], result["megabytes"], *rate.values())
        table.add_row(name, *map(str, columns), str(result["times_pymotion"]), str(result["times_numpy_scipy"]))
    print_table_and_json(table, report)


if __name__ == "__main__":
    main()
