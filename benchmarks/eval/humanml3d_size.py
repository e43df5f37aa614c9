"""Cost of ingest, training of every system and Table 2 on data of HumanML3D's size, and whether they resume.

    python -m benchmarks.eval.humanml3d_size [--clips 14616] [--folder FOLDER] [--budget 45s]

The motions are analytic, 2 to 9.8 s at 20 fps with captions and splits, in the published folder's form; their figures
say nothing of models. Every command runs in a process of its own. The training is stopped by a signal after a while and
started again by the same command, which must keep what was done. Beside seconds and memory stands what of it is
reading: the bytes of the store. A table goes to stderr, JSON to stdout.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from rich.table import Table

from eval.report.results import provenance
from motionkit.cli.console import stderr
from motionkit.core.motion import Caption
from motionkit.features import humanml3d
from motionkit.fields.motion_field import to_motion
from motionkit.io.humanml3d import HUMANML3D, Entry, write_humanml3d
from tests.helpers.analytic import ACTIONS, analytic_motion

MOTIONKIT = (sys.executable, "-c", "from motionkit.cli.app import main; main()")
INTERRUPTED = 130


def measured(folder: Path, *command: str, stop_after_seconds: float | None = None) -> dict[str, Any]:
    """Run a command in a folder: wall and processor seconds, peak memory, exit code; its stderr goes to a file."""
    with (folder / "stderr.txt").open("ab") as log:
        begun = time.perf_counter()
        process = subprocess.Popen((*MOTIONKIT, *command), cwd=folder, stdout=log, stderr=log)
        if stop_after_seconds is not None:
            time.sleep(stop_after_seconds)
            # Popen.terminate would lose the exit status; SIGINT is ignored by background processes of a script.
            os.kill(process.pid, signal.SIGTERM)
        _, status, usage = os.wait4(process.pid, 0)
    code = process.returncode = os.waitstatus_to_exitcode(status)
    if code not in ((0,) if stop_after_seconds is None else (0, INTERRUPTED)):
        tail = (folder / "stderr.txt").read_text(encoding="utf-8")[-2000:]
        raise SystemExit(f"motionkit {' '.join(command)} ended with {code}:\n{tail}")
    return {
        "command": "motionkit " + " ".join(command),
        "stopped": code == INTERRUPTED,
        "seconds": time.perf_counter() - begun,
        "cpu_seconds": usage.ru_utime + usage.ru_stime,
        "peak_memory_bytes": usage.ru_maxrss * 1024,
    }


def write_clips(folder: Path, clips: int) -> None:
    """Analytic motions as a folder of HumanML3D's form."""
    write_humanml3d(folder, map(_entry, range(clips)))


def _entry(number: int) -> Entry:
    action = list(ACTIONS)[number % len(ACTIONS)]
    field = analytic_motion(action, 2.0 + 0.05 * (number % 157), number)
    joints = humanml3d.process(to_motion(field, HUMANML3D.fps).joint_positions, "smpl22")
    split = ("train", "train", "train", "test", "train", "train", "val")[number % 7]
    captions = (Caption(f"a person does a {action}"), Caption(f"someone does a {action}"))
    return Entry(f"{number:06d}", joints, humanml3d.vectors(joints, "smpl22"), captions, split)


def stages_done(folder: Path) -> list[str]:
    """The stages whose summary is written."""
    return sorted(path.parent.name for path in folder.glob("runs/nano/*/summary.json"))


def main() -> None:
    """Write the folder, run the commands, print their costs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=14_616)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--budget", default="45s")
    parser.add_argument("--max-motions", type=int, default=16)
    parser.add_argument("--stop-after-seconds", type=float, default=120.0)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.folder or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        begun = time.perf_counter()
        if not (folder / "HumanML3D").is_dir():
            # In a process of its own: a command's peak memory begins with that of the process that starts it.
            with ProcessPoolExecutor(1, get_context("spawn")) as writer:
                writer.submit(write_clips, folder / "HumanML3D", arguments.clips).result()
        report: dict[str, Any] = {"clips": arguments.clips, "writing_seconds": time.perf_counter() - begun}
        train = ("train", "--for", "table:2", "--budget", arguments.budget)
        steps = [measured(folder, "ingest", "HumanML3D")]
        report["store_bytes"] = sum(path.stat().st_size for path in (folder / "store").rglob("*") if path.is_file())
        steps.append(measured(folder, *train, stop_after_seconds=arguments.stop_after_seconds))
        report["stages_when_stopped"] = stages_done(folder)
        steps.append(measured(folder, *train))
        report["stages"] = stages_done(folder)
        evaluate = ("eval", "--table", "2", "--features", "kinematic", "--motions", str(arguments.max_motions))
        steps.append(measured(folder, *evaluate))
        report |= {"steps": steps, "provenance": provenance(folder / "store")}
    table = Table("command", "wall s", "processor s", "peak memory, GB")
    for step in steps:
        numbers = (step["seconds"], step["cpu_seconds"], step["peak_memory_bytes"] / 1e9)
        name = step["command"] + (", stopped" if step["stopped"] else "")
        table.add_row(name, *(f"{number:.2f}" for number in numbers))
    stderr.print(table)
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
