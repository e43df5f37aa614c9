"""Reading motions of a store: all in order, one at random, and copying them; beside duckdb and pyarrow on its parts.

The peers fetch the same frames of the same random sequences from the same Parquet files by a condition on
`sequence_index`, as somebody without motionkit would; positions are compared bit by bit. Processor time of one thread.

    python benchmarks/store/reads.py STORE [--sequences 300] [--json]
"""

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.dataset as ds
from rich.table import Table

from benchmarks.command import arguments_parser, print_json
from motionkit.cli.console import stdout
from motionkit.store import Store
from motionkit.store.life import merge
from motionkit.store.schema import FRAME_COLUMNS

Fetch = Callable[[int], np.ndarray]
PEER_READS = 20


@contextmanager
def timed(seconds: dict[str, float], what: str) -> Iterator[None]:
    begun = time.process_time()
    yield
    seconds[what] = time.process_time() - begun


def by_store(store: Store) -> Fetch:
    return lambda index: store.read(index).joint_positions


def by_duckdb(store: Store) -> Fetch:
    connection = duckdb.connect()
    connection.execute("SET threads = 1")
    sql = (
        f"SELECT num_frames, {', '.join(FRAME_COLUMNS)} FROM '{store.path}/motions/*.parquet' WHERE sequence_index = ?"
    )
    return lambda index: _positions(connection.sql(sql, params=[index]).to_arrow_table())


def by_pyarrow(store: Store) -> Fetch:
    parts = ds.dataset([str(store.path / name) for name in store.manifest.parts])
    columns = ["num_frames", *FRAME_COLUMNS]

    def fetch(index: int) -> np.ndarray:
        table = parts.to_table(columns, filter=ds.field("sequence_index") == index, use_threads=False)
        return _positions(table)

    return fetch


def _positions(motions: pa.Table) -> np.ndarray:
    num_frames = motions["num_frames"][0].as_py()
    flat = motions["joint_positions"].combine_chunks().flatten().to_numpy()
    return np.ascontiguousarray(flat.reshape(-1, num_frames).T).reshape(num_frames, -1, 3)


def measure(path: Path, num_reads: int) -> dict[str, Any]:
    seconds: dict[str, float] = {}
    with timed(seconds, "open"):
        store = Store.open(path)
    with timed(seconds, "table in pandas"):
        _ = store.sequences
    with timed(seconds, "every motion in order"):
        num_frames = sum(motion.num_frames for motion in store.read_many(store.select()))
    with tempfile.TemporaryDirectory() as folder, timed(seconds, "copy into another store"):
        merge(Path(folder) / "copy", [path])
    chosen = np.random.default_rng(0).choice(store.select(), num_reads).tolist()
    ways = {"Store.read": by_store(store), "duckdb": by_duckdb(store), "pyarrow": by_pyarrow(store)}
    rates = {}
    for name, fetch in ways.items():
        np.testing.assert_array_equal(fetch(chosen[0]), store.read(chosen[0]).joint_positions)
        some = chosen[1:] if name == "Store.read" else chosen[1 : 1 + PEER_READS]
        begun = time.process_time()
        for index in some:
            fetch(index)
        rates[name] = len(some) / (time.process_time() - begun)
    return {
        "sequences": store.num_sequences,
        "frames": num_frames,
        "frames_per_second_in_order": num_frames / seconds["every motion in order"],
        "seconds": seconds,
        "random_motions_per_second": rates,
    }


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("--sequences", type=int, default=300, help="number of random reads")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    report = measure(arguments.store, arguments.sequences)
    if arguments.json:
        print_json(report, arguments.store)
        return
    table = Table(title=f"{report['sequences']:,} sequences, {report['frames']:,} frames; one core")
    table.add_column("what")
    table.add_column("figure", justify="right")
    for what, taken in report["seconds"].items():
        table.add_row(what, f"{taken:.3f} s")
    table.add_row("frames a second in order", f"{report['frames_per_second_in_order']:,.0f}")
    for name, rate in report["random_motions_per_second"].items():
        table.add_row(f"random motions a second, {name}", f"{rate:,.1f}")
    stdout.print(table)


if __name__ == "__main__":
    main()
