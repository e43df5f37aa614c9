"""`motionkit train`: train the stages of a model, or all systems of a table, from a store into a run folder."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from motionkit.cli import console
from motionkit.core import plugins
from motionkit.core.errors import MissingExtraError, MotionkitError, UsageError
from motionkit.core.files import default_path
from motionkit.core.progress import ignore, task
from motionkit.training.config import apply_overrides, flatten, parse_override, setting_text, to_plain, unknown_setting
from motionkit.training.run import (
    Began,
    OnMetrics,
    RunFolder,
    Stage,
    StageContext,
    StagePlan,
    check_same,
    choose_stages,
    concerns,
)


def train(
    path: console.StoreArgument = None,
    stage: Annotated[str, typer.Option(help="One installed stage, or all of the model's in order.")] = "all",
    target: Annotated[
        str | None, typer.Option("--for", metavar="table:N", help="Instead: what this table, or figure:N, lacks.")
    ] = None,
    paper: Annotated[str | None, typer.Option(help="Paper whose table --for means.")] = None,
    recipe: Annotated[str, typer.Option(help="Named configuration: nano, small, demo, base, paper.")] = "nano",
    store: Annotated[Path | None, typer.Option(help="Store to train from.", show_default="./store")] = None,
    runs: console.RunsFolder = None,
    run: Annotated[str | None, typer.Option(help="This run's name; the recipe's by default.")] = None,
    budget: Annotated[
        str | None, typer.Option(metavar="20m", help="Processor time of each system: as many steps as fit.")
    ] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change a setting: field.schedule.steps=100.")
    ] = None,
    where: Annotated[
        str | None,
        typer.Option(
            metavar="SQL",
            help="Train only on sequences for which this holds too: \"NOT list_contains(quality_flags, 'teleport')\".",
        ),
    ] = None,
    show: Annotated[
        bool, typer.Option("--show", help="Print the settings, each line as for --set, and train nothing.")
    ] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on where a run stopped; complete stages are kept. --for always does.")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Start again where a run exists.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Everything random follows from it.")] = 0,
    device: Annotated[str, typer.Option(help="auto, cpu, cuda, cuda:1 …")] = "auto",
    track: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Curves for TensorBoard too, in FOLDER/RUN/STAGE (extra 'track')."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the stages' summaries, or settings, as JSON.")] = False,
) -> None:
    """Train a model's stages from a store into a run folder; Ctrl-C saves, --resume continues exactly.

    Example: motionkit train --recipe nano --run nano"""
    if resume and overwrite:
        raise UsageError("--resume and --overwrite exclude each other")
    if budget is not None and target is None and stage == "all":
        raise UsageError("--budget is for the systems of a table (--for table:2), or for one --stage")
    store = console.named_store(path, store)
    context = StageContext(
        store or default_path("store"),
        RunFolder((runs or default_path("runs")) / (run or recipe)),
        recipe,
        seed=seed,
        resume=resume or (target is not None and not overwrite),
        overwrite=overwrite,
        device=device,
    )
    settings = overrides or []
    plan = _plan(stage, target, paper, context, settings)
    # With --for, complete stages are kept; overrides may be of those too, so that the command can be repeated.
    keeps = target is not None and not overwrite
    kept = {each.name for each in plan.stages if keeps and context.run.stage(each.name).is_complete}
    stages = tuple(each for each in plan.stages if recipe in each.recipes or each.name not in kept)
    configs = configure(stages, recipe, [*plan.settings, *settings])
    if where:
        configs = narrowed(stages, configs, where)
    config_of = {each.name: config for each, config in zip(stages, configs, strict=True) if each.name not in kept}
    if show:
        shown = {key: value for config in config_of.values() for key, value in flatten(config).items()}
        if as_json:
            console.print_json(shown)
        for key, value in () if as_json else shown.items():
            console.stdout.print(f"{key}={setting_text(value)}")
        return
    if where:
        # Some stages select their sequences only after others have trained, or after minutes.
        from motionkit.store import Store

        Store.open(context.store).select_some(where)
    seconds = None if budget is None else console.parse_duration(budget, "--budget")
    shares = {} if seconds is None else {name: seconds * share for name, share in plan.shares.items()}
    jobs = [Job(each, config_of.get(each.name), shares.get(each.name)) for each in plan.stages]
    with tensorboard_events(track and track / context.run.path.name) as on_metrics:
        summaries = train_all(jobs, replace(context, on_metrics=on_metrics), as_json, title=target)
    if summaries is None:
        return
    if as_json:
        console.print_json({"run": str(context.run.path), "stages": summaries})
    elif plan.next_command:
        name = context.run.path.name
        places = console.of_default("--store", store) + console.of_default("--runs", runs)
        named = "" if name == "nano" else f" --run {shlex.quote(name)}"
        console.stdout.print(f"next: {plan.next_command}{places}{named}")


def _plan(
    stage: str, target: str | None, paper: str | None, context: StageContext, overrides: Sequence[str]
) -> StagePlan:
    """The stages that `--stage` or `--for` selects; raises `UsageError`."""
    if target is None:
        next_command = "motionkit eval --table 2" if stage == "all" else ""
        return StagePlan(choose_stages(stage), {stage: 1.0}, (), next_command)
    if stage != "all":
        raise UsageError("--for trains what a table lacks, --stage one stage: give one of them")
    kind = target.partition(":")[0]
    if kind not in (kinds := plugins.names("PLANS")):
        raise UsageError(f"--for {target}: {' or '.join(f'{name}:NUMBER' for name in kinds)}")
    plan: StagePlan = plugins.load("PLANS", kind)(target, paper, context, tuple(overrides))
    return plan


@dataclass(frozen=True)
class Job:
    """A stage with its configuration, or None if it is complete and kept."""

    stage: Stage[Any]
    config: Any | None
    budget_seconds: float | None = None


def configure(stages: tuple[Stage[Any], ...], recipe: str, overrides: list[str]) -> list[Any]:
    """Each stage's configuration; an override applies to every stage with the setting, of which there must be one."""
    configs = [stage.configured(recipe, overrides) for stage in stages]
    for override in overrides:
        key, _ = parse_override(override)
        if not any(key in flatten(config) for config in configs):
            of = f" --stage {stages[0].name}" if len(stages) == 1 else ""
            shows = f"'motionkit train --recipe {recipe}{of} --show' lists all"
            raise UsageError(f"{unknown_setting(key, configs)}; {shows}")
    return configs


def narrowed(stages: tuple[Stage[Any], ...], configs: list[Any], where: str) -> list[Any]:
    """Add a condition to the configurations' `where` settings, which select the store's sequences.

    Raises `UsageError` if no stage has such a setting.
    """
    from motionkit.store.reader import conjunction  # deferred: help loads no numpy

    settings = [
        {key: value for key, value in flatten(config).items() if key.rpartition(".")[2] == "where"}
        for config in configs
    ]
    parts = list(zip(stages, configs, settings, strict=True))
    if not any(concerns(stage.name, key, to_plain(config)) for stage, config, own in parts for key in own):
        names = ", ".join(stage.name for stage in stages)
        raise UsageError(f"--where: {names} takes its sequences from another stage; train that one with --where")
    return [
        apply_overrides(config, [f"{key}={conjunction(value, where)}" for key, value in own.items()])
        for _, config, own in parts
    ]


def train_all(
    jobs: Sequence[Job], context: StageContext, as_json: bool, title: str | None = None
) -> list[dict[str, Any]] | None:
    """Train jobs in order; returns their summaries, on the first rank only. With a title, show one bar for all."""
    from motionkit.store.commit import read_manifest
    from motionkit.training.loop import one_thread
    from motionkit.training.networks import joined_ranks, resolve_device

    fingerprint = read_manifest(context.store).fingerprint
    is_timed = any(job.budget_seconds is not None for job in jobs) and resolve_device(context.device).type != "cuda"
    summaries: list[dict[str, Any]] = []
    with (
        one_thread() if is_timed else nullcontext(),
        joined_ranks() as ranks,
        console.progress() as show,
        ExitStack() as locks,
        # Not of one stage, whose own bar says as much.
        task(show if title else ignore, title or "", len(jobs)) as overall,
    ):
        context = replace(context, on_progress=show)

        def prepare() -> None:
            """Check all stages and lock them, so that a second call cannot replace what this one builds on."""
            for job in jobs:
                check_kept(job, jobs, context, fingerprint)
            to_train = [(job, job.config) for job in jobs if job.config is not None]
            problems: dict[str, MotionkitError] = {}
            for job, config in to_train:
                try:
                    job.stage.check(replace(context, budget_seconds=job.budget_seconds), config)
                except MotionkitError as error:
                    problems.setdefault(str(error), error)
            if len(problems) > 1:
                raise UsageError("; ".join(problems))
            for problem in problems.values():
                raise problem
            for job, _ in to_train:
                locks.enter_context(context.run.stage(job.stage.name).locked())

        ranks.on_first(prepare)
        for number, job in enumerate(jobs, start=1):
            own = replace(context, budget_seconds=job.budget_seconds, shared=job.stage.shared, began=Began())
            if job.config is not None:
                # Check again, since a stage that it builds on may just have been trained.
                ranks.on_first(partial(check_kept, job, jobs, own, fingerprint))
            place = f" ({number} of {len(jobs)})" if title else ""
            train_stage(job, own, is_first=ranks.is_first, place=place)
            overall.advance()
            if job.stage.shared:
                ranks.wait()  # the next stage reads what the first rank saves last
            if ranks.is_first:
                summary = context.run.stage(job.stage.name).read_summary()
                summaries.append({"stage": job.stage.name, **summary})
                if not as_json:
                    values = [
                        f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
                        for key, value in summary.items()
                    ]
                    console.stdout.print(f"{job.stage.name}: {', '.join(values)}")
    return summaries if ranks.is_first else None


def check_kept(job: Job, jobs: Sequence[Job], context: StageContext, fingerprint: str) -> None:
    """Raise `RunError` for a complete or resumed stage that the same command would begin with other inputs."""
    if job.config is not None:
        if context.resume:
            own = replace(context, budget_seconds=job.budget_seconds)
            job.stage.check_kept(own, job.config, fingerprint)
        return
    # It may have other settings, but must be of this store, of the run's own stages, and of the same budget.
    folder, to_train = context.run.stage(job.stage.name), [each.stage.name for each in jobs if each.config is not None]
    earlier = context.run.fingerprints(folder.read_config().get("builds_on", {}))
    inputs: dict[str, Any] = {
        "store_fingerprint": fingerprint,
        "builds_on": earlier | {name: "trained again" for name in earlier if name in to_train},
    }
    if job.budget_seconds is not None:
        inputs["budget_seconds"] = job.budget_seconds
    check_same(folder, inputs)


def train_stage(job: Job, context: StageContext, *, is_first: bool, place: str = "") -> None:
    """Train one job, with messages on the first rank only."""
    stage, folder = job.stage, context.run.stage(job.stage.name)
    complete = job.config is None or (context.resume and folder.is_complete)
    if is_first:
        doing = "complete already, kept" if complete else f"{stage.description} → {folder.path}"
        console.stderr.print(f"{stage.name}{place}: {doing}")
    if not complete and (stage.shared or is_first):
        stage.train(context, job.config)


@contextmanager
def tensorboard_events(folder: Path | None) -> Iterator[OnMetrics]:
    """A callback that writes each stage's metrics as events to `folder/STAGE`; without a folder it does nothing.

    When a stage is resumed, events of repeated steps are hidden. Raises `MissingExtraError` without the extra `track`.
    """
    if folder is None:
        yield lambda stage, values: None
        return
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise MissingExtraError("tensorboard", "track") from None
    writers: dict[str, Any] = {}

    def write(stage: str, values: Mapping[str, float]) -> None:
        step = int(values["step"])
        if stage not in writers:
            writers[stage] = SummaryWriter(str(folder / stage), purge_step=step)
        for name, value in values.items():
            if name != "step":
                writers[stage].add_scalar(name, value, step)
        writers[stage].flush()

    try:
        yield write
    finally:
        for writer in writers.values():
            writer.close()
