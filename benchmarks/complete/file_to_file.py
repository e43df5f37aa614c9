"""P12: `motionkit complete` from file to file: seconds and memory of clips of a minute to three hours.

    python -m benchmarks.complete.file_to_file [--minutes 1 10 60 180] [--fps 120] [--arguments "--run RUN"] [--json]

The clip is an analytic motion of the 22 joints at 30 fps, as BVH. Each figure is of a process of its own: wall seconds,
CPU seconds (user and system), peak resident memory. The baseline is a process that reads the clip's numbers and writes
as many as the result has, with the same parser and writer; the difference is the cost of completion.
"""

import resource
import shlex
import subprocess
import sys
import tempfile
import time
from fractions import Fraction
from pathlib import Path

from benchmarks.command import arguments_parser, print_json

PIECE_SECONDS = 60.0
FLOOR = """
import sys
from pathlib import Path
from motionkit.io import source_file
from motionkit.io.bvh import split_text
path, repeats = Path(sys.argv[1]), int(sys.argv[2])
head, body = split_text(path.read_bytes(), path)
table = source_file.read_table(body, head.num_frames, head.num_channels, path, head.frame_time_line + 1)
Path(sys.argv[3]).write_bytes(source_file.format_table(table.repeat(repeats, axis=0)))
"""
COMPLETE = "from motionkit.cli.app import main; main()"


def write_clip(path: Path, minutes: float) -> None:
    """A BVH file at 30 fps: a minute's motion, repeated forwards and backwards."""
    from motionkit.fields.motion_field import to_motion
    from motionkit.io.bvh import write_bvh
    from tests.helpers.analytic import analytic_motion

    field = analytic_motion("walk", PIECE_SECONDS)
    write_bvh(to_motion(field, Fraction(30)), path)
    head, _, body = path.read_text(encoding="utf-8").partition("MOTION\n")
    _, frame_time, *lines = body.strip().splitlines()
    count = round(minutes * 60 * 30)
    lines = [*lines, *lines[-2:0:-1]] * (count // (2 * len(lines) - 2) + 1)
    path.write_text(
        f"{head}MOTION\nFrames: {count}\n{frame_time}\n" + "\n".join(lines[:count]) + "\n", encoding="utf-8"
    )


def measure(command: list[str]) -> dict[str, float]:
    """Wall and CPU seconds and peak memory of a command."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    started = time.perf_counter()
    script = "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL, "
    script += "stderr=subprocess.DEVNULL); print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    done = subprocess.run([sys.executable, "-c", script, *command], check=True, capture_output=True, text=True)
    wall = time.perf_counter() - started
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"wall_seconds": wall, "cpu_seconds": cpu, "peak_megabytes": int(done.stdout) / 1000}


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("--minutes", type=float, nargs="+", default=[1.0, 10.0, 60.0, 180.0])
    parser.add_argument("--fps", type=int, default=120)
    parser.add_argument("--arguments", default="", help="Further arguments of motionkit complete.")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        clip, out = Path(folder) / "clip.bvh", Path(folder) / "out.bvh"
        for minutes in arguments.minutes:
            write_clip(clip, minutes)
            further = ["--fps", str(arguments.fps), "--out", str(out), "--overwrite", *shlex.split(arguments.arguments)]
            floor = [sys.executable, "-c", FLOOR, str(clip), str(arguments.fps // 30), str(out)]
            rows.append({"minutes": minutes, "what": "floor", **measure(floor)})
            made = [sys.executable, "-c", COMPLETE, "complete", str(clip), *further]
            rows.append({"minutes": minutes, "what": f"30 → {arguments.fps} fps", **measure(made)})
    if arguments.json:
        print_json({"arguments": arguments.arguments, "figures": rows})
        return
    print(f"{'minutes':>8}  {'':14} {'wall s':>8} {'CPU s':>8} {'peak MB':>8}")
    for row in rows:
        print(
            f"{row['minutes']:8g}  {row['what']:14} {row['wall_seconds']:8.2f} {row['cpu_seconds']:8.2f} "
            f"{row['peak_megabytes']:8.0f}"
        )


if __name__ == "__main__":
    main()
