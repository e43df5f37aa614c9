"""P5: `motionkit ingest` by one worker and by two: wall time, processor time, and the same store, byte for byte.

    python -m benchmarks.store.ingest SOURCE… [--workers 2] [--repeats 3] [--peer-files 12]

Whole commands, from the start of Python to the commit, in turn, once the sources are in memory; the least wall
and processor time (all processes together) of each count, since other work on the machine only adds.
The floor is reading the sources' bytes, hashing them, and compressing as many bytes as the store's frames have, on one
core. The peer is upc-pymotion reading a sample of the BVH files among the sources, one `.npz` written for
each, in this process. A table goes to stderr, JSON to stdout.
"""

import ctypes
import hashlib
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.command import arguments_parser, print_json

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pyarrow as pa
from rich.table import Table

from motionkit.cli.console import stderr
from motionkit.store import Store


def run(sources: list[Path], store: Path, workers: int) -> dict[str, float]:
    """One command; wall time, and processor time of it and its workers."""
    command = [sys.executable, "-m", "motionkit", "ingest", *map(str, sources)]
    command += ["--store", str(store), "--workers", str(workers), "--json"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begun = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wall = time.perf_counter() - begun
    wait_for_orphans()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {"wall": wall, "cpu": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime}


def warm(sources: list[Path]) -> None:
    """Read every file once, so that the first command does not wait for the disk where the others don't."""
    for source in sources:
        for path in [source] if source.is_file() else source.rglob("*"):
            if path.is_file():
                path.read_bytes()


def adopt_orphans() -> None:
    """Become the workers' parent, so that their time is counted: their server briefly outlives the command."""
    set_child_subreaper = 36  # prctl, Linux
    ctypes.CDLL(None).prctl(set_child_subreaper, 1, 0, 0, 0)


def wait_for_orphans() -> None:
    """Wait until the last of them has ended."""
    while True:
        try:
            os.wait()
        except ChildProcessError:
            return


def floor_seconds(sources: list[Path], store: Store) -> tuple[float, int]:
    """Read and hash every file, compress one part's worth of frames again and again; and the sources' size."""
    begun, num_bytes = time.process_time(), 0
    for source in sources:
        for path in [source] if source.is_file() else sorted(source.rglob("*")):
            if path.is_file():
                data = path.read_bytes()
                hashlib.sha256(data).digest()
                num_bytes += len(data)
    read = time.process_time() - begun
    motion = store.read(0)
    frames = np.ascontiguousarray(motion.joint_positions.reshape(motion.num_frames, -1).T).view(np.uint8)
    # Split into byte streams, as Parquet does before it compresses.
    streams = pa.py_buffer(np.ascontiguousarray(frames.reshape(-1, 4).T))
    codec = pa.Codec("zstd", compression_level=3)
    begun = time.process_time()
    codec.compress(streams)
    table = store.columns("num_frames", "num_joints", "has_rotations")
    values = table["num_frames"] * table["num_joints"] * (3 + 4 * table["has_rotations"])
    return read + (time.process_time() - begun) * float(values.sum()) * 4 / streams.size, num_bytes


def peer_seconds_per_megabyte(sources: list[Path], count: int, folder: Path) -> float | None:
    """upc-pymotion from BVH to an .npz of positions."""
    import pymotion.ops.skeleton as peer_skeleton
    from pymotion.io.bvh import BVH

    files = sorted(path for source in sources if source.is_dir() for path in source.rglob("*.bvh"))
    if not files:
        return None
    picked = [files[index] for index in np.linspace(0, len(files) - 1, min(count, len(files)), dtype=int)]
    begun = time.process_time()
    for path in picked:
        file = BVH()
        file.load(str(path))
        rotations, places, parents, offsets, _, _ = file.get_data()
        positions = peer_skeleton.fk(rotations, places[:, 0], offsets, parents)[0]
        np.savez_compressed(folder / "peer.npz", positions=positions, rotations=rotations)
    return (time.process_time() - begun) / sum(path.stat().st_size for path in picked) * 1e6


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("sources", nargs="+", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--peer-files", type=int, default=12)
    arguments = parser.parse_args()
    adopt_orphans()
    warm(arguments.sources)
    runs: dict[int, list[dict[str, float]]] = {1: [], arguments.workers: []}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for repeat in range(arguments.repeats):
            for workers, done in runs.items():
                done.append(run(arguments.sources, folder / f"{repeat}-{workers}", workers))
        stores = [Store.open(path) for path in folder.iterdir()]
        assert len({store.fingerprint for store in stores}) == 1, "the stores differ"
        floor, num_bytes = floor_seconds(arguments.sources, stores[0])
        peer = peer_seconds_per_megabyte(arguments.sources, arguments.peer_files, folder)
        sequences, frames = stores[0].num_sequences, stores[0].num_frames
    best = {workers: {key: min(run[key] for run in done) for key in ("wall", "cpu")} for workers, done in runs.items()}
    one, more = best[1], best[arguments.workers]
    report: dict[str, Any] = {
        "benchmark": "ingest",
        "machine": platform.processor() or platform.machine(),
        "sequences": sequences,
        "frames": frames,
        "megabytes": num_bytes / 1e6,
        "runs": runs,
        "best": best,
        "wall_ratio": one["wall"] / more["wall"],
        "cpu_ratio": more["cpu"] / one["cpu"],
        "floor_cpu_seconds": floor,
        "peer_cpu_seconds_per_megabyte": peer,
    }
    table = Table(title=f"ingest of {sequences:,} sequences, {frames:,} frames, {num_bytes / 1e6:,.0f} MB")
    for heading in ("", "wall s", "CPU s", "source MB per CPU s"):
        table.add_column(heading, justify="left" if not heading else "right")
    for workers, figures in best.items():
        rate = f"{num_bytes / 1e6 / figures['cpu']:.0f}"
        table.add_row(f"--workers {workers}", f"{figures['wall']:.2f}", f"{figures['cpu']:.2f}", rate)
    table.add_row("floor: read, hash, compress", "", f"{floor:.2f}", f"{num_bytes / 1e6 / floor:.0f}")
    if peer is not None:
        table.add_row("peer: upc-pymotion to .npz, a sample", "", "", f"{1 / peer:.1f}")
    table.caption = f"wall time of one worker over that of {arguments.workers}: {report['wall_ratio']:.2f}"
    stderr.print(table)
    print_json(report)


if __name__ == "__main__":
    main()
