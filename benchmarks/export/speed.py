"""Every export format on one store: CPU time, size against raw float32, memory after a tenth and at the end.

    python -m benchmarks.export.speed STORE [--formats bvh npz …] [--where SQL]

CPU seconds of one process, writing included; the baseline is reading the same motions and writing nothing. Raw is what
positions, rotations and root translation take as float32. Output goes to a temporary folder that is deleted. A table
goes to stderr, JSON to stdout.
"""

import itertools
import tempfile
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.command import arguments_parser, print_table_and_json
from motionkit.core.errors import UsageError
from motionkit.core.motion import Motion
from motionkit.edit.export import Outcome, Selection, export, export_kinds
from motionkit.store import Store

PAGE_BYTES = 4096


def resident_megabytes() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * PAGE_BYTES / 1e6


def raw_bytes(motion: Motion) -> int:
    arrays = (motion.joint_positions, motion.local_rotations, motion.root_translation)
    return sum(array.nbytes for array in arrays if array is not None)


def read_alone(selection: Selection) -> dict[str, Any]:
    start, total, num_bytes = time.process_time(), 0, 0
    for motion in selection.motions():
        total += motion.num_frames
        num_bytes += raw_bytes(motion)
    seconds = time.process_time() - start
    return {"format": "(reading alone)", "cpu_seconds": seconds, "frames_per_second": total / seconds, "raw": num_bytes}


def measure(name: str, store: Store, where: str | None, num_frames: int, raw: int) -> dict[str, Any]:
    kind = export_kinds()[name]
    selection = Selection(store, store.select(where), kind.fps)
    num_sequences = len(selection.indices)
    marks = (max(1, num_sequences // 10), num_sequences)
    counter, resident = itertools.count(1), dict.fromkeys(marks, 0.0)

    def on_outcome(_: Outcome) -> None:
        number = next(counter)
        if number in resident:
            resident[number] = resident_megabytes()

    with tempfile.TemporaryDirectory() as folder:
        start = time.process_time()
        report = export(selection, Path(folder) / "out", kind, on_outcome)
        seconds = time.process_time() - start
    return {
        "format": name,
        "cpu_seconds": seconds,
        "frames_per_second": num_frames / seconds,
        "sequences": report.num_sequences,
        "left_out": report.left_out_by_reason,
        "bytes": report.num_bytes,
        "of_raw": report.num_bytes / raw,
        "resident_megabytes_after_a_tenth": resident[marks[0]],
        "resident_megabytes_at_the_end": resident[marks[-1]],
    }


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("--formats", nargs="*", default=list(export_kinds()), choices=list(export_kinds()))
    parser.add_argument("--where")
    arguments = parser.parse_args()
    store = Store.open(arguments.store)
    selection = Selection(store, store.select(arguments.where))
    num_frames = sum(selection.table["num_frames"].to_pylist())
    results = [read_alone(selection)]
    for name in arguments.formats:
        try:
            results.append(measure(name, store, arguments.where, num_frames, results[0]["raw"]))
        except UsageError as error:
            Console(stderr=True).print(f"{name}: {error}")
    table = Table("format", "CPU s", "frames/s", "MB", "of raw", "MB resident after a tenth", "at the end")
    for row in results:
        table.add_row(
            row["format"],
            f"{row['cpu_seconds']:.1f}",
            f"{row['frames_per_second']:,.0f}",
            *((f"{row['bytes'] / 1e6:,.0f}", f"{row['of_raw']:.2f}") if "bytes" in row else ("", "")),
            *(
                (f"{row[key]:,.0f}" if key in row else "")
                for key in ("resident_megabytes_after_a_tenth", "resident_megabytes_at_the_end")
            ),
        )
    figures = {"store": str(arguments.store), "frames": num_frames, "results": results}
    print_table_and_json(table, figures, arguments.store)


if __name__ == "__main__":
    main()
