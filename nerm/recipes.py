"""NeRM's recipes: `paper` (the paper's settings), `base` (an hour on a GPU), `small` (an hour and a half on two
cores), `nano` and `demo` (minutes there). `nerm/settings.py` documents the settings.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, replace

from motionkit.training.config import DiffusionConfig, Schedule
from nerm.settings import (
    ClipsConfig,
    CodebookConfig,
    CodebookNetworkConfig,
    CodebookScheduleConfig,
    ConditionsConfig,
    DecoderConfig,
    DenoiserConfig,
    EncoderConfig,
    FieldConfig,
    FieldLossConfig,
    FieldOptimizerConfig,
    LatentsConfig,
    TransformerConfig,
    WindowsConfig,
)


@dataclass(frozen=True)
class NermConfig:
    """All stages of NeRM."""

    codebook: CodebookConfig = dataclasses.field(default_factory=CodebookConfig)
    field: FieldConfig = dataclasses.field(default_factory=FieldConfig)
    denoiser: DenoiserConfig = dataclasses.field(default_factory=DenoiserConfig)


def paper() -> NermConfig:
    """The paper's settings (§3, B.1, D) and its 263 numbers; where it is silent, those of docs/deviations.md.

    Its action task (§4.2, A) needs field.pose_vectors=rotations and denoiser.conditions.text_encoder=none too.
    """
    return NermConfig(
        field=FieldConfig(pose_vectors="native"),
        denoiser=DenoiserConfig(conditions=ConditionsConfig(text_encoder="clip")),
    )


def nano() -> NermConfig:
    """Minutes on two CPU cores: smaller networks, local latents, the settings measured in docs/results."""
    return NermConfig(
        codebook=CodebookConfig(
            network=CodebookNetworkConfig(width=128, code_dimension=128, num_codes=256),
            schedule=CodebookScheduleConfig(steps=600, batch_size=48, learning_rate=1e-3, drop_at=480),
        ),
        field=replace(_local_field(steps=8000), contact_steps=800),
        denoiser=_knot_denoiser(steps=8000, paraphrases=12),
    )


def small() -> NermConfig:
    """An hour and a half on two CPU cores: `nano` with mirrored windows, a wider denoiser and more steps."""
    field, denoiser = nano().field, nano().denoiser
    return replace(
        nano(),
        field=replace(
            field,
            windows=replace(field.windows, mirrored=True),
            schedule=replace(field.schedule, steps=16_000),
        ),
        denoiser=replace(
            denoiser,
            network=replace(denoiser.network, num_layers=7, width=256, ffn_width=768),
            schedule=replace(denoiser.schedule, steps=16_000, learning_rate=1.5e-3),
            ema_decay=0.998,
        ),
    )


def base() -> NermConfig:
    """An hour on an H100: `nano` at the paper's widths; docs/nerm.md counts the FLOPs."""
    field, denoiser = nano().field, nano().denoiser
    return NermConfig(
        codebook=CodebookConfig(schedule=CodebookScheduleConfig(steps=20_000, drop_at=13_000), precision="auto"),
        field=replace(
            field,
            windows=replace(field.windows, mirrored=True),
            encoder=replace(field.encoder, num_queries=256),
            decoder=replace(field.decoder, width=1024),
            schedule=replace(field.schedule, steps=60_000, batch_size=4096, learning_rate=2e-3),
            optimizer=replace(field.optimizer, attention_learning_rate=5e-4),
        ),
        denoiser=replace(
            denoiser,
            network=TransformerConfig(width=512, num_heads=8, ffn_width=2048, latent_tokens=16),
            schedule=replace(denoiser.schedule, steps=80_000, batch_size=256, learning_rate=3e-4),
            ema_decay=0.9999,
        ),
    )


def demo() -> NermConfig:
    """For the embedded corpus, minutes: `nano` with a smaller codebook, sparser windows and fewer steps."""
    return NermConfig(
        codebook=CodebookConfig(
            network=CodebookNetworkConfig(width=64, code_dimension=64, num_codes=128),
            schedule=CodebookScheduleConfig(steps=120, batch_size=32, learning_rate=1e-3, drop_at=100),
        ),
        field=_local_field(steps=1200, stride_seconds=5.0),
        denoiser=_knot_denoiser(steps=1000),
    )


def _local_field(*, steps: int, stride_seconds: float = 2.0) -> FieldConfig:
    return FieldConfig(
        windows=WindowsConfig(stride_seconds=stride_seconds),
        clips=ClipsConfig(num_poses=8, contiguous=False, seconds_per_visit=2.5, warmup_fraction=0.02, lowest_fps=20.0),
        latents=LatentsConfig(
            layout="local",
            knots=(32, 16),
            knot_numbers=(16, 13),
            path_knots=16,
            kernel="lanczos",
            radius=3.0,
            modes=3,
            initial_log_variance=-8.0,
            ridge=0.02,
        ),
        encoder=EncoderConfig(num_queries=64, framerate_scale=0.05),
        decoder=DecoderConfig(width=256, activation="silu"),
        loss=FieldLossConfig(scaling="group", root_weight=4.0),
        schedule=Schedule(
            steps=steps,
            batch_size=256,
            learning_rate=8e-3,
            kind="cosine",
            # At full learning rate the first steps undo the linear initialisation; recovering it takes a hundred.
            warmup_fraction=0.05,
        ),
        optimizer=FieldOptimizerConfig(attention_learning_rate=1e-3, latent_learning_rate=1e-2, weight_decay=0.0),
        precision="auto",
    )


def _knot_denoiser(*, steps: int, paraphrases: int = 0) -> DenoiserConfig:
    return DenoiserConfig(
        network=TransformerConfig(num_layers=5, width=192, ffn_width=512, dropout=0.0, latent_tokens=8),
        diffusion=DiffusionConfig(prediction="velocity", loss="velocity", sampling_steps=10, guidance_scale=2.0),
        latent_scale="component",
        conditions=ConditionsConfig(paraphrases=paraphrases),
        schedule=Schedule(steps=steps, learning_rate=2e-3, kind="cosine", warmup_fraction=0.02),
        ema_decay=0.995,
        precision="auto",
    )


RECIPES: dict[str, Callable[[], NermConfig]] = {
    "nano": nano,
    "small": small,
    "demo": demo,
    "base": base,
    "paper": paper,
}
