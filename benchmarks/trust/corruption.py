"""Single bytes changed in every kind of file that motionkit writes and reads again: noticed, or harmless.

A reader must give what it gives with undamaged files, or raise an error that names the file or a folder that holds it.
The harness is that of `fuzz`.
"""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np

import motionkit as mk
from benchmarks.trust import fuzz
from benchmarks.trust.crash import Drill
from benchmarks.trust.fuzz import Target
from benchmarks.trust.report import Report
from benchmarks.trust.trees import content_of, copy
from eval.native_evaluator.evaluator import load_native
from eval.report.render import to_markdown
from eval.report.results import ResultError, find_results
from motionkit.core.errors import StoreError
from motionkit.store import Store
from motionkit.store.validate import faults
from motionkit.training.run import StageFolder

DEFAULT_SECONDS = 1800.0
RUN = Path("runs/drill")
STAGE_FILES = ("config.json", "metrics.jsonl", "model.safetensors", "summary.json")
STARTS = {**dict.fromkeys(("codebook", "field", "denoiser"), "model"), "evaluator": "evaluator", "pahires": "pahires"}


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
            return record, load_native(folder / RUN).embed_motions(clips, Fraction(20)).tolist()
        if stage == "pahires":
            motion = mk.complete(folder / "long/take-0.bvh", fps=90, model="pahires", run=folder / RUN)
        else:
            motion = mk.load_model(folder / RUN).generate(action="walk", fps=30, seconds=1, seed=0)
        return record, motion.joint_positions.tolist()

    return use


def use_results(folder: Path) -> object:
    """All results, rendered."""
    found = find_results(folder / "results")
    if found.faults:
        raise ResultError(found.faults[0])
    return [to_markdown(result) for result in found.results]


def use_files(folder: Path) -> object:
    """All exported motions."""
    motions = mk.read_all(folder / "npz")
    return [(motion.sequence_id, str(motion.fps), motion.joint_positions.tolist()) for motion in motions]


def targets(drill: Drill) -> list[Target]:
    """Every kind of file, with the folder that it starts from."""

    def kind(start: str, pattern: str, use: Callable[[Path], object]) -> Target:
        name = pattern.replace("/", "-").replace("*", "all")
        return Target(name, lambda folder: copy(drill.start_of(start), folder), use, pattern, exact=True)

    return [
        *(kind("gaps", f"store/{name}", use_store) for name in ("*.json", "*.parquet", "motions/*")),
        *(kind(STARTS[stage], f"{RUN}/{stage}/{name}", use_stage(stage)) for stage in STARTS for name in STAGE_FILES),
        kind("results", "results/*.json", use_results),
        kind("exported", "npz/**/*.npz", use_files),
    ]


def run(seed: int, seconds: float, folder: Path) -> Report:
    """Flip bytes of every kind of file in turn for about this long."""
    return fuzz.run(seed, seconds, folder, targets(Drill(folder / "drill")), part="corruption")
