"""NeRM's named recipes: `paper` (the paper's figures), `base` (an hour on a GPU), `nano` and `demo` (minutes on two
cores); what their settings mean stands in `nerm/settings/`.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

from nerm.settings import CodebookConfig, DenoiserConfig, DiffusionConfig, FieldConfig, TransformerConfig


@dataclass(frozen=True)
class NermConfig:
    """All stages of NeRM."""

    codebook: CodebookConfig = dataclasses.field(default_factory=CodebookConfig)
    field: FieldConfig = dataclasses.field(default_factory=FieldConfig)
    denoiser: DenoiserConfig = dataclasses.field(default_factory=DenoiserConfig)


def paper() -> NermConfig:
    """The paper's figures (§3, B.1, D), with what ../docs/deviations.md says where it is silent."""
    return NermConfig(denoiser=DenoiserConfig(text_encoder="clip", text_dimension=768))


def nano() -> NermConfig:
    """Two CPU cores and minutes: smaller networks, local latents, the settings that docs/results measured."""
    codebook = CodebookConfig(
        width=128, code_dimension=128, num_codes=256, steps=600, batch=48, rate=1e-3, rate_drop_at=480
    )
    return NermConfig(codebook=codebook, field=_local_field(steps=8000), denoiser=_knot_denoiser(steps=2500))


def base() -> NermConfig:
    """One GPU of the H100's kind for an hour: `nano` at the paper's widths; docs/nerm.md counts the FLOPs."""
    codebook = CodebookConfig(steps=20_000, rate_drop_at=13_000, precision="auto")
    field = dataclasses.replace(
        nano().field,
        mirrored=True,
        num_queries=256,
        hidden=1024,
        steps=60_000,
        batch=4096,
        rate=2e-3,
        attention_rate=5e-4,
    )
    denoiser = dataclasses.replace(
        nano().denoiser,
        network=TransformerConfig(num_layers=9, width=512, num_heads=8, ffn_width=2048, dropout=0.1, latent_tokens=16),
        batch=256,
        steps=80_000,
        rate=3e-4,
        ema_decay=0.9999,
        precision="auto",
    )
    return NermConfig(codebook=codebook, field=field, denoiser=denoiser)


def demo() -> NermConfig:
    """Three minutes on the embedded corpus: `nano` with a smaller codebook, sparser windows and fewer steps."""
    codebook = CodebookConfig(
        width=64, code_dimension=64, num_codes=128, steps=120, batch=32, rate=1e-3, rate_drop_at=100
    )
    return NermConfig(
        codebook=codebook,
        field=_local_field(steps=1200, stride_seconds=5.0),
        denoiser=_knot_denoiser(steps=1000),
    )


def _local_field(*, steps: int, stride_seconds: float = 2.0) -> FieldConfig:
    return FieldConfig(
        stride_seconds=stride_seconds,
        latent_layout="local",
        latent_dimension=768,
        knots=(32, 16),
        knot_numbers=(16, 13),
        path_knots=16,
        knot_kernel="lanczos",
        knot_radius=3.0,
        knot_modes=3,
        initial_log_variance=-8.0,
        initialisation="ridge",
        ridge=0.02,
        num_queries=64,
        hidden=256,
        activation="silu",
        linear_path=True,
        framerate_scale=0.05,
        scaling="group",
        root_weight=4.0,
        epochs=None,
        steps=steps,
        batch=256,
        num_poses=8,
        contiguous=False,
        seconds_per_visit=2.5,
        warmup_fraction=0.02,
        lowest_fps=20.0,
        rate=8e-3,
        attention_rate=1e-3,
        latent_rate=1e-2,
        weight_decay=0.0,
        schedule="cosine",
        # At full rate the first steps undo the start from the linear model, which the next hundred have to win back.
        rate_warmup_fraction=0.05,
        precision="auto",
    )


def _knot_denoiser(*, steps: int) -> DenoiserConfig:
    return DenoiserConfig(
        network=TransformerConfig(num_layers=5, width=192, ffn_width=512, dropout=0.0, latent_tokens=8),
        diffusion=DiffusionConfig(prediction="velocity", loss="velocity"),
        path="steps",
        latent_scale="component",
        guidance_scale=1.5,
        batch=64,
        steps=steps,
        epochs=None,
        rate=2e-3,
        schedule="cosine",
        rate_warmup_fraction=0.02,
        ema_decay=0.995,
    )


RECIPES: dict[str, Callable[[], NermConfig]] = {"nano": nano, "demo": demo, "base": base, "paper": paper}
