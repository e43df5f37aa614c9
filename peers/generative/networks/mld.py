"""MLD (Chen et al. 2023; ChenFengYe/motion-latent-diffusion, mld/models): diffusion in the latent space of a VAE."""

from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn.functional import smooth_l1_loss

from motionkit.core.shapes import Bool, Float, Int64
from motionkit.training.diffusion.settings import DiffusionConfig
from peers.generative.batches import Conditions, ConditionSizes, MotionBatch, PoseSpace, SampleBatch, frames_within
from peers.generative.networks.layers import (
    LongSkips,
    decoder_layer,
    diffusion_loss,
    diffusion_sample,
    encoder_layer,
    kl_divergence,
    padding_masked,
    reparameterized,
)
from peers.generative.settings import MldNetworkConfig, MldVaeNetworkConfig

VAE = "mld-vae"


class MldVae(nn.Module):
    """VAE with one latent per motion: transformers with long skip connections."""

    def __init__(
        self, config: MldVaeNetworkConfig, space: PoseSpace, sizes: ConditionSizes, earlier: Mapping[str, nn.Module]
    ) -> None:
        super().__init__()
        width = config.transformer.width
        self.config, self.space, self.width = config, space, width
        self.frame_in = nn.Linear(space.num_features, width)
        self.distribution = nn.Parameter(torch.randn(2, width))
        self.encoder_positions = nn.Parameter(torch.rand(config.longest, width))
        self.decoder_positions = nn.Parameter(torch.rand(config.longest, width))
        self.encoder = LongSkips(config.transformer, encoder_layer)
        self.decoder = LongSkips(config.transformer, decoder_layer)
        self.frame_out = nn.Linear(width, space.num_features)

    def encode(
        self, rows: Float[Tensor, "batch frames numbers"], lengths: Int64[Tensor, "batch"]
    ) -> tuple[Float[Tensor, "batch width"], Float[Tensor, "batch width"]]:
        """μ and log σ²."""
        tokens = torch.cat((self.distribution.expand(len(rows), -1, -1), self.frame_in(rows)), dim=1)
        hidden = ~frames_within(lengths + 2, tokens.shape[1])
        tokens = self.encoder(tokens + self.encoder_positions[: tokens.shape[1]], padding_masked(hidden))
        return tokens[:, 0], tokens[:, 1]

    def decode(
        self, latents: Float[Tensor, "batch width"], mask: Bool[Tensor, "batch frames"]
    ) -> Float[Tensor, "batch frames numbers"]:
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


class Mld(nn.Module):
    """Predicts a latent's noise with a long-skip transformer over the tokens [latent, time, condition]."""

    def __init__(
        self, config: MldNetworkConfig, space: PoseSpace, sizes: ConditionSizes, earlier: Mapping[str, nn.Module]
    ) -> None:
        super().__init__()
        vae = earlier[VAE]
        assert isinstance(vae, MldVae)
        width = config.transformer.width
        if vae.width != width:
            raise ValueError(f"the VAE's latent has {vae.width} numbers, the denoiser's tokens {width}")
        self.config, self.diffusion, self.width = config, config.diffusion, width
        self._vae = (vae,)  # in a tuple: frozen, and saved with its own stage
        self.step_in = nn.Sequential(nn.Linear(config.time_features, width), nn.SiLU(), nn.Linear(width, width))
        self.text_in = (
            nn.Sequential(nn.ReLU(), nn.Linear(sizes.text_dimension, width)) if sizes.text_dimension else None
        )
        self.actions = nn.Embedding(len(sizes.actions), width) if sizes.actions else None
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
        latents, conditions = latents.repeat(self.config.noises, 1, 1), batch.conditions.repeated(self.config.noises)
        every = torch.ones(latents.shape[:2], dtype=torch.bool, device=latents.device)
        return {"loss": diffusion_loss(self, latents, every, conditions, self.diffusion, generator)}

    def sample(self, batch: SampleBatch, diffusion: DiffusionConfig) -> Float[Tensor, "batch frames numbers"]:
        """Standardised rows."""
        latents = diffusion_sample(self, batch, lambda: batch.noise(1, self.width), diffusion)
        mask = frames_within(batch.lengths, batch.frames).to(batch.device)
        return self.vae.decode(latents[:, 0].float(), mask)


def step_features(steps: Int64[Tensor, "batch"], width: int) -> Float[Tensor, "batch width"]:
    """Sinusoidal step embedding, cos before sin (diffusers' `Timesteps` with `flip_sin_to_cos`)."""
    exponents = torch.arange(width // 2, device=steps.device) / (width // 2)
    angles = steps[:, None].to(torch.float32) * 10_000.0 ** (-exponents)
    return torch.cat((angles.cos(), angles.sin()), dim=1)
