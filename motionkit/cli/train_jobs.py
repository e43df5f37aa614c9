"""Trains stages one after another into a run, with the progress that `motionkit train` shows."""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from motionkit.cli.console import progress, stderr, stdout
from motionkit.core.progress import OnProgress, Progress, ignore, task
from motionkit.training.stage import Stage, StageContext


@dataclass(frozen=True)
class Job:
    """A stage with its configuration, or None if it is complete and kept. `weight` is its cost relative to others."""

    stage: Stage[Any]
    config: Any | None
    budget_seconds: float | None = None
    weight: float = 1.0


class TimeLeft:
    """Estimates the time left for stages of known weights from the progress in this session."""

    def __init__(self, weights: Mapping[str, float], clock: Callable[[], float] = time.monotonic) -> None:
        self._weights, self._clock, self._started = weights, clock, clock()
        self._begun: dict[str, float] = {}
        self._now: dict[str, float] = {}

    def seconds(self, name: str, share: float) -> float | None:
        """Seconds left when this share of a stage is done; None while there is too little progress to tell."""
        self._begun.setdefault(name, share)
        self._now[name] = share
        worked = sum(self._weights[each] * (now - self._begun[each]) for each, now in self._now.items())
        left = sum(weight * (1.0 - self._now.get(each, 0.0)) for each, weight in self._weights.items())
        elapsed = self._clock() - self._started
        return elapsed * left / worked if worked > 0.01 * (worked + left) else None


def train_all(
    jobs: Sequence[Job], context: StageContext, as_json: bool, title: str | None = None
) -> list[dict[str, Any]] | None:
    """Train jobs in order; returns their summaries, on the first rank only. With a title, show one bar for all."""
    from motionkit.store.manifest import read_manifest
    from motionkit.training.ranks import joined_ranks

    fingerprint = read_manifest(context.store).fingerprint
    summaries: list[dict[str, Any]] = []
    left = TimeLeft({job.stage.name: job.weight for job in jobs if job.config is not None})
    kept = sum(job.config is None for job in jobs)
    with _threads(jobs, context.device), joined_ranks() as ranks, progress() as show, ExitStack() as locks:
        for job in jobs:
            ranks.on_first(partial(_check, job, _of_job(context, job, show), fingerprint))
        # All of them before the first is trained, so that a second call cannot replace what this one builds on.
        ranks.on_first(partial(_lock, jobs, context, locks))
        # Not of one stage, whose own bar says as much.
        with task(show if title else ignore, title or "", len(jobs), done=kept) as overall:
            for number, job in enumerate(jobs, start=1):
                name = job.stage.name

                def report(state: Progress, name: str = name) -> None:
                    show(state)
                    if state.name == name and state.total:
                        overall.set_seconds_left(left.seconds(name, state.done / state.total))

                of_job = _of_job(context, job, report)
                # Check again, since a stage that it builds on may just have been trained.
                ranks.on_first(partial(_check_kept, job, of_job, fingerprint))
                place = f" ({number} of {len(jobs)})" if title else ""
                train_stage(job, replace(of_job, shared=job.stage.shared), is_first=ranks.is_first, place=place)
                if job.config is not None:
                    overall.advance()
                if job.stage.shared:
                    ranks.wait()  # the next stage reads what the first rank saves last
                if ranks.is_first:
                    summaries.append({"stage": name, **context.run.stage(name).read_summary()})
                    _tell(summaries[-1], as_json)
    return summaries if ranks.is_first else None


def _threads(jobs: Sequence[Job], device: str) -> AbstractContextManager[None]:
    """One thread if a job has a budget of processor time; on a GPU, or without a budget, torch's number of threads."""
    if all(job.budget_seconds is None for job in jobs):
        return nullcontext()
    from motionkit.training.budget import one_thread
    from motionkit.training.precision import resolve_device

    return nullcontext() if resolve_device(device).type == "cuda" else one_thread()


def _of_job(context: StageContext, job: Job, on_progress: OnProgress) -> StageContext:
    return replace(context, budget_seconds=job.budget_seconds, on_progress=on_progress)


def _lock(jobs: Sequence[Job], context: StageContext, locks: ExitStack) -> None:
    for job in jobs:
        if job.config is not None:
            locks.enter_context(context.run.stage(job.stage.name).locked())


def _check(job: Job, context: StageContext, store_fingerprint: str) -> None:
    _check_kept(job, context, store_fingerprint)
    if job.config is not None:
        job.stage.check(context, job.config)


def _check_kept(job: Job, context: StageContext, store_fingerprint: str) -> None:
    if context.resume and job.config is not None:
        job.stage.check_kept(context, job.config, store_fingerprint)


def train_stage(job: Job, context: StageContext, *, is_first: bool, place: str = "") -> None:
    """Train one job, with messages on the first rank only."""
    stage, folder = job.stage, context.run.stage(job.stage.name)
    complete = job.config is None or (context.resume and folder.is_complete)
    if is_first:
        doing = "complete already, kept" if complete else f"{stage.description} → {folder.path}"
        stderr.print(f"{stage.name}{place}: {doing}")
    if not complete and (stage.shared or is_first):
        stage.train(context, job.config)


def _tell(summary: Mapping[str, Any], as_json: bool) -> None:
    if not as_json:
        figures = ", ".join(f"{name} {_short(value)}" for name, value in summary.items() if name != "stage")
        stdout.print(f"{summary['stage']}: {figures}")


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
