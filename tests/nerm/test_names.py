"""What rows of NeRM are called: ours, the paper's, and what is neither."""

import pytest

from motionkit.training.config import apply_overrides
from nerm.names import LOCAL, OTHERWISE, PUBLISHED, row_name
from nerm.recipes import RECIPES


@pytest.mark.parametrize(
    ("recipe", "name"),
    [("nano", LOCAL), ("demo", LOCAL), ("base", LOCAL), ("paper", PUBLISHED)],
)
def test_recipes_are_named_by_their_settings(recipe: str, name: str) -> None:
    config = RECIPES[recipe]()
    assert row_name(config.field) == row_name(config.field, config.denoiser) == name


@pytest.mark.parametrize(
    ("override", "name"),
    [
        ("field.schedule.epochs=3", PUBLISHED),
        ("field.clips.fixed_fps=20", PUBLISHED),
        ("field.pose_vectors=rotations", PUBLISHED),
        ("field.where=fps > 30", PUBLISHED),
        ("denoiser.conditions.text_encoder=minilm", PUBLISHED),
        ("field.schedule.learning_rate=1e-3", OTHERWISE),
        ("field.pose_vectors=field", OTHERWISE),
        ("field.clips.contiguous=false", OTHERWISE),
        ("field.latents.dimension=128", OTHERWISE),
        ("denoiser.diffusion.prediction=velocity", OTHERWISE),
        ("denoiser.ema_decay=0.99", OTHERWISE),
    ],
)
def test_another_setting_than_the_paper_s_is_not_called_as_published(override: str, name: str) -> None:
    config = apply_overrides(RECIPES["paper"](), [override])
    assert row_name(config.field, config.denoiser) == name
