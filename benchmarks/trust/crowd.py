"""A store under two writers and four readers: `python -m benchmarks.trust.crowd STORE SECONDS SEED`.

Each is forked from this process, which has imported what they need and uses none of it itself before they have ended.
Writers are killed now and then, and replaced. Prints counts and problems as JSON.
"""

import argparse
import json
import os
import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np

from benchmarks.trust import store_users
from benchmarks.trust.store_users import log_of, read_log

SECONDS_BETWEEN_KILLS = (0.2, 4.0)


def crowd(store: Path, seconds: float, seed: int, num_writers: int, num_readers: int) -> dict[str, object]:
    """Run writers and readers for so many seconds; their counts and findings, and what is wrong at the end."""
    generator = np.random.default_rng(seed)
    os.waitpid(fork(partial(store_users.create, store), store.with_name("created")), 0)
    until = time.time() + seconds
    names = [f"writer{number}" for number in range(num_writers)]
    kills = 0

    number = count()

    def start(role: Callable[..., object], name: str, *arguments: object) -> int:
        return fork(partial(role, store, *arguments, until, seed + next(number)), store.with_name(f"{name}.json"))

    writers = {name: start(store_users.write, name, name) for name in names}
    readers = [start(store_users.read, f"reader{each}") for each in range(num_readers)]
    while (now := time.time()) < until:
        time.sleep(min(until - now, float(generator.uniform(*SECONDS_BETWEEN_KILLS))))
        if time.time() < until:
            name = str(generator.choice(names))
            os.kill(writers[name], signal.SIGKILL)
            os.waitpid(writers[name], 0)
            kills += 1
            writers[name] = start(store_users.write, f"{name}-{kills}", name)
    codes = {pid: os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) for pid in (*writers.values(), *readers)}
    problems = [f"a process ended with exit code {code}" for code in codes.values() if code]
    counts = Counter[str]()
    for path in sorted(store.parent.glob("*.json")):
        found = json.loads(path.read_text(encoding="utf-8"))
        counts.update(found["counts"])
        problems += found["problems"]
    problems += store_users.final_problems(store, names)
    changes = sum(read_log(log_of(store, name))[2] for name in names)
    return {"changes": changes, "kills": kills, "counts": dict(counts), "problems": problems}


def fork(work: Callable[[], object], result: Path) -> int:
    """Run `work` in a child, which writes its result as JSON; returns the child's process id."""
    pid = os.fork()
    if pid:
        return pid
    code = 1
    try:
        text = json.dumps(work())
        pending = result.with_suffix(".pending")
        pending.write_text(text, encoding="utf-8")
        pending.replace(result)
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("store", type=Path)
    parser.add_argument("seconds", type=float)
    parser.add_argument("seed", type=int)
    parser.add_argument("--writers", type=int, default=2)
    parser.add_argument("--readers", type=int, default=4)
    given = parser.parse_args()
    print(json.dumps(crowd(given.store, given.seconds, given.seed, given.writers, given.readers)))


if __name__ == "__main__":
    main()
