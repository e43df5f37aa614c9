"""P9: peak memory of training the field on the same motions at 20 and at 250 fps (the paper's E.4).

    python -m benchmarks.nerm.memory [--minutes 10] [--steps 40] [--set KEY=VALUE …] [--json]

Two stores hold the same seconds of the same analytic motions at either framerate. Each is trained on by the stage
`field` (recipe `nano`, Fourier features) in a process of its own, after its cache was built in another. Three figures
of each: the memory that is the process's own (anonymous pages, its highest over the training), the peak resident set,
which also counts pages of the memory-mapped corpus that the kernel keeps at hand and takes back when it needs them,
and the bytes of one batch of poses.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from fractions import Fraction
from pathlib import Path

from benchmarks.command import arguments_parser, print_json

RATES = (20, 250)
TAKE_SECONDS = 20.0
MEGABYTE = 1_000_000


def write_corpus(path: Path, fps: int, minutes: float) -> None:
    """A store of analytic motions, the same ones at every framerate."""
    from motionkit.core.motion import Motion
    from motionkit.fields.motion_field import to_motion
    from motionkit.store.writer import StoreWriter
    from tests.helpers.analytic import ACTIONS, analytic_motion

    with StoreWriter.create(path) as writer:
        for index in range(max(1, round(minutes * 60 / TAKE_SECONDS))):
            performance = analytic_motion(list(ACTIONS)[index % len(ACTIONS)], TAKE_SECONDS, index)
            motion = to_motion(performance, Fraction(fps))
            plain = Motion(
                motion.joint_positions, motion.skeleton, motion.timegrid, split="train", sequence_id=f"{index}"
            )
            writer.add(plain)


def train_here(store: Path, runs: Path, settings: list[str]) -> dict[str, float]:
    """Train in this process; megabytes of its own memory and of its resident set, the highest of each."""
    import torch

    from motionkit.training.config import apply_overrides
    from motionkit.training.run import RunFolder, StageContext
    from nerm.field_training import train_field
    from nerm.recipes import nano

    torch.set_num_threads(1)
    config = apply_overrides(nano(), settings)
    peak = OwnMemory()
    with peak:
        train_field(StageContext(store, RunFolder(runs), "nano", device="cpu"), config)
    batch = config.field.schedule.batch_size * config.field.clips.num_poses * (3 * 22 * 4 + 8)
    return {
        "own_mb": peak.highest_mb,
        "resident_mb": status_mb("VmHWM"),
        "batch_mb": batch / MEGABYTE,
        "corpus_mb": sum(each.stat().st_size for each in store.glob("cache/*/positions.npy")) / MEGABYTE,
    }


class OwnMemory:
    """Peak anonymous memory of this process, sampled every 5 ms."""

    def __init__(self) -> None:
        self.highest_mb = 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> "OwnMemory":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._stop.is_set():
            self.highest_mb = max(self.highest_mb, status_mb("RssAnon"))
            time.sleep(0.005)


def status_mb(name: str) -> float:
    """A line of /proc/self/status in megabytes."""
    for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1]) * 1024 / MEGABYTE
    raise RuntimeError(f"/proc/self/status has no {name}: this benchmark needs Linux")


def measure(minutes: float, settings: list[str]) -> dict[int, dict[str, float]]:
    """Figures by framerate, each from a process that only trains."""
    found = {}
    with tempfile.TemporaryDirectory() as scratch:
        for fps in RATES:
            store = Path(scratch) / f"store-{fps}"
            write_corpus(store, fps, minutes)
            again = [sys.executable, __file__, "--store", str(store), "--runs", str(Path(scratch) / f"runs-{fps}")]
            again += [part for setting in settings for part in ("--set", setting)]
            # The first process builds the cache, which is not training; the second reads it.
            for last in ("first", "second"):
                done = subprocess.run([*again, "--run", last], capture_output=True, text=True, check=False)
                if done.returncode:
                    raise RuntimeError(done.stderr)
            found[fps] = json.loads(done.stdout.splitlines()[-1])
    return found


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="of motion in either store")
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="settings")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--store", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--runs", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--run", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    settings = [f"field.schedule.steps={arguments.steps}", "field.encoder.kind=fourier"]
    settings += arguments.settings
    if arguments.store is not None:
        print(json.dumps(train_here(arguments.store, arguments.runs / arguments.run, arguments.settings)))
        return
    figures = measure(arguments.minutes, settings)
    slow, fast = (figures[fps] for fps in RATES)
    ratios = {name: fast[name] / slow[name] for name in ("own_mb", "resident_mb")}
    if arguments.json:
        print_json({"minutes": arguments.minutes, "settings": settings, "figures": figures, "ratios": ratios})
        return
    print(f"{arguments.minutes:g} minutes of motion, {' '.join(settings)}; MB")
    print(f"{'fps':>5} {'own memory':>12} {'peak resident':>14} {'a batch':>9} {'corpus':>9}")
    for fps, each in figures.items():
        columns = f"{each['own_mb']:12.1f} {each['resident_mb']:14.1f} {each['batch_mb']:9.2f} {each['corpus_mb']:9.1f}"
        print(f"{fps:5} {columns}")
    print(f"250 fps against 20: own memory × {ratios['own_mb']:.3f}, peak resident × {ratios['resident_mb']:.3f}")


if __name__ == "__main__":
    main()
