"""Every row of the ablation tables is a value of the configuration, trains, and differs in what it says alone."""

import numpy as np
import pytest
import torch

from motionkit.core.errors import UsageError
from motionkit.data.windows import FrameValues, WindowPoses
from motionkit.features.field import FIELD_VECTORS
from motionkit.store.cache import PositionCache
from motionkit.training.ablations import Variant
from motionkit.training.config import apply_overrides, flatten, parse_override
from motionkit.training.loop import step_generator
from nerm.field_training import FieldTraining, training_windows
from nerm.recipes import NERM, RECIPES, FieldConfig, NermConfig
from tests.helpers.nerm_corpus import analytic_source

CODES = torch.randn(20, 12, generator=torch.Generator().manual_seed(5))
SMALLER = (
    "field.windows.max_duration_seconds=4 field.windows.stride_seconds=4 field.decoder.width=24 "
    "field.decoder.num_layers=3 field.encoder.num_queries=8 field.encoder.num_frequencies=8 "
    "field.schedule.batch_size=8 field.schedule.epochs=none field.schedule.steps=12 "
    "field.schedule.learning_rate=2e-3 field.optimizer.latent_learning_rate=2e-2 field.precision=float32"
)
LAYOUTS = ("global", "local")
VARIANTS = sorted({variant for ablation in NERM.tables.values() for variant in ablation.variants}, key=lambda v: v.name)


GLOBAL, LOCAL = (next(each for each in VARIANTS if each.name == layout) for layout in LAYOUTS)


def _settings(recipe: str, *changes: str) -> FieldConfig:
    config: NermConfig = RECIPES[recipe]()
    return apply_overrides(config, [*SMALLER.split(), *changes]).field


def _training(config: FieldConfig, source: PositionCache | None = None) -> FieldTraining:
    source = source or analytic_source()
    windows = training_windows(source, config)
    poses = WindowPoses(windows, FrameValues(source.positions, FIELD_VECTORS), config.clips.fixed_framerate)
    return FieldTraining(poses, config, codebook=CODES, seed=3, device=torch.device("cpu"))


def _losses(training: FieldTraining) -> list[float]:
    return [
        float(training.step(step, step_generator(3, "field", step))["reconstruction"].detach())
        for step in range(training.steps)
    ]


@pytest.mark.parametrize("recipe", ["paper", "nano"])
@pytest.mark.parametrize("variant", VARIANTS, ids=lambda variant: variant.name)
def test_every_variant_trains(variant: Variant, recipe: str) -> None:
    losses = _losses(_training(_settings(recipe, *variant.needs(RECIPES[recipe]()), *variant.change)))
    assert np.isfinite(losses).all()
    assert np.mean(losses[-3:]) < np.mean(losses[:3])


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda variant: variant.name)
@pytest.mark.parametrize("recipe", sorted(RECIPES))
def test_a_variant_differs_from_its_layout_in_what_it_says(variant: Variant, recipe: str) -> None:
    layout = GLOBAL if variant.name.startswith(GLOBAL.name) else LOCAL
    base, ours = layout.configure(RECIPES[recipe]()), variant.configure(RECIPES[recipe]())
    assert ours.field.latents.layout == layout.name
    was, now = flatten(base), flatten(ours)
    changed = {key for key in now if now[key] != was[key]}
    assert changed <= {parse_override(setting)[0] for setting in variant.change}


def test_frame_numbers_and_knots_exclude_each_other() -> None:
    with pytest.raises(UsageError, match=r"use latents\.layout=global"):
        _settings("nano", "field.encoder.coordinates=frames")


def test_sequences_slower_than_a_fixed_framerate_are_left_out() -> None:
    source = analytic_source()
    windows = training_windows(source, _settings("nano", "field.clips.fixed_fps=60"))
    assert sorted(windows.fps) == [60.0, 120.0, 120.0]
    with pytest.raises(UsageError, match=r"no training sequence has 250 fps .* the fastest has 120"):
        training_windows(source, _settings("nano", "field.clips.fixed_fps=250"))
