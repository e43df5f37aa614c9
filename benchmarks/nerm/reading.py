"""Cost of reading a batch's poses: rows from the cache's file, from a memory map, and from one that releases its pages.

    python benchmarks/nerm/reading.py STORE [--repeats 60] [--json]

Windows of the recipe `nano` over the store's training split: CPU milliseconds a batch (drawn, read, encoded), of 256
windows × 8 random instants and of 1,024 clips of 32 neighbouring poses, and megabytes of files that have become
resident meanwhile.
"""

import mmap
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from benchmarks.command import arguments_parser, print_json
from motionkit.data.corpus import FrameValues
from motionkit.data.poses import WindowPoses
from motionkit.data.windows import PositionSource, Windows
from motionkit.store import Store
from motionkit.store.cache import PositionCache, open_cache
from motionkit.training.pose_vectors import uniform_of
from nerm.field.training import training_windows
from nerm.recipes import nano

MEGABYTE = 1_000_000
BATCHES = {"256 windows x 8 instants": (256, 8, False), "1024 clips of 32 poses": (1024, 32, True)}


@dataclass(frozen=True, eq=False)
class Mapped:
    """The same source without its `rows`: frames are gathered from the memory map."""

    positions: np.ndarray
    sequence_index: np.ndarray
    start_row: np.ndarray
    num_frames: np.ndarray
    fps_numerator: np.ndarray
    fps_denominator: np.ndarray

    @classmethod
    def of(cls, cache: PositionCache) -> "Mapped":
        return cls(**{name: getattr(cache, name) for name in cls.__dataclass_fields__})

    def give_back(self) -> None:
        """Release the map's pages from the process; the kernel keeps the file cached."""
        base = self.positions
        while isinstance(base, np.ndarray):
            base = base.base
        assert isinstance(base, mmap.mmap)
        base.madvise(mmap.MADV_DONTNEED)


def milliseconds(poses: WindowPoses, windows: Windows, batch: tuple[int, int, bool], repeats: int, after) -> float:
    """CPU milliseconds of a batch, including `after`; the first three are not counted."""
    size, num_poses, contiguous = batch
    generator = torch.Generator().manual_seed(0)
    rows = torch.randint(len(windows), (size,), generator=generator).numpy()
    for number in range(repeats + 3):
        if number == 3:
            started = time.process_time()
        poses.draw(rows, num_poses, uniform_of(generator), contiguous=contiguous)
        after()
    return 1000.0 * (time.process_time() - started) / repeats


def resident_file_mb() -> float:
    """Megabytes of files that are mapped into this process and resident."""
    for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
        if line.startswith("RssFile:"):
            return int(line.split()[1]) * 1024 / MEGABYTE
    raise RuntimeError("/proc/self/status has no RssFile: this benchmark needs Linux")


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("--repeats", type=int, default=60)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    config = nano().field
    cache = open_cache(Store.open(arguments.store), layout="smpl22", where=config.where)
    windows, mapped = training_windows(cache, config), Mapped.of(cache)
    ways: dict[str, tuple[PositionSource, object]] = {
        "file": (cache, lambda: None),
        "map, pages given back": (mapped, mapped.give_back),
        "map": (mapped, lambda: None),
    }
    rows = []
    for name, batch in BATCHES.items():
        for way, (source, after) in ways.items():
            mapped.give_back()
            before = resident_file_mb()
            poses = WindowPoses(windows, FrameValues.of_positions(source))
            cost = milliseconds(poses, windows, batch, arguments.repeats, after)
            rows.append({"batch": name, "read from": way, "ms": cost, "resident_mb": resident_file_mb() - before})
    if arguments.json:
        print_json({"windows": len(windows), "rows": rows}, arguments.store)
        return
    print(f"{'batch':26} {'read from':22} {'CPU ms':>8} {'resident MB':>12}")
    for row in rows:
        print(f"{row['batch']:26} {row['read from']:22} {row['ms']:8.2f} {row['resident_mb']:12.1f}")


if __name__ == "__main__":
    main()
