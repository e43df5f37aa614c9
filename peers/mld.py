"""MLD (Chen et al. 2023; ChenFengYe/motion-latent-diffusion, mld/models): diffusion in the latent space of a VAE."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn
from torch.nn.functional import smooth_l1_loss

from motionkit.core.shapes import Float
from motionkit.training.config import DiffusionConfig, Schedule
from motionkit.training.networks import Conditions, kl_divergence, reparameterized
from peers import layers
from peers.generating import MINILM, UNCONDITIONAL, PeerConfig, PeerStage, cosine
from peers.layers import Latents, LongSkips, NetworkInputs, PeerNetwork, Steps, TransformerSizes
from peers.motions import ConditionsConfig, Mask, MotionBatch, Rows, SampleBatch

VAE = "mld-vae"


@dataclass(frozen=True)
class MldVaeNetworkConfig:
    """MLD's VAE: transformers with long skip connections and one latent of the transformer's width.

    `longest` is the number of learned positions.
    """

    transformer: TransformerSizes = TransformerSizes(9, 256, 4, 1024)
    longest: int = 500
    joint_weight: float = 1.0
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
        self.encoder = LongSkips(config.transformer, layers.encoder_layer)
        self.decoder = LongSkips(config.transformer, layers.decoder_layer)
        self.frame_out = nn.Linear(width, inputs.space.num_features)

    def encode(self, rows: Rows, mask: Mask) -> tuple[Latents, Latents]:
        """μ and log σ²."""
        tokens = torch.cat((self.distribution.expand(len(rows), -1, -1), self.frame_in(rows)), dim=1)
        hidden = layers.hidden_tokens(mask, first=2)
        tokens = self.encoder(
            tokens + self.encoder_positions[: tokens.shape[1]],
            lambda layer, tokens: layer(tokens, src_key_padding_mask=hidden),
        )
        return tokens[:, 0], tokens[:, 1]

    def decode(self, latents: Latents, mask: Mask) -> Rows:
        """Standardised rows, zeros outside the mask."""
        memory, hidden = latents[:, None], ~mask
        queries = self.decoder_positions[: mask.shape[1]].expand(len(latents), -1, -1)
        tokens = self.decoder(queries, lambda layer, tokens: layer(tokens, memory, tgt_key_padding_mask=hidden))
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
        self.vae = (vae,)  # in a tuple: frozen, and saved with its own stage
        self.step_in = nn.Sequential(nn.Linear(config.time_features, width), nn.SiLU(), nn.Linear(width, width))
        size, actions = inputs.conditions.text_dimension, inputs.conditions.actions
        self.text_in = nn.Sequential(nn.ReLU(), nn.Linear(size, width)) if size else None
        self.actions = nn.Embedding(len(actions), width) if actions else None
        has_condition = self.text_in is not None or self.actions is not None
        self.positions = nn.Parameter(torch.rand(3 if has_condition else 2, width))
        self.layers = LongSkips(config.transformer, layers.encoder_layer)

    def forward(
        self, noisy: Float[Tensor, "batch 1 width"], steps: Steps, conditions: Conditions
    ) -> Float[Tensor, "batch 1 width"]:
        """ε of a noisy latent."""
        # Sinusoids with cos before sin (diffusers' `Timesteps` with `flip_sin_to_cos`).
        half = self.config.time_features // 2
        angles = steps[:, None].to(torch.float32) * 10_000.0 ** -(torch.arange(half, device=steps.device) / half)
        tokens = [noisy, self.step_in(torch.cat((angles.cos(), angles.sin()), dim=1))[:, None]]
        if self.text_in is not None:
            tokens.append(self.text_in(conditions.text)[:, None])
        if self.actions is not None:
            known = (conditions.action >= 0)[:, None]
            tokens.append((self.actions(conditions.action.clamp(min=0)) * known)[:, None])
        outputs: Tensor = self.layers(torch.cat(tokens, dim=1) + self.positions, lambda layer, tokens: layer(tokens))
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


SMALL_SKIPS = TransformerSizes(5, 128, 2, 256, dropout=0.0)
MLD_VAE = PeerStage(
    "mld-vae",
    "MLD, stage 1: a VAE of whole motions",
    MldVae,
    nano=PeerConfig(
        MldVaeNetworkConfig(SMALL_SKIPS),
        conditions=UNCONDITIONAL,
        schedule=replace(cosine(1200, 16, 5e-4), warmup_fraction=0.1),
        precision="auto",
    ),
    paper=PeerConfig(
        MldVaeNetworkConfig(),
        conditions=UNCONDITIONAL,
        schedule=Schedule(epochs=6000, batch_size=128),
        weight_decay=0.01,
    ),
)
MLD = PeerStage(
    "mld",
    "MLD, stage 2: diffusion of the VAE's latents",
    Mld,
    nano=PeerConfig(
        MldNetworkConfig(SMALL_SKIPS, time_features=128, noises=8),
        conditions=replace(MINILM, nothing="empty"),
        schedule=cosine(4000, 16, 3e-3),
        ema_decay=0.995,
        precision="auto",
    ),
    paper=PeerConfig(
        MldNetworkConfig(),
        conditions=ConditionsConfig(nothing="empty"),
        schedule=Schedule(epochs=2000),
        weight_decay=0.01,
    ),
    builds_on=(MLD_VAE,),
)
