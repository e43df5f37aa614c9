"""P13: Startup time of `motionkit --help`, against an empty Python program and importing torch.

    python -m benchmarks.cli.startup [--repeats 10] [--json]

Each program runs in a fresh process; wall and CPU seconds (user and system) are medians. The first run of each is
dropped: it reads the files from disk.
"""

import resource
import shutil
import statistics
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.command import arguments_parser, print_json

PROGRAMS = {
    "python -c pass": [sys.executable, "-c", "pass"],
    "motionkit --help": [shutil.which("motionkit", path=str(Path(sys.executable).parent)) or "motionkit", "--help"],
    "python -c 'import typer, rich'": [sys.executable, "-c", "import typer, rich.console"],
    "python -c 'import torch'": [sys.executable, "-c", "import torch"],
}


def cpu_seconds_of_children() -> float:
    """User and system time of all processes that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def measure(command: list[str], repeats: int) -> dict[str, float]:
    """Median wall and CPU seconds of a command."""
    wall, cpu = [], []
    for _ in range(repeats + 1):
        started, before = time.perf_counter(), cpu_seconds_of_children()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        wall.append(time.perf_counter() - started)
        cpu.append(cpu_seconds_of_children() - before)
    return {"wall_seconds": statistics.median(wall[1:]), "cpu_seconds": statistics.median(cpu[1:])}


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    figures = {name: measure(command, arguments.repeats) for name, command in PROGRAMS.items()}
    if arguments.json:
        print_json({"repeats": arguments.repeats, "programs": figures})
        return
    print(f"{'program':34} {'wall s':>8} {'CPU s':>8}")
    for name, figure in figures.items():
        print(f"{name:34} {figure['wall_seconds']:8.3f} {figure['cpu_seconds']:8.3f}")


if __name__ == "__main__":
    main()
