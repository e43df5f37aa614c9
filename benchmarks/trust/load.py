"""Many processes on one store, and kills of workers and ranks: everyone must see and leave consistent data.

Two writers add, remove and compact, and are killed now and then; four readers open, read and validate. A worker of Ray
is killed midway through an ingest, which must give the same bytes; one of two ranks that train together, whose
training, resumed, must end with the same weights.
"""

import json
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.trust import cluster
from benchmarks.trust.process import REPOSITORY, one_thread
from benchmarks.trust.report import Case, Report
from eval.report.results import environment

DEFAULT_SECONDS = 60.0
NUM_WRITERS, NUM_READERS = 2, 4
PATIENCE_SECONDS = 300.0


def run(seed: int, seconds: float, folder: Path) -> Report:
    """Crowd a store for so many seconds, then kill workers of Ray and ranks, which takes a minute or two."""
    started = time.perf_counter()
    cases = (crowd(seed, seconds, folder / "crowd"), *cluster.cases(seed, folder))
    return Report("load", seed, time.perf_counter() - started, cases, environment())


def crowd(
    seed: int, seconds: float, folder: Path, num_writers: int = NUM_WRITERS, num_readers: int = NUM_READERS
) -> Case:
    """Run writers and readers on a store, kill writers now and then, and check the store at the end."""
    name = f"{num_writers} writers, {num_readers} readers"
    folder.mkdir(parents=True)
    command = [
        sys.executable,
        "-m",
        "benchmarks.trust.crowd",
        str(folder.absolute() / "store"),
        str(seconds),
        str(seed),
    ]
    numbers = ("--writers", str(num_writers), "--readers", str(num_readers))
    try:
        done = subprocess.run(
            [*command, *numbers],
            cwd=REPOSITORY,
            env=one_thread(),
            capture_output=True,
            text=True,
            timeout=seconds + PATIENCE_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Case(name, 0, ("a process hung",))
    if done.returncode:
        return Case(name, 0, (f"exit code {done.returncode}: {done.stderr.strip()}",))
    found = json.loads(done.stdout)
    counts, problems = found["counts"], found["problems"]
    reads = ("read", "validate", "written anew")
    figures = {"changes": found["changes"], "writers killed": found["kills"]}
    figures |= {name: counts.get(name, 0) for name in ("busy", *reads)}
    tried = found["changes"] + sum(counts.get(name, 0) for name in reads)
    if done.stderr:
        problems = [*problems, done.stderr.strip().splitlines()[-1]]
    return Case(name, tried, tuple(problems), figures)
