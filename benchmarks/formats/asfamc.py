"""P2: AMC parsing: motionkit beside a plain Python line parser, in one process, on the same bytes.

    python -m benchmarks.formats.asfamc FOLDER [--files 12] [--repeats 3]

CPU seconds of one thread, best of the repeats. The plain parser is what the usual readers do: split each line, call
float() on each word, keep a dictionary per frame. A table goes to stderr, JSON to stdout.
"""

import platform
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.command import arguments_parser, best_cpu_seconds, print_table_and_json
from motionkit.io.asfamc import parse_amc, read_asfamc
from motionkit.io.registry import ReadOptions


def plain(data: bytes) -> list[dict[str, list[float]]]:
    frames: list[dict[str, list[float]]] = []
    for line in data.decode().splitlines():
        if line.startswith(("#", ":")) or not line.strip():
            continue
        words = line.split()
        if len(words) == 1 and words[0].isdigit():
            frames.append({})
        else:
            frames[-1][words[0]] = [float(word) for word in words[1:]]
    return frames


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--files", type=int, default=12)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    files = sorted(arguments.folder.rglob("*.amc"))
    files = [files[index] for index in np.linspace(0, len(files) - 1, min(arguments.files, len(files)), dtype=int)]
    options = ReadOptions(fps=Fraction(120))
    read_asfamc(files[0], options)
    seconds = dict.fromkeys(("parse", "plain_python_parse", "file_to_positions"), 0.0)
    frames = num_bytes = 0
    for path in files:
        data = path.read_bytes()
        num_bytes += len(data)
        frames += len(parse_amc(data, path)[0])
        seconds["parse"] += best_cpu_seconds(lambda data=data, path=path: parse_amc(data, path), arguments.repeats)
        seconds["plain_python_parse"] += best_cpu_seconds(lambda data=data: plain(data), arguments.repeats)
        seconds["file_to_positions"] += best_cpu_seconds(
            lambda path=path: read_asfamc(path, options), arguments.repeats
        )
    report: dict[str, Any] = {
        "benchmark": "asfamc",
        "machine": platform.processor() or platform.machine(),
        "files": len(files),
        "frames": frames,
        "megabytes": round(num_bytes / 1e6, 2),
        "cpu_seconds": {name: round(value, 4) for name, value in seconds.items()},
        "frames_per_second": {name: round(frames / value) for name, value in seconds.items()},
        "times_plain_python": round(seconds["plain_python_parse"] / seconds["parse"], 1),
    }
    table = Table("", "CPU s", "frames/s")
    for name, value in seconds.items():
        table.add_row(name, f"{value:.3f}", f"{frames / value:,.0f}")
    print_table_and_json(table, report)


if __name__ == "__main__":
    main()
