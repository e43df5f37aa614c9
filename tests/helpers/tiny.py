"""Every trainable stage at a size of seconds, on motions that are known: what the tests of whole trainings share.

The settings are written out, so that a change of a recipe doesn't change them.
"""

from fractions import Fraction
from pathlib import Path
from typing import Any

import motionkit as mk
from benchmarks.trust import scenarios
from motionkit.training.config import apply_overrides
from motionkit.training.run import RunFolder, Stage, StageContext
from nerm.recipes import (
    CODEBOOK,
    DENOISER,
    FIELD,
    CodebookConfig,
    DenoiserConfig,
    FieldConfig,
    NermConfig,
    TransformerConfig,
)
from tests.helpers.nerm_corpus import analytic_positions

SETTINGS = tuple(word for each in scenarios.SETTINGS["codebook"].split() for word in ("--set", each))
"""Options of `motionkit train` and `ablate` with which NeRM's stages take a second on the command line."""
STEPS = 8
NERM = NermConfig(
    codebook=apply_overrides(
        CodebookConfig(window_frames=32),
        f"schedule.steps={STEPS} schedule.batch_size=8 schedule.learning_rate=0.001 schedule.drop_every=0.75 "
        "network.width=16 network.num_codes=16".split(),
    ),
    field=apply_overrides(
        FieldConfig(),
        f"schedule.epochs=none schedule.steps={STEPS} schedule.batch_size=8 schedule.learning_rate=0.002 "
        "schedule.kind=cosine optimizer.attention_learning_rate=0.001 optimizer.latent_learning_rate=0.02 "
        "optimizer.weight_decay=0.0 windows.max_duration_seconds=3.0 windows.stride_seconds=1.0 "
        "latents.layout=local latents.knots=8 latents.knot_numbers=8 latents.path_knots=8 encoder.num_frequencies=8 "
        "encoder.num_queries=8 encoder.num_layers=1 encoder.framerate_scale=0.05 decoder.width=32 "
        "decoder.num_layers=3 decoder.activation=silu loss.scaling=group clips.num_poses=8 clips.contiguous=false "
        "clips.seconds_per_visit=2.5 clips.warmup_fraction=0.1 clips.lowest_fps=20.0".split(),
    ),
    denoiser=apply_overrides(
        DenoiserConfig(
            network=TransformerConfig(num_layers=3, width=32, num_heads=2, ffn_width=64, dropout=0.0, latent_tokens=8),
            ema_decay=0.9,
        ),
        f"schedule.epochs=none schedule.steps={STEPS} schedule.batch_size=16 schedule.learning_rate=0.002 "
        "schedule.kind=cosine conditions.text_encoder=none".split(),
    ),
)
STAGES: dict[str, tuple[Stage[Any], Any]] = {stage.name: (stage, NERM) for stage in (CODEBOOK, FIELD, DENOISER)}


def write_store(path: Path) -> Path:
    """Six takes of four seconds at 30, 60 and 120 fps, four of them for training."""
    with mk.StoreWriter.create(path) as writer:
        for index, rate in enumerate((120, 30, 60, 120, 120, 30)):
            grid = mk.TimeGrid(Fraction(rate), 4 * rate + 1)
            positions = analytic_positions(grid.seconds(), index % 4)
            split = "test" if index >= 4 else "train"
            action = ("walk", "sway")[index % 2]
            writer.add(mk.Motion(positions, mk.SMPL22, grid, split=split, sequence_id=f"take-{index}", action=action))
    return path


def train_stage(name: str, store: Path, run: Path, *, resume: bool = False, shared: bool = False) -> None:
    """Train one stage of a run on the CPU, `shared` by the ranks that this process has joined."""
    stage, config = STAGES[name]
    stage.train(StageContext(store, RunFolder(run), "tiny", seed=1, resume=resume, device="cpu", shared=shared), config)
