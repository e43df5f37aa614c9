"""Writers and readers of a store under concurrent access.

A sequence's frames are determined by its id, so readers can verify them. A writer adds and removes its sequences in
batches, so a reader must see all of a batch or nothing. A writer logs the beginning and end of each change; the log
survives it.
"""

import hashlib
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.core.errors import BusyError, StoreError
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.store import Store, StoreWriter
from motionkit.store.life import compact, remove
from motionkit.store.validate import faults

WRITTEN_ANEW = ("was written anew after it was opened", "was written to while it was checked")
BASE = "base-0-4"
LARGEST_BATCH = 4
SHORTEST, LONGEST = 20, 120
READ_AT_ONCE = 6
MOST_LIVE = 12
CHANCES = {"append": 0.6, "remove": 0.3, "compact": 0.1}
VALIDATE = 0.1


def motion_of(sequence_id: str) -> Motion:
    """The motion of an id: up to two seconds of random positions that a store holds exactly."""
    generator = np.random.default_rng(list(hashlib.sha256(sequence_id.encode()).digest()))
    num_frames = int(generator.integers(SHORTEST, LONGEST))
    positions = generator.integers(-2048, 2048, (num_frames, SMPL22.num_joints, 3)).astype(np.float32) / 1024
    return Motion(positions, SMPL22, TimeGrid(Fraction(60), num_frames), sequence_id=sequence_id)


def batch_ids(batch: str) -> list[str]:
    """The ids of a batch `WRITER-NUMBER-SIZE`."""
    return [f"{batch}/{place}" for place in range(int(batch.rpartition("-")[2]))]


def batches_of(ids: list[str]) -> dict[str, int]:
    """The batches of some ids, with the number of ids of each."""
    return Counter(sequence_id.rpartition("/")[0] for sequence_id in ids)


class Log:
    """A writer's log: a line before each change and a line after it."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def note(self, state: str, action: str, batch: str) -> None:
        """Append a line, flushed and closed on return."""
        with self.path.open("a", encoding="utf-8") as handle:
            handle.write(f"{state} {action} {batch}\n")


def read_log(path: Path) -> tuple[set[str], tuple[str, str] | None, int]:
    """Batches that must be in the store, the unfinished change, and the number of finished ones."""
    live: set[str] = set()
    pending, count = None, 0
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        state, action, batch = line.split(" ")
        pending = (action, batch) if state == "begin" else None
        if state == "done":
            count += 1
            (live.add if action == "append" else live.discard)(batch)
    return live, pending, count


def settle(store: Path, log: Log) -> set[str]:
    """Resolve the unfinished change of a killed writer; returns the writer's batches in the store."""
    _, pending, _ = read_log(log.path)
    if pending is not None:
        action, batch = pending
        there = batch in batches_of(ids_of(Store.open(store)))
        log.note("done" if there == (action == "append") else "failed", action, batch)
    return read_log(log.path)[0]


def log_of(store: Path, writer: str) -> Path:
    """The path of a writer's log."""
    return store.with_name(f"{writer}.log")


def create(store: Path) -> None:
    """Make the store, with a batch that stays."""
    with StoreWriter.create(store) as writer:
        for sequence_id in batch_ids(BASE):
            writer.add(motion_of(sequence_id))


def final_problems(store: Path, writers: Iterable[str]) -> list[str]:
    """Missing, unexpected or damaged sequences of a store after all processes have ended."""
    expected = {BASE}.union(*(settle(store, Log(log_of(store, writer))) for writer in writers))
    opened = Store.open(store)
    found, wanted = set(ids_of(opened)), {sequence_id for batch in expected for sequence_id in batch_ids(batch)}
    problems = [f"lost: {sequence_id}" for sequence_id in sorted(wanted - found)]
    problems += [f"removed, and there: {sequence_id}" for sequence_id in sorted(found - wanted)]
    problems += [f"{each} has other frames" for each in sorted(found) if not is_as_written(opened, each)]
    return problems + [f"in the end: {fault}" for fault in faults(store)]


def ids_of(store: Store) -> list[str]:
    """All ids of a store."""
    found: list[str] = store.sequences_table["sequence_id"].to_pylist()
    return found


def write(store: Path, writer: str, until: float, seed: int) -> dict[str, object]:
    """Add, remove and compact in turn until a time; counts of the changes and of conflicts with another writer."""
    log, generator = Log(log_of(store, writer)), np.random.default_rng(seed)
    live, counts = settle(store, log), Counter[str]()
    number = time.time_ns()
    for action in rounds(until, generator, list(CHANCES), list(CHANCES.values())):
        number += 1
        chosen = "append" if action == "remove" and not live else "remove" if len(live) > MOST_LIVE else action
        if chosen == "append":
            batch = f"{writer}-{number}-{generator.integers(1, LARGEST_BATCH + 1)}"
        else:
            batch = str(generator.choice(sorted(live))) if chosen == "remove" else "-"
        try:
            if chosen != "compact":
                log.note("begin", chosen, batch)
            change(store, chosen, batch)
        except BusyError:
            log.note("failed", chosen, batch)
            counts["busy"] += 1
            continue
        except StoreError as error:
            log.note("failed", chosen, batch)
            return {"counts": counts, "problems": [f"{chosen}: {error}"]}
        counts[chosen] += 1
        if chosen != "compact":
            log.note("done", chosen, batch)
            (live.add if chosen == "append" else live.discard)(batch)
    return {"counts": counts, "problems": []}


def change(store: Path, action: str, batch: str) -> None:
    """Do one thing to a store."""
    if action == "append":
        with StoreWriter.append(store) as writer:
            for sequence_id in batch_ids(batch):
                writer.add(motion_of(sequence_id))
    elif action == "remove":
        remove(store, batch_ids(batch))
    else:
        compact(store)


def read(store: Path, until: float, seed: int) -> dict[str, object]:
    """Open, list, read and validate until a time; counts and problems."""
    counts, problems, generator = Counter[str](), list[str](), np.random.default_rng(seed)
    for action in rounds(until, generator, ["read", "validate"], [1 - VALIDATE, VALIDATE]):
        try:
            found = list(faults(store)) if action == "validate" else looked_at(Store.open(store), generator)
        except StoreError as error:
            if not any(words in str(error) for words in WRITTEN_ANEW):
                problems.append(f"{action}: {error}")
            counts["written anew"] += 1
            continue
        counts[action] += 1
        problems += [f"{action}: {problem}" for problem in found]
    return {"counts": counts, "problems": problems}


def looked_at(store: Store, generator: np.random.Generator) -> list[str]:
    """Incomplete batches of a store, and those of a few of its sequences that do not match their ids."""
    ids = ids_of(store)
    found = [
        f"of the batch {batch} there are {count}"
        for batch, count in batches_of(ids).items()
        if count != len(batch_ids(batch))
    ]
    drawn: list[str] = generator.choice(ids, min(READ_AT_ONCE, len(ids)), replace=False).tolist()
    return found + [f"{each} has other frames" for each in drawn if not is_as_written(store, each)]


def is_as_written(store: Store, sequence_id: str) -> bool:
    """Whether a sequence has the frames that belong to its id."""
    return np.array_equal(store.read(sequence_id).joint_positions, motion_of(sequence_id).joint_positions)


def rounds(until: float, generator: np.random.Generator, actions: list[str], chances: list[float]) -> Iterator[str]:
    """Random actions until a time, at least one, with pauses."""
    yield str(generator.choice(actions, p=chances))
    while time.time() < until:
        time.sleep(float(generator.uniform(0.0, 0.02)))
        yield str(generator.choice(actions, p=chances))
