"""BVH file → joint positions: motionkit, upc-pymotion, and pyarrow's CSV reader on the numbers alone, in one process.

    python -m benchmarks.formats.bvh FILE_OR_FOLDER… [--files 20] [--repeats 3]

CPU seconds of one thread. In a repeat each of the three reads all files, as a corpus is read; it begins with no header
remembered, so that the first file of a corpus pays for the header that the others share. The best repeat of each file
counts. A table goes to stderr, JSON to stdout. `pyarrow` parses the same motion block as a table of float64 columns,
which is the floor under any reader that goes through Arrow; it computes no rotation and no position.
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

from motionkit.io.bvh import text
from motionkit.io.bvh.document import read_bvh

pa.set_cpu_count(1)


def ours(path: Path) -> np.ndarray:
    return read_bvh(path).joint_positions


def peer(path: Path) -> np.ndarray:
    file = BVH()
    file.load(str(path))
    rotations, places, parents, offsets, _, _ = file.get_data()
    positions: np.ndarray = peer_skeleton.fk(rotations, places[:, 0], offsets, parents)[0]
    return positions


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
    seconds = dict.fromkeys(("motionkit", "pymotion", "pyarrow_csv"), 0.0)
    frames = num_bytes = 0
    blocks = [motion_block(path) for path in files]
    ours(files[0]), peer(files[0]), arrow(blocks[0])
    best = [dict.fromkeys(seconds, float("inf")) for _ in files]
    for _ in range(repeats):
        text.parsed.cache_clear()
        for name, work, arguments in (
            ("motionkit", ours, files),
            ("pymotion", peer, files),
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
    table = Table("source", "files", "MB", "motionkit MB/s", "pymotion MB/s", "pyarrow CSV MB/s", "× pymotion")
    for name, result in results.items():
        rate = result["megabytes_per_second"]
        columns = (result["files"], result["megabytes"], rate["motionkit"], rate["pymotion"], rate["pyarrow_csv"])
        table.add_row(name, *map(str, columns), str(result["times_pymotion"]))
    print_table_and_json(table, report)


if __name__ == "__main__":
    main()
