"""MLD (Chen et al. 2023; ChenFengYe/motion-latent-diffusion, mld/models): diffusion in the latent space of a VAE."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn
from torch.nn.functional import pad, smooth_l1_loss

from motionkit.core.shapes import Float
from motionkit.training.config import DiffusionConfig, Schedule
from motionkit.training.networks import Conditions, kl_divergence, reparameterized, through_long_skips
from peers import layers
from peers.generating import CLIP, MINILM, UNCONDITIONAL, PeerConfig, PeerStage, cosine
from peers.layers import ConditionVector, Latents, NetworkInputs, PeerNetwork, Steps, Tokens, TransformerSizes
from peers.motions import Mask, MotionBatch, Rows, SampleBatch


@dataclass(frozen=True)
class MldVaeNetworkConfig:
    """MLD's VAE: transformers of these sizes and one latent of their width; `longest` counts learned positions."""

    transformer: TransformerSizes = TransformerSizes(9, 256, 4, 1024)
    longest: int = 500
    kl_weight: float = 1e-4


@dataclass(frozen=True)
class MldNetworkConfig:
    """MLD's denoiser over the tokens latent, time and condition; `time_features` is the size of the step embedding.

    Training draws `noises` noise samples per latent, since encoding costs far more than denoising.
    """

    transformer: TransformerSizes = TransformerSizes(9, 256, 4, 1024)
    time_features: int = 768
    noises: int = 1
    diffusion: DiffusionConfig = DiffusionConfig(sampling_spacing="leading")


class LongSkips(nn.Module):
    """Layers with long skip connections, then a layer norm (mld/models/operator/cross_attention.py)."""

    def __init__(self, sizes: TransformerSizes, make: Callable[[TransformerSizes], nn.Module]) -> None:
        super().__init__()
        if sizes.layers % 2 == 0:
            raise ValueError(f"long skips need an odd number of layers, not {sizes.layers}")
        self.layers = nn.ModuleList(make(sizes) for _ in range(sizes.layers))
        self.joins = nn.ModuleList(nn.Linear(2 * sizes.width, sizes.width) for _ in range(sizes.layers // 2))
        self.norm = nn.LayerNorm(sizes.width)

    def forward(self, tokens: Tokens, *memory: Tensor, **masks: Tensor) -> Tokens:
        """The tokens after all layers, which get `memory` and torch's padding masks too."""
        tokens = through_long_skips(tokens, self.layers, self.joins, lambda layer, each: layer(each, *memory, **masks))
        normed: Tensor = self.norm(tokens)
        return normed


class MldVae(PeerNetwork):
    """MLD, stage 1, a VAE with one latent per motion: transformers with long skip connections."""

    def __init__(self, config: MldVaeNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        width = config.transformer.width
        self.config, self.space, self.width = config, inputs.space, width
        self.frame_in = nn.Linear(inputs.space.num_features, width)
        self.distribution = nn.Parameter(torch.randn(2, width))
        self.encoder_positions = nn.Parameter(torch.rand(config.longest, width))
        self.decoder_positions = nn.Parameter(torch.rand(config.longest, width))
        self.encoder = LongSkips(config.transformer, layers.encoder_layer)
        self.decoder = LongSkips(config.transformer, layers.decoder_layer)
        self.frame_out = nn.Linear(width, inputs.space.num_features)

    def encode(self, rows: Rows, mask: Mask) -> tuple[Latents, Latents]:
        """μ and log σ²."""
        tokens = torch.cat((self.distribution.expand(len(rows), -1, -1), self.frame_in(rows)), dim=1)
        tokens = tokens + self.encoder_positions[: tokens.shape[1]]
        tokens = self.encoder(tokens, src_key_padding_mask=pad(~mask, (2, 0)))
        return tokens[:, 0], tokens[:, 1]

    def decode(self, latents: Latents, mask: Mask) -> Rows:
        """Standardised rows, zeros outside the mask."""
        queries = self.decoder_positions[: mask.shape[1]].expand(len(latents), -1, -1)
        tokens = self.decoder(queries, latents[:, None], tgt_key_padding_mask=~mask)
        rows: Tensor = self.frame_out(tokens) * mask[..., None]
        return rows

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Smooth L1 of pose vectors and of joints over valid frames, and KL, each averaged over elements."""
        mask, joints_of = batch.mask, self.space.joints
        mean, log_variance = self.encode(batch.rows, mask)
        predicted = self.decode(reparameterized(mean, log_variance, batch.generator), mask)
        features = smooth_l1_loss(predicted[mask], batch.rows[mask])
        joints = smooth_l1_loss(joints_of(predicted)[mask], joints_of(batch.rows)[mask])
        kl = kl_divergence(mean, log_variance).mean()
        loss = features + joints + self.config.kl_weight * kl
        return {"loss": loss, "features": features, "joints": joints, "kl": kl}


class Mld(PeerNetwork):
    """MLD, stage 2: predicts a latent's noise with a long-skip transformer over [latent, time, condition]."""

    def __init__(self, config: MldNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        vae, width = inputs.earlier, config.transformer.width
        assert isinstance(vae, MldVae)
        if vae.width != width:
            raise ValueError(f"the VAE's latent has {vae.width} numbers, the denoiser's tokens {width}")
        self.config, self.diffusion, self.width = config, config.diffusion, width
        self.vae = (vae,)  # in a tuple: frozen, and saved with its own stage
        self.step_in = nn.Sequential(nn.Linear(config.time_features, width), nn.SiLU(), nn.Linear(width, width))
        self.condition = ConditionVector(inputs.conditions, width, null_text=True)
        has_condition = bool(inputs.conditions.text_dimension or inputs.conditions.actions)
        self.positions = nn.Parameter(torch.rand(2 + has_condition, width))
        self.layers = LongSkips(config.transformer, layers.encoder_layer)

    def forward(self, noisy: Tokens, steps: Steps, conditions: Conditions) -> Float[Tensor, "batch 1 width"]:
        """ε of a noisy latent, [batch, 1, width]."""
        # Sinusoids with cos before sin (diffusers' `Timesteps` with `flip_sin_to_cos`).
        half = self.config.time_features // 2
        angles = steps[:, None].to(torch.float32) * 10_000.0 ** -(torch.arange(half, device=steps.device) / half)
        time = self.step_in(torch.cat((angles.cos(), angles.sin()), dim=1))
        condition = self.condition(replace(conditions, text=conditions.text.relu()))
        tokens = torch.cat((noisy, time[:, None], condition[:, None]), dim=1)[:, : len(self.positions)]
        outputs: Tensor = self.layers(tokens + self.positions)
        return outputs[:, :1]

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Squared error of ε, with latents resampled at every step."""
        with torch.no_grad():
            latents = reparameterized(*self.vae[0].encode(batch.rows, batch.mask), batch.generator)[:, None]
        rows = torch.arange(len(latents)).repeat(self.config.noises)
        latents, batch = latents[rows], replace(batch, conditions=batch.conditions.rows(rows))
        every = torch.ones(latents.shape[:2], dtype=torch.bool, device=latents.device)
        return {"loss": layers.diffusion_loss(self, self.config.diffusion, batch, latents, every)}

    def sample(self, batch: SampleBatch) -> Rows:
        """Standardised rows."""
        latents = layers.diffusion_sample(self, batch, lambda: batch.noise(1, self.width))
        return self.vae[0].decode(latents[:, 0].float(), batch.mask)


SKIPS, PUBLISHED_VAE = TransformerSizes(5, 128, 2, 256, dropout=0.0), Schedule(epochs=6000, batch_size=128)
NANO_VAE = PeerConfig(MldVaeNetworkConfig(SKIPS), cosine(1200, 16, 5e-4, 0.1), UNCONDITIONAL, precision="auto")
PAPER_VAE = PeerConfig(MldVaeNetworkConfig(), PUBLISHED_VAE, UNCONDITIONAL, weight_decay=0.01)
MLD_VAE = PeerStage("mld-vae", MldVae, NANO_VAE, PAPER_VAE)
SIZES, MINILM_OF_NOTHING = MldNetworkConfig(SKIPS, time_features=128, noises=8), replace(MINILM, nothing="empty")
NANO = PeerConfig(SIZES, cosine(4000, 16, 3e-3), MINILM_OF_NOTHING, precision="auto", ema_decay=0.995)
PAPER = PeerConfig(MldNetworkConfig(), Schedule(epochs=2000), replace(CLIP, nothing="empty"), weight_decay=0.01)
MLD = PeerStage("mld", Mld, NANO, PAPER, builds_on=MLD_VAE)
