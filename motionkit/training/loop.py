"""The training loop: deterministic in (seed, step), exactly resumable, safe to interrupt.

A step's randomness comes from its generator, which depends on (seed, purpose, step) alone. The step number and the
tensors of `Trainable.state_tensors` are the whole state of a training, so an interrupted and resumed run is bitwise
equal to an uninterrupted one.
"""

import signal
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Protocol, runtime_checkable

import torch

from motionkit.core.progress import OnProgress, ignore, task
from motionkit.training.ranks import ALONE, Ranks
from motionkit.training.run import RunError, StageFolder
from motionkit.training.schedule import step_generator
from motionkit.training.tensors import CheckpointError, load_tensors, one_line, prefixed, save_tensors, unprefixed


@runtime_checkable
class Trainable(Protocol):
    """What `train_loop` trains.

    With several ranks each has a part of the batch; gradients are reduced inside `step`, metrics by the loop.
    """

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, torch.Tensor]:
        """Do one whole step (batch, loss, optimiser) and return its metrics, this rank's part of them, as scalars.

        `step` counts from 0; all randomness comes from `generator` (on the CPU, the same on every rank).
        """
        ...

    def state_tensors(self) -> dict[str, torch.Tensor]:
        """The complete training state: weights, optimiser moments, averages; complete on the first rank."""
        ...

    def load_state_tensors(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Restore what `state_tensors` returned."""
        ...


def train_loop(
    trainable: Trainable,
    folder: StageFolder,
    *,
    steps: int,
    seed: int,
    log_every: int = 50,
    checkpoint_seconds: float = 60.0,
    ranks: Ranks = ALONE,
    on_progress: OnProgress = ignore,
) -> dict[str, float]:
    """Train to `steps`, from the folder's checkpoint if there is one.

    Returns the last logged metrics, and `cpu_seconds`, including earlier sessions.

    Metrics are means over the steps since the last line of metrics.jsonl. Ctrl-C or SIGTERM ends the current step,
    saves a checkpoint and raises `KeyboardInterrupt`. Raises `RunError` for a non-finite loss (the last checkpoint is
    kept), `CheckpointError` for a checkpoint of another training, and `DamagedFileError` if it or the log is damaged.
    Only the first rank writes, and only it has the metrics.
    """
    purpose, spent = folder.path.name, time.process_time()
    first, figures, before = _restore(trainable, folder, steps, ranks)
    latest = (folder.read_metrics() or [{}])[-1]
    saved = time.perf_counter()
    started = saved - latest.get("seconds", 0.0)
    report = on_progress if ranks.is_first else ignore
    with task(report, purpose, steps, done=first) as work, _interrupts() as interrupted:
        for step in range(first, steps):
            figures.add(trainable.step(step, step_generator(seed, purpose, step)))
            done = step + 1
            stop, due = ranks.agree(interrupted.is_set(), time.perf_counter() - saved > checkpoint_seconds)
            log, save = done % log_every == 0 or done == steps, done == steps or stop or due
            if log or save:
                figures.collect(ranks, folder, done)
            if log:
                latest = {"step": float(done), "seconds": round(time.perf_counter() - started, 3)} | figures.means(done)
                figures = _Figures({}, since=done)
                work.note(" ".join(f"{name} {latest[name]:.4g}" for name in list(latest)[2:5]))
            if log and ranks.is_first:
                folder.append_metrics(latest)
            if save:
                _save(trainable, folder, ranks, done, figures, before + time.process_time() - spent)
                saved = time.perf_counter()
            if stop:
                raise KeyboardInterrupt
            work.advance()
    return latest | {"cpu_seconds": round(before + time.process_time() - spent, 1)}


class _Figures:
    """Sums of the steps' metrics since the last line of metrics.jsonl, which was written after step `since`."""

    def __init__(self, sums: Mapping[str, torch.Tensor], since: int) -> None:
        self.sums = dict(sums)
        self.since = since

    def add(self, values: Mapping[str, torch.Tensor]) -> None:
        """Add a step's metrics; sums stay on the device, to avoid synchronisation.

        Their order is the step's, which all ranks share; a checkpoint's sums are restored by name on the first rank.
        """
        added = {name: value.detach().double() for name, value in values.items()}
        for name in added.keys() & self.sums.keys():
            added[name] = self.sums[name].to(added[name].device) + added[name]
        self.sums = {**added, **{name: value for name, value in self.sums.items() if name not in added}}

    def collect(self, ranks: Ranks, folder: StageFolder, done: int) -> None:
        """Reduce the sums of all ranks to the first one; raises `RunError` on all ranks if one is not finite."""
        totals = torch.stack(list(self.sums.values())).cpu()
        ranks.add_up([totals])
        for name, total in zip(self.sums, totals, strict=True):
            if not torch.isfinite(total):
                raise RunError(
                    f"{folder.path}: {name} is not finite shortly before step {done}; use a lower learning rate "
                    f"(an earlier checkpoint, if any, is kept)"
                )
        self.sums = dict(zip(self.sums, totals if ranks.is_first else torch.zeros_like(totals), strict=True))

    def means(self, done: int) -> dict[str, float]:
        """Means over the steps up to `done`."""
        return {name: float(total) / (done - self.since) for name, total in self.sums.items()}


def _save(
    trainable: Trainable, folder: StageFolder, ranks: Ranks, done: int, figures: _Figures, cpu_seconds: float
) -> None:
    tensors = prefixed("state", trainable.state_tensors()) | prefixed("sums", figures.sums)
    if ranks.is_first:
        folder.sync_metrics()
        description = {
            "step": done,
            "stage": folder.path.name,
            "logged": figures.since,
            "cpu_seconds": round(cpu_seconds, 1),
        }
        save_tensors(folder.checkpoint_path, tensors, description)


def _restore(trainable: Trainable, folder: StageFolder, steps: int, ranks: Ranks) -> tuple[int, _Figures, float]:
    """Restore the checkpoint, if there is one.

    Returns its step, the metrics since the last logged one, and the CPU seconds spent until then.
    """
    path = folder.checkpoint_path
    if not path.is_file():
        ranks.on_first(lambda: folder.keep_metrics(0))
        return 0, _Figures({}, since=0), 0.0
    hint = "train the stage again with --overwrite"
    tensors, description = load_tensors(path)
    if description.get("stage") != folder.path.name:
        raise CheckpointError(f"{path} is of stage {description.get('stage')!r}, not {folder.path.name!r}: {hint}")
    try:
        step, logged = int(description["step"]), int(description["logged"])
        trainable.load_state_tensors(unprefixed("state", tensors))
    except (KeyError, RuntimeError, TypeError, ValueError) as error:
        fault = f"{path} does not fit these settings or this version ({one_line(error)})"
        raise CheckpointError(f"{fault}: {hint}") from None
    if not 0 <= logged <= step <= steps:
        raise CheckpointError(f"{path} is of a step that a training of {steps:,} steps does not have: {hint}")
    ranks.on_first(lambda: folder.keep_metrics(step))
    figures = _Figures(unprefixed("sums", tensors) if ranks.is_first else {}, since=logged)
    return step, figures, float(description.get("cpu_seconds", 0.0))


@contextmanager
def _interrupts() -> Iterator[threading.Event]:
    """An event set by the first Ctrl-C or SIGTERM; a second one stops at once.

    SIGTERM is what schedulers and torchrun send before they kill. Outside the main thread nothing is caught.
    """
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event
        return
    previous = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def restore() -> None:
        for number, handler in previous.items():
            signal.signal(number, handler)

    def handle(_signal: int, _frame: object) -> None:
        event.set()
        restore()

    for number in previous:
        signal.signal(number, handle)
    try:
        yield event
    finally:
        restore()
