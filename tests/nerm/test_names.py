"""Rows of NeRM are called "as published" only if all that the paper states is the paper's."""

from pathlib import Path

import pytest

from motionkit.core.files import write_json
from motionkit.training.config import apply_overrides, to_plain
from motionkit.training.run import RunFolder
from nerm.names import LAYERS, LOCAL, OTHERWISE, PUBLISHED, row_name
from nerm.recipes import RECIPES, NermConfig

WINDOWS = 5120
# Steps of the paper's epochs on this many windows, and T2M-GPT's of the codebook.
STEPS = {"codebook": 300_000, "field": 20_000 * WINDOWS // 4096, "denoiser": 3000 * WINDOWS // 64}


def name_of(folder: Path, config: NermConfig, steps: dict[str, int]) -> str:
    """The name of a run whose stages were trained for so many steps each."""
    run = RunFolder(folder)
    for name, count in steps.items():
        stage = run.stage(name)
        stage.path.mkdir(parents=True)
        write_json(stage.config_path, {"config": to_plain(config)})
        published = config.codebook.published.weights if name == "codebook" else ""
        made = {"from": published} if published else {"steps" if name == "denoiser" else "step": count}
        stage.finish({**made, "windows": WINDOWS})
    return row_name(run, config.field, config.denoiser)


@pytest.mark.parametrize(
    ("recipe", "name"),
    [("nano", LOCAL), ("demo", LOCAL), ("base", LOCAL), ("paper", PUBLISHED)],
)
def test_recipes_are_named_by_their_settings(tmp_path: Path, recipe: str, name: str) -> None:
    config = RECIPES[recipe]()
    assert name_of(tmp_path, config, STEPS) == row_name(RunFolder(tmp_path), config.field) == name


@pytest.mark.parametrize(
    ("override", "name"),
    [
        ("field.clips.fixed_fps=20", PUBLISHED),
        ("field.pose_vectors=rotations", PUBLISHED),
        ("field.where=fps > 30", PUBLISHED),
        ("denoiser.conditions.text_encoder=none", PUBLISHED),
        ("codebook.published.weights=t2m-gpt.pth", PUBLISHED),
        ("denoiser.conditions.text_encoder=minilm", f"{LAYERS}, texts by minilm"),
        ("denoiser.precision=bfloat16", f"{LAYERS}, bfloat16"),
        ("codebook.network.num_codes=256", f"{LAYERS}, codebook 256 × 512"),
        ("codebook.schedule.batch_size=16", f"{LAYERS}, another codebook training"),
        ("field.schedule.learning_rate=1e-3", OTHERWISE),
        ("field.pose_vectors=field", OTHERWISE),
        ("field.clips.contiguous=false", OTHERWISE),
        ("field.latents.dimension=128", OTHERWISE),
        ("denoiser.diffusion.prediction=velocity", OTHERWISE),
        ("denoiser.ema_decay=0.99", OTHERWISE),
    ],
)
def test_another_setting_than_the_paper_s_is_not_called_as_published(tmp_path: Path, override: str, name: str) -> None:
    assert name_of(tmp_path, apply_overrides(RECIPES["paper"](), [override]), STEPS) == name


@pytest.mark.parametrize(
    ("steps", "name"),
    [
        ({"field": STEPS["field"] * 100 // 101}, PUBLISHED),
        ({"field": STEPS["field"] * 100 // 102}, f"{LAYERS}, short training"),
        ({"denoiser": STEPS["denoiser"] * 102 // 100}, f"{LAYERS}, long training"),
        ({"codebook": 30}, f"{LAYERS}, another codebook training"),
    ],
)
def test_the_steps_that_were_made_count_and_not_those_of_the_settings(
    tmp_path: Path, steps: dict[str, int], name: str
) -> None:
    assert name_of(tmp_path, RECIPES["paper"](), STEPS | steps) == name


def test_one_step_of_two_clips_with_another_text_encoder_names_all_that_differs(tmp_path: Path) -> None:
    settings = ["field.schedule.batch_size=2", "denoiser.schedule.batch_size=2"]
    config = apply_overrides(RECIPES["paper"](), [*settings, "denoiser.conditions.text_encoder=minilm"])
    differences = "short training, field batches of 2, denoiser batches of 2, texts by minilm"
    assert name_of(tmp_path, config, STEPS | {"field": 1, "denoiser": 1}) == f"{LAYERS}, {differences}"
