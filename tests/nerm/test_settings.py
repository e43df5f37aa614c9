"""Settings of runs trained before some of them became constants."""

from typing import Any

import pytest

from motionkit.core.errors import UsageError
from motionkit.training.config import to_plain
from nerm.recipes import small
from nerm.settings import CodebookConfig, DenoiserConfig, FieldConfig, from_recorded

EARLIER_FIELD = {
    "windows": {"min_duration_seconds": 0.5},
    "clips": {"warmup_fps": 20},
    "latents": {"initialisation": "ridge"},
    "decoder": {"linear_path": True},
    "contacts": {"steps": 800, "batch_size": 256, "learning_rate": 3e-3, "width": 128, "noise": 0.4},
    "compile": False,
}
EARLIER_DENOISER = {
    "latents": {"path": "steps", "scale": "component"},
    "conditions": {"text_dimension": None, "drop": 0.1, "action_share": 0.25},
    "weight_decay": 0.01,
    "compile": False,
}
EARLIER_CODEBOOK = {
    "fps": 20,
    "network": {"residual_layers": 3, "ema_decay": 0.99, "reset_below": 1.0},
    "loss": {"position_weight": 0.5, "commitment_weight": 0.02},
    "schedule": {"drop": 0.05, "weight_decay": 0.0},
    "published": {"statistics": ""},
}


def merged(values: dict[str, Any], more: dict[str, Any]) -> dict[str, Any]:
    """Nested tables with further entries."""
    return values | {key: merged(values.get(key, {}), v) if isinstance(v, dict) else v for key, v in more.items()}


def test_settings_of_earlier_runs_are_read() -> None:
    config = small()
    field, denoiser = to_plain(config.field), to_plain(config.denoiser)
    del field["contact_steps"], denoiser["latent_scale"]
    assert from_recorded(FieldConfig, merged(field, EARLIER_FIELD)) == config.field
    assert from_recorded(DenoiserConfig, merged(denoiser, EARLIER_DENOISER)) == config.denoiser
    assert from_recorded(CodebookConfig, merged(to_plain(config.codebook), EARLIER_CODEBOOK)) == config.codebook


@pytest.mark.parametrize("other", [{"clips": {"warmup_fps": 30}}, {"contacts": {"width": 32}}, {"unheard_of": 1}])
def test_settings_with_other_values_than_the_constants_are_refused(other: dict[str, Any]) -> None:
    with pytest.raises(UsageError):
        from_recorded(FieldConfig, merged(to_plain(small().field), other))
