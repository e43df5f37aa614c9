"""ACTOR (Petrovich et al. 2021; Mathux/ACTOR, src/models/architectures/transformer.py): a conditional VAE."""

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Bool, Float, Int64
from motionkit.training.diffusion.settings import DiffusionConfig
from peers.generative.batches import Conditions, ConditionSizes, MotionBatch, PoseSpace, SampleBatch, frames_within
from peers.generative.networks.layers import (
    ConditionVector,
    decoder_layer,
    encoder_layer,
    kl_divergence,
    reparameterized,
    sinusoids,
)
from peers.generative.settings import ActorNetworkConfig


class Actor(nn.Module):
    """Conditional transformer VAE with one latent per motion."""

    diffusion: DiffusionConfig | None = None

    def __init__(
        self, config: ActorNetworkConfig, space: PoseSpace, sizes: ConditionSizes, earlier: Mapping[str, nn.Module]
    ) -> None:
        super().__init__()
        transformer = config.transformer
        width = transformer.width
        self.config, self.space, self.width = config, space, width
        self.frame_in = nn.Linear(space.num_features, width)
        self.mean_token, self.variance_token = ConditionVector(sizes, width), ConditionVector(sizes, width)
        self.bias = ConditionVector(sizes, width)
        self.dropout = nn.Dropout(transformer.dropout)
        self.encoder = nn.TransformerEncoder(encoder_layer(transformer), transformer.layers, enable_nested_tensor=False)
        self.decoder = nn.TransformerDecoder(decoder_layer(transformer), transformer.layers)
        self.frame_out = nn.Linear(width, space.num_features)

    def encode(
        self, rows: Float[Tensor, "batch frames numbers"], lengths: Int64[Tensor, "batch"], conditions: Conditions
    ) -> tuple[Float[Tensor, "batch width"], Float[Tensor, "batch width"]]:
        """μ and log σ²: the outputs of two condition tokens."""
        first = torch.stack((self.mean_token(conditions), self.variance_token(conditions)), dim=1)
        tokens = torch.cat((first, self.frame_in(rows)), dim=1)
        hidden = ~frames_within(lengths + 2, tokens.shape[1])
        tokens = self.encoder(self.dropout(tokens + self._positions(tokens)), src_key_padding_mask=hidden)
        return tokens[:, 0], tokens[:, 1]

    def decode(
        self, latents: Float[Tensor, "batch width"], mask: Bool[Tensor, "batch frames"], conditions: Conditions
    ) -> Float[Tensor, "batch frames numbers"]:
        """Standardised rows, zeros outside the mask: queries attend to the latent, shifted by the condition."""
        memory = (latents + self.bias(conditions))[:, None]
        queries = torch.zeros((*mask.shape, self.width), device=latents.device)
        queries = self.dropout(queries + self._positions(queries))
        rows: Tensor = self.frame_out(self.decoder(queries, memory, tgt_key_padding_mask=~mask)) * mask[..., None]
        return rows

    def losses(self, batch: MotionBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Mean squared errors of pose vectors and joints over valid frames, and KL summed over the batch."""
        mean, log_variance = self.encode(batch.rows, batch.lengths, batch.conditions)
        made = self.decode(reparameterized(mean, log_variance, generator), batch.mask, batch.conditions)
        features = (made - batch.rows)[batch.mask].square().mean()
        joints = (self.space.joints(made) - self.space.joints(batch.rows))[batch.mask].square().mean()
        kl = kl_divergence(mean, log_variance).sum()
        loss = features + self.config.joint_weight * joints + self.config.kl_weight * kl
        return {"loss": loss, "features": features, "joints": joints, "kl": kl}

    def sample(self, batch: SampleBatch, diffusion: DiffusionConfig) -> Float[Tensor, "batch frames numbers"]:
        """Standardised rows decoded from z ~ N(0, I)."""
        latents = batch.noise(self.width).to(batch.device, torch.float32)
        mask = frames_within(batch.lengths, batch.frames).to(batch.device)
        return self.decode(latents, mask, batch.conditions.to(batch.device))

    def _positions(self, tokens: Float[Tensor, "batch tokens width"]) -> Float[Tensor, "tokens width"]:
        return sinusoids(torch.arange(tokens.shape[1], device=tokens.device), self.width)
