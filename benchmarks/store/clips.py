"""Random clips of native frames a second: from the cache, from Parquet as the record holds it, from Parquet by frame.

    python benchmarks/store/clips.py [--frames 500000] [--json]

The floor is a plain copy of the same bytes from one array to another. Every way returns the same frames, which is
checked bit by bit.
"""

import tempfile
import time
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from rich.table import Table

from benchmarks.command import arguments_parser, print_json
from motionkit.cli.console import stdout
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.store import Store, StoreWriter
from motionkit.store.cache import PositionCache, open_cache

Gather = Callable[[np.ndarray, np.ndarray], np.ndarray]
BATCH = 256


def make_store(path: Path, num_frames: int, generator: np.random.Generator) -> Store:
    """Random walks of 40 … 5,000 frames on 22 joints."""
    left = num_frames
    with StoreWriter.create(path) as writer:
        while left > 0:
            length = int(generator.integers(40, 5000))
            positions = np.cumsum(generator.standard_normal((length, 22, 3), dtype=np.float32) * 0.01, axis=0)
            grid = TimeGrid(Fraction(120), length)
            writer.add(Motion(positions, SMPL22, grid, sequence_id=f"walk-{writer.num_sequences}"))
            left -= length
    return Store.open(path)


def parquet_by_frame(store: Store, path: Path, clip_frames: int) -> Gather:
    """A row per frame, a row group per sequence, as LeRobot v3 lays it out; zstd and byte stream split."""
    schema = pa.schema([pa.field("positions", pa.list_(pa.field("element", pa.float32(), nullable=False)))])
    options = {
        "compression": "zstd",
        "use_dictionary": False,
        "use_byte_stream_split": ["positions.list.element"],
    }
    with pq.ParquetWriter(path, schema, **options) as writer:
        for motion in store.read_many(range(store.num_sequences)):
            flat = motion.joint_positions.reshape(motion.num_frames, -1)
            offsets = pa.array(np.arange(0, flat.size + 1, flat.shape[1], dtype=np.int32))
            rows = pa.ListArray.from_arrays(offsets, pa.array(flat.ravel()), type=schema.field(0).type)
            writer.write_table(pa.Table.from_arrays([rows], schema=schema), row_group_size=motion.num_frames)
    file = pq.ParquetFile(path)

    def gather(sequence: np.ndarray, start: np.ndarray) -> np.ndarray:
        clips = np.empty((len(sequence), clip_frames, 22, 3), np.float32)
        for i, (group, first) in enumerate(zip(sequence, start, strict=True)):
            rows = file.read_row_group(int(group)).column(0).slice(int(first), clip_frames).combine_chunks()
            clips[i] = rows.flatten().to_numpy().reshape(clip_frames, 22, 3)
        return clips

    return gather


def frames_in_pandas(cache: PositionCache, clip_frames: int) -> Gather:
    """One data frame with a row per frame, in memory, indexed by (sequence, frame)."""
    owner = np.repeat(np.arange(cache.num_sequences), cache.num_frames)
    frame = np.arange(len(owner)) - np.repeat(cache.start_row, cache.num_frames)
    index = pd.MultiIndex.from_arrays([owner, frame])
    table = pd.DataFrame(cache.positions.reshape(len(owner), -1), index=index)

    def gather(sequence: np.ndarray, start: np.ndarray) -> np.ndarray:
        clips = [
            table.loc[(n, first) : (n, first + clip_frames - 1)].to_numpy()
            for n, first in zip(sequence, start, strict=True)
        ]
        return np.stack(clips).reshape(len(clips), clip_frames, 22, 3)

    return gather


def rate(gather: Gather, batches: list[tuple[np.ndarray, np.ndarray]], seconds: float) -> float:
    """Clips a second of processor time, over at least `seconds` of it."""
    for sequence, start in batches[:2]:
        gather(sequence, start)
    clips, begun = 0, time.process_time()
    while time.process_time() - begun < seconds:
        for sequence, start in batches:
            gather(sequence, start)
            clips += len(sequence)
            if time.process_time() - begun > 4 * seconds:
                break
    return clips / (time.process_time() - begun)


def copy_rate(positions: np.ndarray, clip_frames: int, seconds: float) -> tuple[float, float]:
    """The floor: clips a second, and bytes a second, of plain copies of a batch's bytes out of all of them."""
    block = BATCH * clip_frames
    frames = np.array(positions[: len(positions) // block * block]).reshape(-1, block, 22, 3)
    target = np.empty_like(frames[0])
    copies, begun = 0, time.process_time()
    while time.process_time() - begun < seconds:
        for source in frames:
            np.copyto(target, source)
        copies += len(frames)
    per_second = copies / (time.process_time() - begun)
    return per_second * BATCH, per_second * target.nbytes


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("--frames", type=int, default=500_000, help="size of the random store")
    parser.add_argument("--clip-frames", type=int, default=32)
    parser.add_argument("--seconds", type=float, default=1.0, help="processor time spent on each way")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    generator = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        store = make_store(Path(folder) / "store", arguments.frames, generator)
        cache = open_cache(store)
        length = arguments.clip_frames
        batches = []
        for _ in range(64):
            sequence = generator.integers(0, cache.num_sequences, BATCH)
            start = (generator.random(BATCH) * (cache.num_frames[sequence] - length + 1)).astype(np.int64)
            batches.append((sequence, start))
        ways: dict[str, Gather] = {
            "motionkit cache": lambda sequence, start: cache.gather_clips(sequence, start, length),
            "Parquet, row per frame, row group per sequence": parquet_by_frame(
                store, Path(folder) / "frames.parquet", length
            ),
            "pandas, row per frame, in memory": frames_in_pandas(cache, length),
        }
        few = (batches[0][0][:8], batches[0][1][:8])
        expected = ways["motionkit cache"](*few)
        for gather in ways.values():
            np.testing.assert_array_equal(gather(*few), expected)
        floor, bandwidth = copy_rate(cache.positions, length, arguments.seconds)
        rates = {"floor: plain copy of the same bytes": floor}
        for name, gather in ways.items():
            some = batches if name == "motionkit cache" else [(s[:16], f[:16]) for s, f in batches[:4]]
            rates[name] = rate(gather, some, arguments.seconds)
    report = {
        "clip_frames": length,
        "batch": BATCH,
        "store_frames": len(cache.positions),
        "copy_bytes_per_second": bandwidth,
        "clips_per_second": rates,
    }
    if arguments.json:
        print_json(report)
        return
    table = Table(title=f"random {length}-frame clips of 22 joints, one core ({bandwidth / 1e9:.1f} GB/s of copying)")
    table.add_column("way")
    table.add_column("clips/s", justify="right")
    table.add_column("of the floor", justify="right")
    for name, value in rates.items():
        table.add_row(name, f"{value:,.0f}", f"{value / floor:.3f}")
    stdout.print(table)


if __name__ == "__main__":
    main()
