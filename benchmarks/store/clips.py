"""P3: random clips of native frames a second from a store's cache, beside plain copies, numpy memory maps and Arrow.

    python -m benchmarks.store.clips [--frames 500000] [--json]

All ways return the same frames, which is checked bit by bit; the peers have the same file of positions and its index
of rows, and check nothing. The floor copies as many bytes from one array to another. Processor time of one thread.
"""

import tempfile
import time
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pyarrow as pa
from rich.table import Table

from benchmarks.command import arguments_parser, print_json
from motionkit.cli.console import stdout
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.store import Store, StoreWriter
from motionkit.store.cache import PositionCache, open_cache

BATCH = 256
Gather = Callable[[np.ndarray, np.ndarray], np.ndarray]


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


def memmap_loop(cache: PositionCache, clip_frames: int) -> Gather:
    """A slice of a memory map for each clip, stacked."""
    positions, start_row = cache.positions, cache.start_row

    def gather(sequence: np.ndarray, start: np.ndarray) -> np.ndarray:
        return np.stack([positions[row : row + clip_frames] for row in start_row[sequence] + start])

    return gather


def memmap_fancy(cache: PositionCache, clip_frames: int) -> Gather:
    """One index of all rows of all clips into a memory map."""
    positions, start_row, frames = cache.positions, cache.start_row, np.arange(clip_frames)
    return lambda sequence, start: positions[(start_row[sequence] + start)[:, None] + frames]


def arrow_slices(cache: PositionCache, clip_frames: int) -> Gather:
    """Slices of one Arrow array over the same memory, stacked."""
    width = cache.positions[0].size
    values = pa.array(cache.positions.reshape(-1))
    start_row = cache.start_row

    def gather(sequence: np.ndarray, start: np.ndarray) -> np.ndarray:
        rows = (start_row[sequence] + start).tolist()
        clips = [values.slice(row * width, clip_frames * width).to_numpy() for row in rows]
        return np.stack(clips).reshape(len(rows), clip_frames, -1, 3)

    return gather


def plain_copies(cache: PositionCache, clip_frames: int) -> Gather:
    """The floor: copies of a batch's bytes, one after the other, wherever the clips lie."""
    block = BATCH * clip_frames
    blocks = np.array(cache.positions[: len(cache.positions) // block * block]).reshape(-1, block, 22, 3)
    target = np.empty_like(blocks[0])

    def copy(sequence: np.ndarray, _: np.ndarray) -> np.ndarray:
        np.copyto(target, blocks[int(sequence[0]) % len(blocks)])
        return target

    return copy


def rate(gather: Gather, batches: list[tuple[np.ndarray, np.ndarray]], seconds: float) -> float:
    """Clips a second of processor time, over at least `seconds` of it."""
    for sequence, start in batches:
        gather(sequence, start)
    clips, begun = 0, time.process_time()
    while time.process_time() - begun < seconds:
        for sequence, start in batches:
            gather(sequence, start)
        clips += len(batches) * BATCH
    return clips / (time.process_time() - begun)


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("--frames", type=int, default=500_000, help="size of the random store")
    parser.add_argument("--clip-frames", type=int, default=32)
    parser.add_argument("--seconds", type=float, default=1.0, help="processor time spent on each way")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    generator, length = np.random.default_rng(0), arguments.clip_frames
    with tempfile.TemporaryDirectory() as folder:
        cache = open_cache(make_store(Path(folder) / "store", arguments.frames, generator))
        batches = []
        for _ in range(64):
            sequence = generator.integers(0, cache.num_sequences, BATCH)
            start = (generator.random(BATCH) * (cache.num_frames[sequence] - length + 1)).astype(np.int64)
            batches.append((sequence, start))
        ways: dict[str, Gather] = {
            "motionkit cache": lambda sequence, start: cache.gather_clips(sequence, start, length),
            "memory map, a slice a clip": memmap_loop(cache, length),
            "memory map, fancy index": memmap_fancy(cache, length),
            "Arrow, a slice a clip": arrow_slices(cache, length),
        }
        expected = ways["motionkit cache"](*batches[0])
        for gather in ways.values():
            np.testing.assert_array_equal(gather(*batches[0]), expected)
        ways["floor: plain copies of as many bytes"] = plain_copies(cache, length)
        rates = {name: rate(gather, batches, arguments.seconds) for name, gather in ways.items()}
    if arguments.json:
        print_json({"clip_frames": length, "batch": BATCH, "clips_per_second": rates})
        return
    table = Table("way", "clips/s", "of motionkit's", title=f"random {length}-frame clips of 22 joints, one core")
    for name, value in rates.items():
        table.add_row(name, f"{value:,.0f}", f"{value / rates['motionkit cache']:.2f}")
    stdout.print(table)


if __name__ == "__main__":
    main()
