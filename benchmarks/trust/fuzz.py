"""Damaged files for every reader: each returns a motion or raises an own error, within 2 s of CPU time and 1 GiB.

Inputs are tried in a forked process; if it dies, the input is a failure and another process goes on behind it. A
failure is reported as READER:SEED:NUMBER, from which the input is made again.

Corruption: single bytes changed in every kind of file that motionkit writes and reads again are noticed, or harmless. A
reader gives what it gives with undamaged files, or raises an error that names the file or a folder that holds it.
"""

import json
import os
import resource
import shutil
import signal
import time
import warnings
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from random import Random

import numpy as np
import torch

import motionkit as mk
from benchmarks.trust.crash import Case, Drill, Report, content_of, copy
from benchmarks.trust.mutate import flip, mutate
from eval.native_evaluator.evaluator import load_evaluator
from eval.report.results import ResultError, environment, find_results, to_markdown
from eval.sample_folder import SampleOptions, read_sample_folder
from motionkit.core.errors import MotionkitError, StoreError
from motionkit.core.skeletons.mapping import read_skeleton_map
from motionkit.generate.request import read_prompts
from motionkit.io.indexes import read_index
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import read, read_rules, scan
from motionkit.store import Store
from motionkit.store.validate import faults
from motionkit.training.run import StageFolder
from tests.helpers import published_layouts
from tests.helpers.every_format import SOURCES
from tests.helpers.side_files import BESIDE, RULES
from tests.motionkit.core.test_skeletons import robot_map

RUN = Path("runs/drill")
STAGE_FILES = ("config.json", "metrics.jsonl", "model.safetensors", "summary.json")
STARTS = {**dict.fromkeys(("codebook", "field", "denoiser"), "model"), "evaluator": "evaluator", "pahires": "pahires"}
MOST_BYTES, MOST_SECONDS, STUCK_SECONDS = 1 << 30, 2.0, 60
BLOCK_INPUTS = 50
STATED = ReadOptions(fps=Fraction(30), unit_metres=1.0)
INDEX = b"source_path,start_frame,end_frame,new_name\n./pose_data/KIT/3/a_poses.npy,0,-1,000000.npy\n"
PROMPTS = b"text,action,seconds\na person walks,,2.5\n,wave,\n"
Make = Callable[[Path], object]
Use = Callable[[Path], object]


@dataclass(frozen=True)
class Target:
    """One reader: `make` writes a small valid source into a folder, of which a file that matches is damaged.

    `use` reads all of the folder as a user would, without catching errors. Of an `exact` one a single byte is changed,
    and it has to give what it gives undamaged, or to name the file or a folder that holds it.
    """

    name: str
    make: Make
    use: Use
    pattern: str = "**/*"
    exact: bool = False


def read_folder(folder: Path, options: ReadOptions = ReadOptions()) -> None:
    """Scan and read a folder as an ingest does; errors must name the file, motions must be finite and timed."""
    found = scan([folder], options)
    problems: list[MotionkitError] = list(found.problems)
    for item in found.items:
        assert item.path.is_relative_to(folder.resolve()), f"{item.path} lies outside"
        try:
            motion = read(item, options)
        except MotionkitError as problem:
            problems.append(problem)
            continue
        assert np.isfinite(motion.joint_positions).all(), "a number that is not finite was read"
        assert 1 <= motion.fps <= 10_000, f"{motion.fps} fps were read"
    if problems:
        assert folder.name in str(problems[0]), f"does not name its file: {problems[0]}"
        raise problems[0]


def read_samples(folder: Path) -> None:
    """Read a folder of samples as `motionkit samples` does."""
    found = read_sample_folder("mine", folder, SampleOptions(Fraction(20), keep_published=True))
    assert np.isfinite(found.sequences.values).all(), "a number that is not finite was read"
    if found.left_out:
        raise found.left_out[0]


def all_targets() -> Iterator[Target]:
    """Every reader."""

    def content(name: str, data: bytes) -> Make:
        return lambda folder: (folder / name).write_bytes(data)

    def beside(format_name: str, name: str, data: bytes) -> Make:
        def make(folder: Path) -> None:
            SOURCES[format_name](folder)
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_bytes(data)

        return make

    def each(reader: Callable[[Path], object]) -> Use:
        return lambda folder: [reader(path) for path in sorted(folder.iterdir())]

    for name, make in SOURCES.items():
        options = STATED if name in ("asfamc", "joints-npy") else ReadOptions()
        yield Target(name, make, partial(read_folder, options=options))
    for side, (format_name, name, data) in BESIDE.items():
        options = STATED if side == "skeleton" else ReadOptions()
        make = beside(format_name, name, data)
        yield Target(f"beside-{side}", make, partial(read_folder, options=options), f"**/{Path(name).name}")
    for layout in ("mld_demo", "t2m_gpt", "mdm", "momask", "mld_test"):
        yield Target(f"samples-{layout}", getattr(published_layouts, f"write_{layout}"), read_samples)
    yield Target("index", content("index.csv", INDEX), each(read_index))
    yield Target("fps-rules", content("rules.toml", RULES), each(read_rules))
    yield Target("skeleton-map", content("map.toml", robot_map().encode()), each(read_skeleton_map))
    yield Target("prompts", content("prompts.csv", PROMPTS), each(read_prompts))


def try_block(target: Target, seed: int, numbers: range, folder: Path, expected: str) -> tuple[list[str], list[str]]:
    """Try inputs of a target in a forked process: an outcome each ("read", "refused", "failed"), and the failures.

    `folder` holds the valid source, `expected` what an exact reader finds in it. The outcomes end where the child does.
    """
    notes, write = os.pipe()
    child = os.fork()
    if not child:
        os.close(notes)
        _work(target, seed, numbers, folder, expected, write)
    os.close(write)
    with os.fdopen(notes) as lines:
        said = [json.loads(line) for line in lines]
    outcomes = [outcome for outcome, _ in said]
    failures = [
        f"{target.name}:{seed}:{number}: {text}" for number, (_, text) in zip(numbers, said, strict=False) if text
    ]
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if status:
        ended = signal.Signals(-status).name if status < 0 else f"exit {status}"
        failures.append(f"{target.name}:{seed}:{numbers[len(said)]}: ended by {ended}")
        outcomes.append("failed")
    return outcomes, failures


def _work(target: Target, seed: int, numbers: range, folder: Path, expected: str, write: int) -> None:
    """The child: it never returns. Its memory, its processor time and its waiting for an input are limited."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(1, 2)
    for number in (signal.SIGPROF, signal.SIGALRM):
        signal.signal(number, signal.SIG_DFL)
    warnings.simplefilter("error")
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MOST_BYTES, resource.RLIM_INFINITY))
    for number in numbers:
        place = folder.with_name(f"{folder.name}-damaged")
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(folder, place)
        rng = Random(f"{target.name}/{seed}/{number}")
        path = rng.choice(sorted(each for each in place.glob(target.pattern) if each.is_file()))
        content = path.read_bytes()
        path.write_bytes(flip(rng, content) if target.exact else mutate(rng, path.name, content))
        signal.setitimer(signal.ITIMER_PROF, MOST_SECONDS)
        signal.alarm(STUCK_SECONDS)
        outcome, text = "read", ""
        try:
            if repr(target.use(place)) != expected and target.exact:
                outcome, text = "failed", f"{path.relative_to(place)}: missed"
        except MotionkitError as error:
            outcome = "refused"
            holders = {each.name for each in (path, *path.parents) if each.is_relative_to(place)}
            if target.exact and not any(name in str(error) for name in holders):
                outcome, text = "failed", f"{path.relative_to(place)}: not named: {error}"
        except BaseException as error:
            outcome, text = "failed", f"{type(error).__name__}: {str(error)[:300]}"
        signal.setitimer(signal.ITIMER_PROF, 0)
        os.write(write, (json.dumps((outcome, text)) + "\n").encode())
    os._exit(0)


def run(
    seed: int,
    seconds: float,
    folder: Path,
    targets: Sequence[Target] | None = None,
    inputs_each: int | None = None,
    part: str = "fuzz",
) -> Report:
    """Try inputs of all readers in turn for about this long, or so many of each."""
    torch.set_num_threads(1)  # threads do not survive a fork
    begun, chosen = time.monotonic(), list(all_targets() if targets is None else targets)
    expected, outcomes, failures = {}, defaultdict[str, list[str]](list), defaultdict[str, list[str]](list)
    for target in chosen:
        (folder / target.name).mkdir(parents=True)
        target.make(folder / target.name)
        expected[target.name] = repr(target.use(folder / target.name))  # what is not damaged is read
    waiting = chosen
    while waiting and time.monotonic() - begun < seconds:
        target = min(waiting, key=lambda each: len(outcomes[each.name]))
        tried = len(outcomes[target.name])
        numbers = range(tried, tried + BLOCK_INPUTS if inputs_each is None else min(tried + BLOCK_INPUTS, inputs_each))
        found, faults_found = try_block(target, seed, numbers, folder / target.name, expected[target.name])
        outcomes[target.name] += found
        failures[target.name] += faults_found
        waiting = [each for each in chosen if inputs_each is None or len(outcomes[each.name]) < inputs_each]
    cases = tuple(
        Case(each.name, len(outcomes[each.name]), tuple(failures[each.name]), Counter(outcomes[each.name]))
        for each in chosen
    )
    return Report(part, seed, time.monotonic() - begun, cases, environment())


def use_store(folder: Path) -> object:
    """All of a store; what is not intact is an error."""
    for fault in faults(folder / "store"):
        raise StoreError(f"{folder / 'store'}: {fault}")
    store = Store.open(folder / "store")
    return content_of(store), store.fingerprint, store.query("SELECT * FROM sequences ORDER BY 1").to_pylist()


def use_stage(stage: str) -> Callable[[Path], object]:
    """A stage's record, and what its weights give."""

    def use(folder: Path) -> object:
        found = StageFolder(folder / RUN / stage)
        record = (found.read_config(), found.read_metrics(), found.read_summary())
        if stage == "evaluator":
            clips = np.random.default_rng(2).normal(size=(4, 16, 22, 3))
            return record, load_evaluator(folder / RUN).embed_clips(clips, Fraction(20)).tolist()
        if stage == "pahires":
            motion = mk.complete(folder / "long/take-0.bvh", fps=90, model="pahires", run=folder / RUN)
        else:
            motion = mk.load_model(folder / RUN).generate(action="walk", fps=30, seconds=1, seed=0)
        return record, motion.joint_positions.tolist()

    return use


def use_results(folder: Path) -> object:
    """All results, rendered."""
    results, faults = find_results(folder / "results")
    if faults:
        raise ResultError(faults[0])
    return [to_markdown(result) for result in results]


def use_files(folder: Path) -> object:
    """All exported motions."""
    motions = mk.read_all(folder / "npz")
    return [(motion.sequence_id, str(motion.fps), motion.joint_positions.tolist()) for motion in motions]


def written_targets(drill: Drill) -> list[Target]:
    """Every kind of file that motionkit writes and reads again, with the folder that it starts from."""

    def kind(start: str, pattern: str, use: Callable[[Path], object]) -> Target:
        name = pattern.replace("/", "-").replace("*", "all")
        return Target(name, lambda folder: copy(drill.start_of(start), folder), use, pattern, exact=True)

    return [
        *(kind("gaps", f"store/{name}", use_store) for name in ("*.json", "*.parquet", "motions/*")),
        *(kind(STARTS[stage], f"{RUN}/{stage}/{name}", use_stage(stage)) for stage in STARTS for name in STAGE_FILES),
        kind("results", "results/*.json", use_results),
        kind("exported", "npz/**/*.npz", use_files),
    ]


def run_corruption(seed: int, seconds: float, folder: Path) -> Report:
    """Flip bytes of every kind of file in turn for about this long."""
    return run(seed, seconds, folder, written_targets(Drill(folder / "drill")), part="corruption")
