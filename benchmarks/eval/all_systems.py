"""Every generative system with the same trials and the same processor time: trainings, evaluations, one table.

    python -m benchmarks.eval.all_systems trials --store S --runs R                 # each system's settings, on val
    python -m benchmarks.eval.all_systems train --store S --runs R --budget 360 --seeds 0,1,2
    python -m benchmarks.eval.all_systems evaluate --store S --runs R --evaluator RUN
    python -m benchmarks.eval.all_systems_table --results RESULTS                    # the table and the figure

A budget is the processor time that the operating system counts for a system's trainings, from the start of Python to
the last weight on disk, with an empty cache each: reading the store, pose vectors, text embeddings, linear fits and
autoencoders are in it. Each system has five trials on the validation part: three learning rates, then guidance and
sampling steps, or half the batch and a rate more where nothing is guided. The best by clip-FID of planted motion at
60 fps is trained with each seed.
"""

import json
import math
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import suppress
from fractions import Fraction
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.command import arguments_parser
from eval.clip_fid.score import Protocol
from eval.report.results import provenance
from eval.sets.motions import generate_fields, planted_fields
from eval.sets.sets import RowId, Variant
from eval.tables.systems import Yardstick
from eval.tables.table import EvalConfig
from motionkit.core import plugins
from motionkit.core.files import write_json
from motionkit.generate.models import SamplingOptions, installed_models
from motionkit.store.reader import Store
from motionkit.training.config import flatten
from motionkit.training.run import RunError
from nerm.recipes import LOCAL

TRIALS = Path("docs/results/all-systems-trials.json")
TRIAL_SEED, TRIAL_SECONDS, TRIAL_FPS = 10, 120.0, Fraction(60)
# What a process needs outside of a stage's clock, in processor seconds.
OUTSIDE_SECONDS = 2.0
# Trials of how a trained network is sampled. Others have two more trainings instead.
GUIDED = {
    "nerm": ("denoiser:denoiser.diffusion.guidance_scale=1", "denoiser:denoiser.diffusion.sampling_steps=25"),
    "mdm": ("mdm:network.diffusion.guidance_scale=1", "mdm:network.diffusion.sampling_steps=20"),
    "mdm-50": ("mdm-50:network.diffusion.guidance_scale=1", "mdm-50:network.diffusion.sampling_steps=20"),
    "mld": ("mld:network.diffusion.guidance_scale=1", "mld:network.diffusion.sampling_steps=20"),
    "camdm": ("camdm:network.diffusion.guidance_scale=1.5", "camdm:network.diffusion.guidance_scale=2.5"),
}
# 1,000 steps of MDM take 6 s a motion.
FIXED = {"mdm": ("mdm:network.diffusion.sampling_steps=50",)}


def stages_of(system: str) -> list[tuple[str, float]]:
    """A system's stages in order, with their shares of its budget."""
    names = (("codebook",) if system == "nerm" else ()) + installed_models()[system].stages
    return [(name, plugins.load("STAGES", name).share) for name in names]


def rates(system: str, factor: float) -> tuple[str, ...]:
    """The settings of all learning rates of a system's `nano`, times a factor."""
    found = []
    for stage, _ in stages_of(system):
        for key, value in flatten(plugins.load("STAGES", stage).configured("nano")).items():
            is_own = system != "nerm" or key.startswith(f"{stage}.")
            if key.endswith("learning_rate") and is_own and stage != "codebook":
                found.append(f"{stage}:{key}={factor * value:.4g}")
    return tuple(found)


def halved_batches(system: str) -> tuple[str, ...]:
    """The settings of half of each batch of a system's `nano`."""
    schedules = {stage: plugins.load("STAGES", stage).configured("nano").schedule for stage, _ in stages_of(system)}
    return tuple(f"{stage}:schedule.batch_size={schedule.batch_size // 2}" for stage, schedule in schedules.items())


def train(system: str, run: Path, store: Path, budget: float, settings: Iterable[str], seed: int) -> None:
    """Train a system's stages into a run; each gets its share of what earlier ones have left."""
    cache, stages, left = run.parent / f"cache-{run.name}-{system}", stages_of(system), budget
    for number, (stage, share) in enumerate(stages):
        spent_path = run / stage / "spent.json"
        if not spent_path.is_file():
            own = left * share / sum(share for _, share in stages[number:]) - OUTSIDE_SECONDS
            command = [sys.executable, "-m", "motionkit", "train", "--stage", stage, "--recipe", "nano", "--overwrite"]
            command += ["--store", str(store), "--runs", str(run.parent), "--run", run.name, "--seed", str(seed)]
            command += ["--budget", f"{own:.1f}s"]
            for of_stage, _, text in (each.partition(":") for each in (*FIXED.get(system, ()), *settings)):
                command += ["--set", text] if of_stage == stage else []
            environment = {**os.environ, "OMP_NUM_THREADS": "1", "MOTIONKIT_CACHE": str(cache)}
            with (run.parent / f"{run.name}-{stage}.log").open("w") as log:
                process = subprocess.Popen(command, stdout=log, stderr=log, env=environment)
                _, status, usage = os.wait4(process.pid, 0)
            if status:
                for each, _ in stages:
                    shutil.rmtree(run / each, ignore_errors=True)
                raise RunError(f"{' '.join(command)} failed: {log.name}")
            spent_path.write_text(json.dumps({"cpu_seconds": usage.ru_utime + usage.ru_stime}))
        left -= json.loads(spent_path.read_text())["cpu_seconds"]
    shutil.rmtree(cache, ignore_errors=True)
    print(f"{run.name}: {system} took {budget - left:.1f} of {budget:g} processor seconds", file=sys.stderr)


def evaluate(table: str, run: Path, store: Path, results: Path, *options: str) -> dict[str, Any]:
    """A table of a run, as JSON."""
    command = [sys.executable, "-m", "motionkit", "eval", "--table", table, "--store", str(store), "--json"]
    command += ["--runs", str(run.parent), "--run", run.name, "--results", str(results / run.name), *options]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment, check=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def title(system: str) -> str:
    """A system's name in tables."""
    return LOCAL if system == "nerm" else installed_models()[system].title


@lru_cache(1)
def yardstick(store: Path) -> Yardstick:
    """Real motion of the validation part."""
    clips = Protocol(replications=4, resamplings=0, detailed_replications=0)
    return Yardstick.of(Store.open(store), EvalConfig(store, Path(), split="val", clips=clips), (TRIAL_FPS,))


def score(system: str, run: Path, store: Path, settings: Sequence[str] = ()) -> float:
    """clip-FID of a system's planted motion on the validation part; the settings are of its sampling."""
    options = {name.rpartition(".")[2]: float(value) for name, value in (each.split("=") for each in settings)}
    steps = int(options["sampling_steps"]) if "sampling_steps" in options else None
    row, real = RowId(title(system), Variant.PLANTED), yardstick(store)
    model = installed_models()[system].load(run)
    sampling = SamplingOptions(guidance_scale=options.get("guidance_scale"), steps=steps)
    fields = generate_fields(model, real.windows(model), 0, 1024, sampling)
    (cell,) = real.clip_fid(row, real.sets(row, planted_fields(fields))).values()
    return cell.value


def trials(system: str, runs: Path, store: Path) -> list[dict[str, Any]]:
    """Five trials of a system: three rates, then two of the best rate's sampling or training."""
    found: list[dict[str, Any]] = []

    def training(*settings: str) -> float:
        run = runs / f"trial-{len(found)}"
        value = None
        with suppress(RunError):  # a rate at which it diverges
            train(system, run, store, TRIAL_SECONDS, settings, TRIAL_SEED)
            value = score(system, run, store)
        found.append({"settings": settings, "clip_fid": value})
        return math.inf if value is None else value

    is_higher = training(*rates(system, 1.0)) > training(*rates(system, 3.0))
    training(*rates(system, 9.0 if is_higher else 1 / 3))
    number = found.index(best := ranked(found)[0])
    for each in GUIDED.get(system, ()):
        value = score(system, runs / f"trial-{number}", store, (each,))
        found += [{"settings": (*best["settings"], each), "clip_fid": value}]
    if system not in GUIDED:
        training(*best["settings"], *halved_batches(system))
        training(*rates(system, 3.0**0.5))
    print(json.dumps({system: found}), file=sys.stderr, flush=True)
    return found


def ranked(found: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The trials that did not diverge, by clip-FID."""
    return sorted((each for each in found if each["clip_fid"] is not None), key=lambda each: float(each["clip_fid"]))


def evaluate_runs(runs: Path, store: Path, results: Path, evaluator: Path) -> None:
    """Table 2 of every run on the test part, and Table 1 of the first seed's."""
    of_clips: tuple[str, ...] = ("--fps", "20,60,120", "--evaluator", "kinematic")
    for run in sorted(runs.glob("*s-[0-9]")):
        tables = [("2", of_clips)]
        if run.name.endswith("s-0"):
            shutil.copytree(evaluator / "evaluator", run / "evaluator", dirs_exist_ok=True)
            tables.append(("1", ()))
        for table, options in tables:
            if not (results / run.name / f"nerm-table{table}.json").is_file():
                evaluate(table, run, store, results, *options)


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("command", choices=("trials", "train", "evaluate"))
    parser.add_argument("--systems", default=",".join(installed_models()))
    parser.add_argument("--store", type=Path, default=Path("store"))
    parser.add_argument("--runs", type=Path, default=Path("runs"))
    parser.add_argument("--results", type=Path, default=Path("results"))
    parser.add_argument("--evaluator", type=Path, default=Path("runs/nano"), help="a run with a trained evaluator")
    parser.add_argument("--budget", type=float, default=360.0, help="processor seconds of a system")
    parser.add_argument("--seeds", default="0,1,2")
    given = parser.parse_args()
    given.runs.mkdir(parents=True, exist_ok=True)
    systems = given.systems.split(",")
    if given.command == "trials":
        with ProcessPoolExecutor(len(os.sched_getaffinity(0)), get_context("spawn")) as pool:
            count = len(systems)
            found = pool.map(trials, systems, [given.runs] * count, [given.store] * count)
            of_system = dict(zip(systems, found, strict=True))
        origin = provenance(given.store, sorted(given.runs.glob("trial-?")))
        write_json(TRIALS, {"seconds": TRIAL_SECONDS, "seed": TRIAL_SEED, "trials": of_system, "provenance": origin})
    elif given.command == "evaluate":
        evaluate_runs(given.runs, given.store, given.results, given.evaluator)
    else:
        seeds = [int(seed) for seed in given.seeds.split(",")]
        tried = {name: ranked(found) for name, found in json.loads(TRIALS.read_text())["trials"].items()}

        def train_one(job: tuple[int, str]) -> None:
            seed, system = job
            run = given.runs / f"{given.budget:g}s-{seed}"
            for trial in tried[system]:
                with suppress(RunError):
                    train(system, run, given.store, given.budget, trial["settings"], seed)
                    break
                # It diverges in a longer training: the next best.
            else:
                raise RunError(f"{system}: its training diverges with the settings of every trial")

        with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as threads:
            list(threads.map(train_one, [(seed, system) for seed in seeds for system in systems]))


if __name__ == "__main__":
    main()
