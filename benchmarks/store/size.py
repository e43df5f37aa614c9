"""P4: a store's size on disk against raw float32, beside `.npz`, channel-major zstd and zstd of the source text.

    python -m benchmarks.store.size SOURCE… [--every 10] [--json]

Every tenth sequence of the sources is stored by motionkit, and its positions and rotations are written by each peer.
The peers keep every bit; the store rounds to 2^-22 (0.24 µm).
"""

import io
import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
from rich.table import Table

from benchmarks.command import arguments_parser, print_json
from motionkit.cli.console import stdout
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import read, scan
from motionkit.store import StoreWriter

ZSTD = pa.Codec("zstd", compression_level=3)


def compressed(data: bytes) -> int:
    """Bytes after zstd 3."""
    return len(ZSTD.compress(data, asbytes=True))


def npz(arrays: list[np.ndarray]) -> int:
    """Bytes of `np.savez_compressed`."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, *arrays)
    return buffer.tell()


def shuffled(array: np.ndarray) -> int:
    """Bytes of all frames of a channel after another, bytes of equal significance together, zstd 3."""
    channels = np.ascontiguousarray(array.reshape(len(array), -1).T, np.float32).view(np.uint8)
    return compressed(np.ascontiguousarray(channels.reshape(-1, 4).T).tobytes())


def measure(sources: list[Path], every: int) -> dict[str, float]:
    """Bytes of each way as a share of raw float32."""
    options = ReadOptions()
    sizes = dict.fromkeys(("store", "npz", "channel-major, bytes shuffled, zstd 3", "source text, zstd 3"), 0)
    raw, files = 0, set()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "store"
        with StoreWriter.create(path) as writer:
            for item in scan(sources, options).items[::every]:
                motion = read(item, options)
                writer.add(motion)
                arrays = [motion.joint_positions]
                if motion.local_rotations is not None and motion.root_translation is not None:
                    arrays += [motion.local_rotations, motion.root_translation]
                raw += 4 * sum(array.size for array in arrays)
                sizes["npz"] += npz(arrays)
                sizes["channel-major, bytes shuffled, zstd 3"] += sum(map(shuffled, arrays))
                files.add(item.path)
        sizes["store"] = sum(entry.stat().st_size for entry in path.rglob("*") if entry.is_file())
    sizes["source text, zstd 3"] = sum(compressed(file.read_bytes()) for file in files)
    return {name: size / raw for name, size in sizes.items()} | {"raw megabytes": raw / 1e6}


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("sources", type=Path, nargs="+", help="files or folders, as for motionkit ingest")
    parser.add_argument("--every", type=int, default=10, help="take every n-th sequence")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    figures = measure(arguments.sources, arguments.every)
    if arguments.json:
        print_json({"every": arguments.every, "of_raw": figures})
        return
    megabytes = figures.pop("raw megabytes")
    table = Table("", "of raw float32", title=f"{megabytes:,.0f} MB of float32")
    for name, share in figures.items():
        table.add_row(name, f"{share:.3f}")
    stdout.print(table)


if __name__ == "__main__":
    main()
