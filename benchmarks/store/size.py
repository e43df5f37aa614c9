"""Layouts of float columns in Parquet: size against raw float32, encoding and decoding speed, on real captures.

Every variant holds the same sequences, a plain list of float32 each, as any Parquet reader takes them;
what comes out is compared, bit by bit, with what went in (or with what was rounded, where the variant rounds).

    python benchmarks/store/size.py captures/cmu captures/bandai-namco captures/mixed-bvh [--every 5] [--json]
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from rich.table import Table

from benchmarks.command import arguments_parser, print_json
from motionkit.cli.console import stdout
from motionkit.io.reading import read
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import scan
from motionkit.store.schema import FLOAT_LIST, ROW_GROUP_FRAMES

# One sequence of one column, channels by frames.
Block = np.ndarray
Blocks = list[Block]
STORE_OPTIONS = {"compression": "zstd", "compression_level": 3, "use_dictionary": False}


@dataclass(frozen=True)
class Variant:
    """One way to write the blocks; `prepare` changes them first, `order` flattens one."""

    name: str
    options: dict[str, Any] = field(default_factory=lambda: dict(STORE_OPTIONS))
    split_bytes: bool = True
    row_group_frames: int = ROW_GROUP_FRAMES
    order: str = "C"
    prepare: Callable[[Blocks], Blocks] = lambda blocks: blocks


@dataclass(frozen=True)
class Figures:
    """Bytes on disk against raw float32, and megabytes of raw float32 per second of processor time."""

    ratio: float
    encode_mb_per_second: float
    decode_mb_per_second: float


def on_grid(bits: int) -> Callable[[Blocks], Blocks]:
    scale = np.float32(2.0**bits)
    return lambda blocks: [np.rint(block * scale) / scale for block in blocks]


def continuous_signs(blocks: Blocks) -> Blocks:
    """q and −q are the same rotation: each frame gets the sign nearer to the previous frame."""
    made = []
    for block in blocks:
        turns = block.reshape(-1, 4, block.shape[1])
        flips = np.where(np.einsum("jct,jct->jt", turns[..., 1:], turns[..., :-1]) < 0, -1, 1)
        signs = np.cumprod(np.insert(flips, 0, 1, axis=1), axis=1)
        made.append((turns * signs[:, None]).reshape(block.shape).astype(np.float32))
    return made


def variants(rotations: bool) -> list[Variant]:
    zstd = {"compression": "zstd", "use_dictionary": False}
    signs = [Variant("continuous signs of quaternions", prepare=continuous_signs)] if rotations else []
    return [
        Variant("pyarrow's defaults: snappy, dictionary", {}, split_bytes=False),
        Variant("zstd 3", {**zstd, "compression_level": 3}, split_bytes=False),
        Variant("zstd 3, bytes split, frame after frame", order="F"),
        Variant("zstd 3, bytes split, channel after channel, row groups of 65,536 frames", row_group_frames=65_536),
        Variant("the same, 2,048 frames"),
        *signs,
        Variant("zstd 1", {**zstd, "compression_level": 1}),
        Variant("zstd 9", {**zstd, "compression_level": 9}),
        Variant("pages of 8 MiB", {**STORE_OPTIONS, "data_page_size": 2**23}),
        *(
            Variant(f"on a grid of 2^-{bits}{' (the store, but for its pages)' * (bits == 22)}", prepare=on_grid(bits))
            for bits in (24, 22, 20)
        ),
    ]


def measure(variant: Variant, blocks: Blocks) -> Figures:
    blocks = variant.prepare(blocks)
    flat = [block.ravel(order="F" if variant.order == "F" else "C") for block in blocks]
    num_bytes = sum(values.nbytes for values in flat)
    schema = pa.schema([pa.field("values", FLOAT_LIST, nullable=False)])
    split = {"use_byte_stream_split": ["values.list.element"]} if variant.split_bytes else {}
    sink = pa.BufferOutputStream()
    begun = time.process_time()
    with pq.ParquetWriter(sink, schema, write_statistics=False, **variant.options, **split) as writer:
        ends = np.cumsum([block.shape[1] for block in blocks]) // variant.row_group_frames
        for group in np.split(np.arange(len(flat)), np.flatnonzero(np.diff(ends)) + 1):
            writer.write_table(_table([flat[number] for number in group], schema))
    encoded = time.process_time() - begun
    content = sink.getvalue()
    file = pq.ParquetFile(pa.BufferReader(content))
    begun = time.process_time()
    for group in range(file.num_row_groups):
        file.read_row_group(group, use_threads=False)
    decoded = time.process_time() - begun
    found = file.read()["values"].combine_chunks().flatten().to_numpy()
    np.testing.assert_array_equal(found, np.concatenate(flat))
    return Figures(content.size / num_bytes, num_bytes / 1e6 / encoded, num_bytes / 1e6 / decoded)


def _table(flat: Sequence[np.ndarray], schema: pa.Schema) -> pa.Table:
    offsets = np.cumsum([0, *(values.size for values in flat)], dtype=np.int32)
    lists = pa.ListArray.from_arrays(pa.array(offsets), pa.array(np.concatenate(flat)), type=FLOAT_LIST)
    return pa.Table.from_arrays([lists], schema=schema)


def blocks_of(sources: list[Path], every: int) -> dict[str, Blocks]:
    """Every n-th sequence, unrounded."""
    options = ReadOptions()
    blocks: dict[str, Blocks] = {"joint_positions": [], "joint_rotations": []}
    for item in scan(sources, options).items[::every]:
        motion = read(item, options)
        for column, frames in (
            ("joint_positions", motion.joint_positions),
            ("joint_rotations", motion.local_rotations),
        ):
            if frames is not None:
                blocks[column].append(np.ascontiguousarray(frames.reshape(len(frames), -1).T))
    return blocks


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("sources", type=Path, nargs="+", help="files or folders, as for motionkit ingest")
    parser.add_argument("--every", type=int, default=5, help="take every n-th sequence")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    report: dict[str, Any] = {"every": arguments.every, "columns": {}}
    for column, blocks in blocks_of(arguments.sources, arguments.every).items():
        figures = {
            variant.name: vars(measure(variant, blocks)) for variant in variants(rotations=column == "joint_rotations")
        }
        report["columns"][column] = {"raw_mb": sum(block.nbytes for block in blocks) / 1e6, "variants": figures}
    if arguments.json:
        print_json(report)
        return
    for column, found in report["columns"].items():
        table = Table(title=f"{column}: {found['raw_mb']:.0f} MB of float32, one core")
        table.add_column("layout")
        for heading in ("of raw", "encode MB/s", "decode MB/s"):
            table.add_column(heading, justify="right")
        for name, row in found["variants"].items():
            numbers = (row["encode_mb_per_second"], row["decode_mb_per_second"])
            table.add_row(name, f"{row['ratio']:.3f}", *(f"{number:,.0f}" for number in numbers))
        stdout.print(table)


if __name__ == "__main__":
    main()
