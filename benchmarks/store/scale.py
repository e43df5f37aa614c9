"""Performance of a store of 100,000 sequences: opening, queries, sampling and writing.

    python -m benchmarks.store.scale [--sequences 100000] [--folder FOLDER]

The store is synthetic, written directly with `StoreWriter`: stretches of 40–400 frames (log-uniform, 22 joints, five
framerates, two captions each) of one smooth random walk. Everything is timed in a process of its own, after its
imports; wall time, files in the operating system's cache; the best of five unless called the first. Beside each figure
are its floor (the minimum work on the same bytes) and a peer on the same machine in the same run. A table goes to
stderr, JSON to stdout.
"""

import argparse
import json
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.command import arguments_parser, print_json
from benchmarks.store.clips import BATCH, copy_rate, frames_in_pandas, parquet_by_frame, rate
from motionkit.cli.console import stderr
from motionkit.core.motion import Caption, Motion, Provenance
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.store import Store, StoreWriter
from motionkit.store.cache import open_cache
from motionkit.store.schema import SEQUENCES_FILE

CLIP_FRAMES = 32
FRAMERATES = (Fraction(20), Fraction(30), Fraction(60), Fraction(100), Fraction(120))
QUERY = "SELECT fps, count(*), sum(duration_seconds) FROM {table} WHERE split = 'train' GROUP BY fps ORDER BY fps"
WHERE = "fps >= 60 AND duration_seconds > 2"
PEER_SEQUENCES = 2000
FLOOR_FRAMES = 1_000_000


def motions(count: int, generator: np.random.Generator) -> Iterator[Motion]:
    """Stretches of one walk, each moved and scaled by its own amount, so that no two hold the same bytes."""
    steps = generator.standard_normal((50_000, 22, 3), dtype=np.float32)
    walk = np.cumsum(np.cumsum(steps, axis=0) % 1.0 - 0.5, axis=0, dtype=np.float32) * np.float32(1e-3)
    lengths = np.exp(generator.uniform(np.log(40), np.log(400), count)).astype(int)
    starts = (generator.random(count) * (len(walk) - 400)).astype(int)
    for number, (start, length) in enumerate(zip(starts.tolist(), lengths.tolist(), strict=True)):
        positions = walk[start : start + length] * np.float32(1 + number * 1e-6)
        yield Motion(
            joint_positions=positions,
            skeleton=SMPL22,
            timegrid=TimeGrid(FRAMERATES[number % len(FRAMERATES)], length),
            captions=(
                Caption(f"a person walks along path number {number} and turns"),
                Caption("someone is walking about", 0.5, 1.0),
            ),
            split=("train", "train", "train", "val", "test")[number % 5],
            sequence_id=f"synthetic/subject-{number // 100:05d}/take-{number:07d}",
            provenance=Provenance(
                source="synthetic",
                subset=f"subject-{number // 100:05d}",
                source_path=f"subject-{number // 100:05d}/take-{number:07d}.npz",
                source_sha256=f"{number:064x}",
                source_format="npz",
            ),
        )


def memory_bytes() -> dict[str, int]:
    """This process's own memory, and its resident file pages, which the system can reclaim."""
    lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return {name: int(lines[key].split()[0]) * 1024 for name, key in (("own", "RssAnon"), ("files", "RssFile"))}


def build(path: Path, count: int) -> dict[str, Any]:
    """Write the store; memory after each hundredth."""
    own: list[int] = []
    begun, begun_cpu = time.perf_counter(), time.process_time()
    with StoreWriter.create(path) as writer:
        for number, motion in enumerate(motions(count, np.random.default_rng(0)), start=1):
            writer.add(motion)
            if number % max(1, count // 100) == 0:
                own.append(memory_bytes()["own"])
    tenth = max(1, len(own) // 10)
    first, last = float(np.median(own[:tenth])), float(np.median(own[-tenth:]))
    files = [entry for entry in path.rglob("*") if entry.is_file()]
    return {
        "seconds": time.perf_counter() - begun,
        "cpu_seconds": time.process_time() - begun_cpu,
        "bytes_on_disk": sum(entry.stat().st_size for entry in files),
        "table_bytes": (path / SEQUENCES_FILE).stat().st_size,
        "memory_first_tenth": first,
        "memory_last_tenth": last,
        "memory_growth": last / first,
    }


def best(work: Callable[[], object], repeats: int = 5) -> float:
    """Least wall time of a few runs, seconds."""
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        work()
        times.append(time.perf_counter() - begun)
    return min(times)


def measure_reader(path: Path) -> dict[str, Any]:
    """Time of opening, querying, selecting and reading, and the memory of all of it."""
    import pandas  # noqa: F401  imported before the clock starts

    before = memory_bytes()["own"]
    begun = time.perf_counter()
    store = Store.open(path)
    opened = time.perf_counter() - begun
    figures: dict[str, Any] = {"open_first": opened}
    begun = time.perf_counter()
    store.query(QUERY.format(table="sequences"))
    figures["query_first"] = time.perf_counter() - begun
    figures["memory_open_and_query"] = memory_bytes()["own"]
    figures["query"] = best(lambda: store.query(QUERY.format(table="sequences")))
    figures["select"] = best(lambda: store.select(WHERE))
    middle = store.num_sequences // 2
    sequence_id = str(store.sequences_table["sequence_id"][middle])
    figures["read_by_id"] = best(lambda: store.read(sequence_id))
    figures["memory_with_a_motion"] = memory_bytes()["own"]
    begun = time.perf_counter()
    len(store.sequences)
    figures["to_pandas"] = time.perf_counter() - begun
    figures["memory_with_pandas"] = memory_bytes()["own"]
    figures["memory_before"] = before
    figures["open"] = best(lambda: Store.open(path))
    return figures


def measure_peers(path: Path) -> dict[str, Any]:
    """The same queries on the same Parquet file, by pandas and by duckdb; and the time to read its bytes."""
    import duckdb
    import pandas as pd

    table = path / SEQUENCES_FILE
    figures: dict[str, Any] = {"open_floor_read_bytes": best(table.read_bytes)}
    before = memory_bytes()["own"]
    frame = pd.read_parquet(table)
    figures["pandas_memory"] = memory_bytes()["own"] - before
    figures["pandas_open"] = best(lambda: pd.read_parquet(table), 3)

    def ask() -> object:
        chosen = frame[frame["split"] == "train"]
        return chosen.groupby("fps")["duration_seconds"].agg(["count", "sum"])

    figures["pandas_query"] = best(ask)
    figures["duckdb_query_of_the_file"] = best(lambda: duckdb.sql(QUERY.format(table=f"'{table}'")).fetchall())
    columns = {name: frame[name].to_numpy() for name in ("fps", "duration_seconds")}
    train = (frame["split"] == "train").to_numpy()

    def floor() -> object:
        rates, group = np.unique(columns["fps"][train], return_inverse=True)
        return rates, np.bincount(group, columns["duration_seconds"][train]), np.bincount(group)

    figures["query_floor_numpy"] = best(floor)
    return figures


def build_cache(path: Path) -> dict[str, Any]:
    """The memory map for training, and the memory that making it took."""
    begun, begun_cpu = time.perf_counter(), time.process_time()
    cache = open_cache(Store.open(path))
    return {
        "cache_build_seconds": time.perf_counter() - begun,
        "cache_build_cpu_seconds": time.process_time() - begun_cpu,
        "cache_bytes": int(cache.positions.nbytes),
        "memory_building": memory_bytes()["own"],
    }


def measure_clips(path: Path) -> dict[str, Any]:
    """Clips a second of processor time out of the cache; the peers on its first sequences only."""
    store = Store.open(path)
    cache = open_cache(store)
    generator = np.random.default_rng(1)

    def batches(num_sequences: int, size: int, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
        drawn = []
        for _ in range(count):
            sequence = generator.integers(0, num_sequences, size)
            spare = cache.num_frames[sequence] - CLIP_FRAMES + 1
            drawn.append((sequence, (generator.random(size) * spare).astype(np.int64)))
        return drawn

    own = rate(lambda s, f: cache.gather_clips(s, f, CLIP_FRAMES), batches(cache.num_sequences, BATCH, 64), 2.0)
    memory = memory_bytes()
    floor, bandwidth = copy_rate(cache.positions[:FLOOR_FRAMES], CLIP_FRAMES, 1.0)
    figures = {
        "cache_open_seconds": best(lambda: open_cache(store)),
        "clips_per_second": own,
        "clips_floor_plain_copy": floor,
        "copy_bytes_per_second": bandwidth,
        "memory_sampling": memory["own"],
        "files_in_memory": memory["files"],
    }
    with tempfile.TemporaryDirectory() as folder:
        few = min(PEER_SEQUENCES, cache.num_sequences)
        small = Path(folder) / "store"
        with StoreWriter.create(small) as writer:
            for motion in store.read_many(range(few)):
                writer.add(motion)
        some = batches(few, 16, 4)
        by_frame = parquet_by_frame(Store.open(small), Path(folder) / "frames.parquet", CLIP_FRAMES)
        np.testing.assert_array_equal(by_frame(*some[0]), cache.gather_clips(*some[0], CLIP_FRAMES))
        figures["clips_parquet_by_frame"] = rate(by_frame, some, 1.0)
        figures["clips_pandas_by_frame"] = rate(frames_in_pandas(open_cache(Store.open(small)), CLIP_FRAMES), some, 1.0)
    return figures


STEPS: dict[str, Callable[..., dict[str, Any]]] = {
    "build": build,
    "reader": measure_reader,
    "peers": measure_peers,
    "cache": build_cache,
    "clips": measure_clips,
}


def alone(step: str, path: Path, *more: object) -> dict[str, Any]:
    """One step in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.store.scale", "--step", step, "--folder", str(path), *map(str, more)]
    figures: dict[str, Any] = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)
    return figures


def print_table(count: int, report: dict[str, dict[str, Any]]) -> None:
    build, reader, peers, cache, clips = (report[name] for name in ("build", "reader", "peers", "cache", "clips"))
    table = Table(title=f"{count:,} sequences, {build['bytes_on_disk'] / 1e9:.2f} GB")
    for heading in ("", "motionkit", "wanted", "floor", "peer"):
        table.add_column(heading, justify="left" if not heading else "right")
    table.add_row(
        "open",
        f"{reader['open_first']:.3f} s",
        "≤ 1 s",
        f"{peers['open_floor_read_bytes']:.3f} s, bytes alone",
        f"{peers['pandas_open']:.3f} s, pandas.read_parquet",
    )
    table.add_row(
        "SQL over the sequences",
        f"{reader['query']:.3f} s",
        "≤ 0.2 s",
        f"{peers['query_floor_numpy']:.3f} s, numpy on loaded columns",
        f"{peers['duckdb_query_of_the_file']:.3f} s duckdb on the file, {peers['pandas_query']:.3f} s pandas, loaded",
    )
    table.add_row(f"choose by SQL ({WHERE})", f"{reader['select']:.3f} s", "≤ 0.2 s", "", "")
    table.add_row("read a motion by id", f"{reader['read_by_id'] * 1e3:.1f} ms", "", "", "")
    table.add_row(
        "clips a second",
        f"{clips['clips_per_second']:,.0f}",
        "≥ 100,000",
        f"{clips['clips_floor_plain_copy']:,.0f}, plain copy",
        f"{clips['clips_parquet_by_frame']:,.0f} Parquet by frame, {clips['clips_pandas_by_frame']:,.0f} pandas",
    )
    table.add_row(
        "memory: opened, asked, read",
        f"{reader['memory_with_a_motion'] / 1e6:.0f} MB",
        "≤ 300 MB",
        f"{reader['memory_before'] / 1e6:.0f} MB, libraries alone",
        f"+{peers['pandas_memory'] / 1e6:.0f} MB, pandas.read_parquet",
    )
    table.add_row("memory: the table in pandas too", f"{reader['memory_with_pandas'] / 1e6:.0f} MB", "", "", "")
    table.add_row(
        "memory: sampling clips",
        f"{clips['memory_sampling'] / 1e6:.0f} MB",
        "≤ 300 MB",
        "",
        f"{clips['files_in_memory'] / 1e9:.2f} GB of the cache mapped",
    )
    table.add_row(
        f"memory: building the cache ({cache['cache_bytes'] / 1e9:.2f} GB in {cache['cache_build_seconds']:.0f} s)",
        f"{cache['memory_building'] / 1e6:.0f} MB",
        "",
        "",
        "",
    )
    table.add_row(
        "writing: memory, last tenth / first",
        f"{build['memory_growth']:.3f}",
        "≤ 1.1",
        f"{build['memory_first_tenth'] / 1e6:.0f} → {build['memory_last_tenth'] / 1e6:.0f} MB",
        "",
    )
    stderr.print(table)


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("--sequences", type=int, default=100_000)
    parser.add_argument("--folder", type=Path, help="where the store is made, and kept; by default a temporary folder")
    parser.add_argument("--step", choices=STEPS, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.step:
        more = [arguments.sequences] if arguments.step == "build" else []
        print(json.dumps(STEPS[arguments.step](arguments.folder, *more)))
        return
    with tempfile.TemporaryDirectory() as temporary:
        path = (arguments.folder or Path(temporary)) / f"store-{arguments.sequences}"
        report: dict[str, Any] = {"benchmark": "scale", "machine": platform.processor() or platform.machine()}
        report["sequences"] = arguments.sequences
        report["build"] = alone("build", path, "--sequences", arguments.sequences)
        for step in ("reader", "peers", "cache", "clips"):
            report[step] = alone(step, path)
    print_table(arguments.sequences, report)
    print_json(report)


if __name__ == "__main__":
    main()
