"""The folders whose files are damaged: made once, by motionkit's own commands."""

from pathlib import Path

from benchmarks.trust.corruption.kinds import CALL, EXPORT, STARTS_OF_STAGES
from benchmarks.trust.faults import Fault
from benchmarks.trust.process import Commands
from benchmarks.trust.scenarios import EVAL, EVAL_PAHIRES, GENERATE, STARTS, STORE, Arguments, takes, train
from benchmarks.trust.trees import copy
from benchmarks.trust.trials import Drill, require_success

TABLE_4 = ("eval", "--table", "4", "--clips", "64", *EVAL)
# Trainings that are killed before this file is renamed for the n-th time, counted from 0: when half of the steps are
# done, or all of them, but the result is not there.
INTERRUPTED = {"half": ("checkpoint.safetensors", 4), "finished": ("model.safetensors", 0)}
# By name: the start of `scenarios` or of these that it goes on from, and what is run in it.
MORE: dict[str, tuple[str, tuple[Arguments, ...]]] = {
    "evaluator": ("corpus", (train("evaluator"),)),
    "generated": ("model", (GENERATE,)),
    "results": ("pahires", (EVAL_PAHIRES,)),
    "caches": ("", tuple((f"{CALL}{name}", "caches") for name in ("kinematic", "embeddings", "texts"))),
    "everything": (
        "model",
        (
            train("pahires"),
            *(takes(name, 9 * number, 3) for number, name in enumerate(("one", "three"), start=1)),
            ("ingest", "one", "--store", "other", "--workers", "1"),
            GENERATE,
            EVAL_PAHIRES,
            (f"{CALL}samples", "samples"),
        ),
    ),
    "exported": (
        "store",
        (("export", "npz", *EXPORT[2:]), ("export", "rows", "--format", "parquet", *STORE)),
    ),
}


def make_start(commands: Commands, folder: Path, name: str) -> Path:
    """The folder of this name, made where it is missing."""
    path = folder / "starts" / name.replace(" ", "-")
    if path.exists():
        return path
    if name in STARTS:
        return Drill(commands, folder, None).start_of(name)
    making = path.with_name(f"{path.name}.making")
    when, _, stage = name.partition(" ")
    if when in INTERRUPTED:
        _interrupt(commands, folder, stage, making, INTERRUPTED[when])
    else:
        base, steps = MORE[name]
        if base:
            copy(make_start(commands, folder, base), making)
        else:
            making.mkdir(parents=True)
        for arguments in steps:
            require_success(commands.run(making, arguments), arguments)
    making.rename(path)
    return path


def _interrupt(commands: Commands, folder: Path, stage: str, making: Path, before: tuple[str, int]) -> None:
    """A training that was killed before it did something to a file of this name for the n-th time."""
    base = make_start(commands, folder, STARTS_OF_STAGES.get(stage, "corpus"))
    copy(base, making)
    whole = commands.run(making, train(stage), checkpoint_seconds=0.0)
    require_success(whole, train(stage))
    name, times = before
    numbers = [number for number, what in enumerate(whole.operations) if what.startswith("os.rename") and name in what]
    copy(base, making)
    commands.run(making, train(stage), Fault("operation", numbers[times]), checkpoint_seconds=0.0)
