"""The one training loop: deterministic in (seed, step), resumed exactly, interrupted safely.

A step draws everything random from the generator it is given, which depends on (seed, purpose, step) alone; together
with the tensors of `Trainable.state_tensors` the step number is the whole state of a training, so a run that was
interrupted and resumed equals one that was not, bit by bit.
"""

import signal
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Protocol, runtime_checkable

import torch

from motionkit.console import progress
from motionkit.training.randomness import step_generator
from motionkit.training.run import RunError, StageFolder
from motionkit.training.tensors import CheckpointError, load_tensors, prefixed, save_tensors, unprefixed


@runtime_checkable
class Trainable(Protocol):
    """Something that gets better step by step."""

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, torch.Tensor]:
        """Do one whole step (batch, loss, optimiser) and return its figures as scalar tensors.

        `step` counts from 0; all randomness comes from `generator` (on the CPU).
        """
        ...

    def state_tensors(self) -> dict[str, torch.Tensor]:
        """All that a later step depends on: weights, optimiser moments, averages."""
        ...

    def load_state_tensors(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Go back to the state that `state_tensors` gave."""
        ...


def train_loop(
    trainable: Trainable,
    folder: StageFolder,
    *,
    steps: int,
    seed: int,
    log_every: int = 50,
    checkpoint_seconds: float = 60.0,
) -> dict[str, float]:
    """Train to `steps`, from the folder's checkpoint where there is one; returns the last logged figures.

    Figures are means over the steps since the last line of metrics.jsonl. Ctrl-C ends the current step, saves a
    checkpoint and raises `KeyboardInterrupt`. Raises `RunError` where a loss is not finite (the last checkpoint stays)
    and `CheckpointError` where the checkpoint is of something else.
    """
    purpose = folder.path.name
    first, sums = _restore(trainable, folder)
    latest = folder.read_metrics()[-1] if folder.read_metrics() else {}
    started, saved = time.perf_counter(), time.perf_counter()
    with progress() as display, _interrupts() as interrupted:
        task = display.add_task(purpose, total=steps, completed=first, note="")
        for step in range(first, steps):
            for name, value in trainable.step(step, step_generator(seed, purpose, step)).items():
                sums[name] = sums.get(name, torch.zeros((), dtype=torch.float64)) + value.detach().to(
                    "cpu", torch.float64
                )
            done = step + 1
            stop = interrupted.is_set()
            save = done == steps or stop or time.perf_counter() - saved > checkpoint_seconds
            if save or done % log_every == 0:
                _check_finite(folder, sums, done)
            if done % log_every == 0 or done == steps:
                latest = _log(folder, sums, done, log_every, time.perf_counter() - started)
                sums = {}
                display.update(task, note=" ".join(f"{name} {latest[name]:.4g}" for name in list(latest)[2:5]))
            if save:
                tensors = prefixed("state", trainable.state_tensors()) | prefixed("sums", sums)
                save_tensors(folder.checkpoint_path, tensors, {"step": done, "stage": purpose})
                saved = time.perf_counter()
            if stop:
                raise KeyboardInterrupt
            display.advance(task)
    return latest


def _restore(trainable: Trainable, folder: StageFolder) -> tuple[int, dict[str, torch.Tensor]]:
    if not folder.checkpoint_path.is_file():
        folder.truncate_metrics(0)
        return 0, {}
    tensors, description = load_tensors(folder.checkpoint_path)
    if description.get("stage") != folder.path.name:
        raise CheckpointError(f"{folder.checkpoint_path} is of stage {description.get('stage')!r}")
    trainable.load_state_tensors(unprefixed("state", tensors))
    step = int(description["step"])
    folder.truncate_metrics(step)
    return step, unprefixed("sums", tensors)


def _log(
    folder: StageFolder, sums: Mapping[str, torch.Tensor], done: int, log_every: int, seconds: float
) -> dict[str, float]:
    count = (done - 1) % log_every + 1
    means = {name: float(total) / count for name, total in sums.items()}
    line = {"step": float(done), "seconds": round(seconds, 3), **means}
    folder.append_metrics(line)
    return line


def _check_finite(folder: StageFolder, sums: Mapping[str, torch.Tensor], done: int) -> None:
    broken = [name for name, total in sums.items() if not torch.isfinite(total)]
    if broken:
        raise RunError(
            f"{folder.path}: {broken[0]} is not finite shortly before step {done}; use a lower learning rate "
            f"(a checkpoint from before, where there is one, stays)"
        )


@contextmanager
def _interrupts() -> Iterator[threading.Event]:
    """An event that the first Ctrl-C sets; the second one stops at once. Outside the main thread nothing is caught."""
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event
        return
    previous = signal.getsignal(signal.SIGINT)

    def handle(_signal: int, _frame: object) -> None:
        event.set()
        signal.signal(signal.SIGINT, previous)

    signal.signal(signal.SIGINT, handle)
    try:
        yield event
    finally:
        signal.signal(signal.SIGINT, previous)
