"""P10: opening a store, SQL over its sequences and reading motions, beside pyarrow and duckdb on the same files.

    python -m benchmarks.store.opening [--sequences 100000] [--store STORE] [--json]

Without --store the store is synthetic: stretches of 40 to 400 frames of a random walk, 22 joints, five framerates, two
captions each. Everything is timed in this process after its imports, with the files in the system's cache: wall
seconds, the best of five unless called the first.
"""

import tempfile
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path

import duckdb
import numpy as np
import pyarrow.dataset as ds
import pyarrow.parquet as pq
from rich.table import Table

from benchmarks.command import arguments_parser, print_json
from motionkit.cli.console import stdout
from motionkit.core.files import SEQUENCES_FILE
from motionkit.core.motion import Caption, Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.store import Store, StoreWriter

FRAMERATES = (Fraction(20), Fraction(30), Fraction(60), Fraction(100), Fraction(120))
QUERY = "SELECT fps, count(*), sum(duration_seconds) FROM {table} WHERE split = 'train' GROUP BY fps ORDER BY fps"


def motions(count: int) -> Iterator[Motion]:
    """Stretches of one walk, each scaled by its own amount, so that no two hold the same bytes."""
    generator = np.random.default_rng(0)
    walk = np.cumsum(generator.standard_normal((50_000, 22, 3), dtype=np.float32) * np.float32(1e-3), axis=0)
    lengths = np.exp(generator.uniform(np.log(40), np.log(400), count)).astype(int)
    starts = (generator.random(count) * (len(walk) - 400)).astype(int)
    for number, (start, length) in enumerate(zip(starts.tolist(), lengths.tolist(), strict=True)):
        yield Motion(
            walk[start : start + length] * np.float32(1 + number * 1e-6),
            SMPL22,
            TimeGrid(FRAMERATES[number % len(FRAMERATES)], length),
            captions=(Caption(f"a person walks along path number {number}"), Caption("someone is walking", 0.5, 1.0)),
            split=("train", "train", "train", "val", "test")[number % 5],
            sequence_id=f"synthetic/subject-{number // 100:05d}/{number:07d}",
        )


def seconds(work: Callable[[], object], repeats: int = 5) -> float:
    """Least wall time of a few runs."""
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        work()
        times.append(time.perf_counter() - begun)
    return min(times)


def measure(path: Path) -> dict[str, float]:
    """Seconds of each way."""
    table = path / SEQUENCES_FILE
    figures = {"open, the first time": seconds(lambda: Store.open(path), 1)}
    figures["open"] = seconds(lambda: Store.open(path))
    figures["peer: pyarrow read_table"] = seconds(lambda: pq.read_table(table, use_threads=False))
    store = Store.open(path)
    figures["SQL, the first time"] = seconds(lambda: store.query(QUERY.format(table="sequences")), 1)
    figures["SQL"] = seconds(lambda: store.query(QUERY.format(table="sequences")))
    figures["peer: duckdb on the file"] = seconds(lambda: duckdb.sql(QUERY.format(table=f"'{table}'")).fetchall())
    parts = ds.dataset([str(path / name) for name in store.manifest.parts])
    middle = store.select()[store.num_sequences // 2]
    figures["read one motion"] = seconds(lambda: store.read(middle))
    condition = ds.field("sequence_index") == int(middle)
    figures["peer: pyarrow dataset, the same motion"] = seconds(lambda: parts.to_table(filter=condition))
    return figures


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("--sequences", type=int, default=100_000, help="size of the synthetic store")
    parser.add_argument("--store", type=Path)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = arguments.store or Path(folder) / "store"
        if arguments.store is None:
            with StoreWriter.create(path) as writer:
                for motion in motions(arguments.sequences):
                    writer.add(motion)
        count, figures = Store.open(path).num_sequences, measure(path)
    if arguments.json:
        print_json({"sequences": count, "seconds": figures})
        return
    table = Table("", "seconds", title=f"{count:,} sequences")
    for name, value in figures.items():
        table.add_row(name, f"{value:.4f}")
    stdout.print(table)


if __name__ == "__main__":
    main()
