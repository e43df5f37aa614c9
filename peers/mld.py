"""MLD (Chen et al. 2023; ChenFengYe/motion-latent-diffusion, mld/models): diffusion in the latent space of a VAE."""

from dataclasses import dataclass, field, replace

import torch
from torch import Tensor, nn
from torch.nn.functional import smooth_l1_loss

from motionkit.core.shapes import Float, Int64
from motionkit.training.config import DiffusionConfig, Schedule
from motionkit.training.networks import Conditions, kl_divergence, reparameterized
from peers.generating import MINILM, UNCONDITIONAL, OptimizerConfig, PeerStage, cosine
from peers.layers import (
    LongSkips,
    NetworkInputs,
    PeerNetwork,
    TransformerSizes,
    decoder_layer,
    diffusion_loss,
    diffusion_sample,
    encoder_layer,
    padding_masked,
)
from peers.motions import ConditionsConfig, Lengths, Mask, MotionBatch, Rows, SampleBatch, frames_within

VAE = "mld-vae"


@dataclass(frozen=True)
class MldVaeNetworkConfig:
    """MLD's VAE: transformers with long skip connections and one latent of the transformer's width.

    `longest` is the number of learned positions.
    """

    transformer: TransformerSizes = field(default_factory=lambda: TransformerSizes(9, 256, 4, 1024))
    longest: int = 500
    joint_weight: float = 1.0
    kl_weight: float = 1e-4


@dataclass(frozen=True)
class MldNetworkConfig:
    """MLD's denoiser over the tokens latent, time and condition; `time_features` is the size of the step embedding.

    Training draws `noises` noise samples per latent, since encoding costs far more than denoising.
    """

    transformer: TransformerSizes = field(default_factory=lambda: TransformerSizes(9, 256, 4, 1024))
    time_features: int = 768
    noises: int = 1
    diffusion: DiffusionConfig = field(default_factory=lambda: DiffusionConfig(sampling_spacing="leading"))


class MldVae(PeerNetwork):
    """VAE with one latent per motion: transformers with long skip connections."""

    def __init__(self, config: MldVaeNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        width = config.transformer.width
        self.config, self.space, self.width = config, inputs.space, width
        self.frame_in = nn.Linear(inputs.space.num_features, width)
        self.distribution = nn.Parameter(torch.randn(2, width))
        self.encoder_positions = nn.Parameter(torch.rand(config.longest, width))
        self.decoder_positions = nn.Parameter(torch.rand(config.longest, width))
        self.encoder = LongSkips(config.transformer, encoder_layer)
        self.decoder = LongSkips(config.transformer, decoder_layer)
        self.frame_out = nn.Linear(width, inputs.space.num_features)

    def encode(self, rows: Rows, lengths: Lengths) -> tuple[Float[Tensor, "batch width"], Float[Tensor, "batch width"]]:
        """μ and log σ²."""
        tokens = torch.cat((self.distribution.expand(len(rows), -1, -1), self.frame_in(rows)), dim=1)
        hidden = ~frames_within(lengths + 2, tokens.shape[1])
        tokens = self.encoder(tokens + self.encoder_positions[: tokens.shape[1]], padding_masked(hidden))
        return tokens[:, 0], tokens[:, 1]

    def decode(self, latents: Float[Tensor, "batch width"], mask: Mask) -> Rows:
        """Standardised rows, zeros outside the mask."""
        memory, hidden = latents[:, None], ~mask
        queries = self.decoder_positions[: mask.shape[1]].expand(len(latents), -1, -1)
        tokens = self.decoder(queries, lambda layer, tokens: layer(tokens, memory, tgt_key_padding_mask=hidden))
        rows: Tensor = self.frame_out(tokens) * mask[..., None]
        return rows

    def losses(self, batch: MotionBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Smooth L1 of pose vectors and of joints over valid frames, and KL, each averaged over elements."""
        mean, log_variance = self.encode(batch.rows, batch.lengths)
        made = self.decode(reparameterized(mean, log_variance, generator), batch.mask)
        features = smooth_l1_loss(made[batch.mask], batch.rows[batch.mask])
        joints = smooth_l1_loss(self.space.joints(made)[batch.mask], self.space.joints(batch.rows)[batch.mask])
        kl = kl_divergence(mean, log_variance).mean()
        loss = features + self.config.joint_weight * joints + self.config.kl_weight * kl
        return {"loss": loss, "features": features, "joints": joints, "kl": kl}


class Mld(PeerNetwork):
    """Predicts a latent's noise with a long-skip transformer over the tokens [latent, time, condition]."""

    def __init__(self, config: MldNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        vae = inputs.earlier[VAE]
        assert isinstance(vae, MldVae)
        width = config.transformer.width
        if vae.width != width:
            raise ValueError(f"the VAE's latent has {vae.width} numbers, the denoiser's tokens {width}")
        self.config, self.diffusion, self.width = config, config.diffusion, width
        self._vae = (vae,)  # in a tuple: frozen, and saved with its own stage
        self.step_in = nn.Sequential(nn.Linear(config.time_features, width), nn.SiLU(), nn.Linear(width, width))
        size, actions = inputs.conditions.text_dimension, inputs.conditions.actions
        self.text_in = nn.Sequential(nn.ReLU(), nn.Linear(size, width)) if size else None
        self.actions = nn.Embedding(len(actions), width) if actions else None
        has_condition = self.text_in is not None or self.actions is not None
        self.positions = nn.Parameter(torch.rand(3 if has_condition else 2, width))
        self.layers = LongSkips(config.transformer, encoder_layer)

    @property
    def vae(self) -> MldVae:
        """The trained VAE."""
        return self._vae[0]

    def forward(
        self, noisy: Float[Tensor, "batch 1 width"], steps: Int64[Tensor, "batch"], conditions: Conditions
    ) -> Float[Tensor, "batch 1 width"]:
        """ε of a noisy latent."""
        tokens = [noisy, self.step_in(step_features(steps, self.config.time_features))[:, None]]
        if self.text_in is not None:
            tokens.append(self.text_in(conditions.text)[:, None])
        if self.actions is not None:
            known = (conditions.action >= 0)[:, None]
            tokens.append((self.actions(conditions.action.clamp(min=0)) * known)[:, None])
        outputs: Tensor = self.layers(torch.cat(tokens, dim=1) + self.positions, padding_masked(None))
        return outputs[:, :1]

    def losses(self, batch: MotionBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Squared error of ε, with latents resampled at every step."""
        with torch.no_grad():
            latents = reparameterized(*self.vae.encode(batch.rows, batch.lengths), generator)[:, None]
        rows = torch.arange(len(latents)).repeat(self.config.noises)
        latents, conditions = latents[rows], batch.conditions.rows(rows)
        every = torch.ones(latents.shape[:2], dtype=torch.bool, device=latents.device)
        return {"loss": diffusion_loss(self, latents, every, conditions, self.config.diffusion, generator)}

    def sample(self, batch: SampleBatch, diffusion: DiffusionConfig) -> Rows:
        """Standardised rows."""
        latents = diffusion_sample(self, batch, lambda: batch.noise(1, self.width), diffusion)
        return self.vae.decode(latents[:, 0].float(), batch.mask)


def step_features(steps: Int64[Tensor, "batch"], width: int) -> Float[Tensor, "batch width"]:
    """Sinusoidal step embedding, cos before sin (diffusers' `Timesteps` with `flip_sin_to_cos`)."""
    exponents = torch.arange(width // 2, device=steps.device) / (width // 2)
    angles = steps[:, None].to(torch.float32) * 10_000.0 ** (-exponents)
    return torch.cat((angles.cos(), angles.sin()), dim=1)


SMALL_SKIPS = TransformerSizes(5, 128, 2, 256, dropout=0.0)
MLD_VAE = PeerStage(
    "mld-vae",
    "MLD, stage 1: a VAE of whole motions",
    MldVae,
    {
        "nano": {
            "network": MldVaeNetworkConfig(SMALL_SKIPS),
            "conditions": UNCONDITIONAL,
            "schedule": Schedule(steps=1200, batch_size=16, learning_rate=5e-4, kind="cosine", warmup_fraction=0.1),
            "precision": "auto",
        },
        "paper": {
            "network": MldVaeNetworkConfig(),
            "conditions": UNCONDITIONAL,
            "schedule": Schedule(epochs=6000, batch_size=128),
            "optimizer": OptimizerConfig(weight_decay=0.01),
        },
    },
)
MLD = PeerStage(
    "mld",
    "MLD, stage 2: diffusion of the VAE's latents",
    Mld,
    {
        "nano": {
            "network": MldNetworkConfig(SMALL_SKIPS, time_features=128, noises=8),
            "conditions": replace(MINILM, nothing="empty"),
            "schedule": cosine(4000, 16, 3e-3),
            "optimizer": OptimizerConfig(ema_decay=0.995),
            "precision": "auto",
        },
        "paper": {
            "network": MldNetworkConfig(),
            "conditions": ConditionsConfig(nothing="empty"),
            "schedule": Schedule(epochs=2000),
            "optimizer": OptimizerConfig(weight_decay=0.01),
        },
    },
    builds_on=(MLD_VAE,),
)
