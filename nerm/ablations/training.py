"""Training the variants of an ablation: one run each, one codebook for all, gone on with where a training stopped."""

import os
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from motionkit.store.manifest import read_manifest
from motionkit.training.run import RunFolder
from motionkit.training.stage import Stage as TrainedStage
from motionkit.training.stage import StageContext
from nerm.ablations.variants import Stage, Variant, run_name
from nerm.recipes import NermConfig
from nerm.stages import CODEBOOK, DENOISER, FIELD

STAGES = {"field": FIELD, "denoiser": DENOISER}
CODEBOOK_SEED = 0


@dataclass(frozen=True)
class Sweep:
    """What the trainings of an ablation have in common; runs are RUNS/PREFIX-VARIANT, the codebook is RUNS/PREFIX's."""

    store: Path
    runs: Path
    prefix: str
    recipe: str
    seed: int = 0
    overwrite: bool = False
    device: str = "auto"

    def context(self, run: RunFolder, seed: int, *, overwrite: bool) -> StageContext:
        """A context for one run."""
        return StageContext(
            self.store, run, self.recipe, seed=seed, resume=not overwrite, overwrite=overwrite, device=self.device
        )


def train_variant(sweep: Sweep, variant: Variant, config: NermConfig, stages: Sequence[Stage]) -> dict[str, Any]:
    """Train what is missing of a variant's stages; returns its run's name, each stage's summary and CPU seconds spent.

    Complete stages are kept. Raises `RunError` where they were trained with other settings, and what training raises.
    """
    run = RunFolder(sweep.runs / run_name(sweep.prefix, variant, sweep.seed))
    context = sweep.context(run, sweep.seed, overwrite=sweep.overwrite)
    started = time.process_time()
    if config.field.time_encoding == "codebook":
        share_codebook(sweep, run, config)
    summaries = {}
    for name in stages:
        folder = run.stage(name)
        if folder.is_complete and not sweep.overwrite:
            _check_unchanged(context, STAGES[name], config)
        else:
            STAGES[name].train(context, config)
        summaries[name] = folder.read_summary()
    return {
        "run": run.path.name,
        "variant": variant.name,
        "stages": summaries,
        "cpu_seconds": round(time.process_time() - started, 1),
    }


def share_codebook(sweep: Sweep, run: RunFolder, config: NermConfig) -> None:
    """Give a run the codebook of RUNS/PREFIX, which is trained first where there is none.

    The variants differ in how the codes are used, not in the codes, so they have the same ones.
    """
    common = RunFolder(sweep.runs / sweep.prefix)
    context = sweep.context(common, CODEBOOK_SEED, overwrite=False)
    source, target = common.stage(CODEBOOK.name), run.stage(CODEBOOK.name)
    if source.is_complete:
        _check_unchanged(context, CODEBOOK, config)
    else:
        CODEBOOK.train(context, config)
    if target.is_complete and target.model_path.read_bytes() == source.model_path.read_bytes():
        return
    shutil.rmtree(target.path, ignore_errors=True)
    partial = target.path.with_name(f".{target.path.name}.{os.getpid()}.tmp")
    shutil.copytree(source.path, partial, ignore=shutil.ignore_patterns(source.checkpoint_path.name))
    partial.rename(target.path)


def _check_unchanged(context: StageContext, stage: TrainedStage[NermConfig], config: NermConfig) -> None:
    stage.check_kept(context, config, read_manifest(context.store).fingerprint)
