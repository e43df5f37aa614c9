"""Rows of NeRM are called "as published" only if all that the paper states is the paper's."""

from pathlib import Path

import pytest

from motionkit.core.files import write_json
from motionkit.training.config import apply_overrides, to_plain
from motionkit.training.run import RunFolder
from nerm.recipes import LAYERS, LOCAL, OTHERWISE, PUBLISHED, RECIPES, row_name


@pytest.mark.parametrize(
    ("recipe", "override", "name"),
    [
        ("nano", "", LOCAL),
        ("paper", "", PUBLISHED),
        ("paper", "codebook.published_weights=t2m-gpt.pth", PUBLISHED),
        ("paper", "field.clips.fixed_fps=20", PUBLISHED),
        ("paper", "denoiser.conditions.text_encoder=none", PUBLISHED),
        ("paper", "denoiser.conditions.text_encoder=minilm", LAYERS),
        ("paper", "field.schedule.epochs=20", LAYERS),
        ("paper", "budget_seconds=60", LAYERS),
        ("paper", "field.schedule.learning_rate=1e-3", OTHERWISE),
        ("paper", "denoiser.diffusion.prediction=velocity", OTHERWISE),
    ],
)
def test_rows_are_named_by_settings(tmp_path: Path, recipe: str, override: str, name: str) -> None:
    is_budget = override.startswith("budget_seconds")
    config = apply_overrides(RECIPES[recipe](), [override] if override and not is_budget else [])
    run = RunFolder(tmp_path)
    for stage in ("codebook", "field", "denoiser"):
        run.stage(stage).path.mkdir(parents=True)
        recorded = {"config": to_plain(config), "budget_seconds": 60.0 if is_budget else None}
        write_json(run.stage(stage).config_path, recorded)
        run.stage(stage).finish({})
    assert row_name(run, config.field, config.denoiser) == name
