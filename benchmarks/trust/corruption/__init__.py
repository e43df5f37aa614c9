"""Changes of single bytes in motionkit's own files: each must be detected or harmless.

For every flip the commands that read the file are run in processes of their own. Each must either give what it gives
with undamaged files, or end with a message that names the file and leave everything as it was. A failure is reported as
KIND:SEED:NUMBER.
"""

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

from benchmarks.trust.corruption.kinds import KINDS, Kind
from benchmarks.trust.corruption.starts import make_start
from benchmarks.trust.corruption.trials import Tally, Trials
from benchmarks.trust.process import Commands
from benchmarks.trust.report import Case, Report
from eval.report.results import environment
from motionkit.store.workers import usable_cores

DEFAULT_SECONDS = 1800.0
MANY = 1 << 40


def run(seed: int, seconds: float, folder: Path) -> Report:
    """Flip bytes of every kind of file for about this long."""
    return run_flips(KINDS, seed, folder, seconds=seconds, lanes=usable_cores())


def run_flips(
    kinds: Sequence[Kind],
    seed: int,
    folder: Path,
    *,
    seconds: float = float("inf"),
    flips_each: int = MANY,
    lanes: int = 1,
) -> Report:
    """Flip as many bytes of each of these kinds, or for so long, in so many processes at once."""
    begun = time.monotonic()
    tallies = [Tally() for _ in kinds]
    with ExitStack() as stack, ThreadPoolExecutor(lanes) as pool:
        servers = [stack.enter_context(Commands()) for _ in range(lanes)]
        # Made once, for all to copy from.
        for name in dict.fromkeys(kind.start for kind in kinds):
            make_start(servers[0], folder, name)

        def work(lane: int) -> None:
            trials = Trials(servers[lane], folder, f"place-{lane}")
            for number in range(flips_each):
                for kind, tally in list(zip(kinds, tallies, strict=True))[lane::lanes]:
                    if time.monotonic() - begun > seconds:
                        return
                    trials.flip(kind, seed, number, tally)

        list(pool.map(work, range(lanes)))
    cases = tuple(
        Case(
            kind.name,
            tally.tried,
            tuple(tally.failures),
            {"detected": tally.detected, "harmless": tally.harmless, "seconds": round(tally.seconds, 1)},
        )
        for kind, tally in zip(kinds, tallies, strict=True)
    )
    return Report("corruption", seed, time.monotonic() - begun, cases, environment())
