"""ACTOR (Petrovich et al. 2021; Mathux/ACTOR, src/models/architectures/transformer.py): a conditional VAE."""

from dataclasses import dataclass, field, replace

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Float
from motionkit.training.config import DiffusionConfig, Schedule
from motionkit.training.networks import Conditions, kl_divergence, reparameterized
from peers.generating import GIVEN, GIVEN_MINILM, SMALL, OptimizerConfig, PeerStage, cosine
from peers.layers import (
    ConditionVector,
    NetworkInputs,
    PeerNetwork,
    TransformerSizes,
    decoder_layer,
    encoder_layer,
    sinusoids,
)
from peers.motions import Lengths, Mask, MotionBatch, MotionsConfig, Rows, SampleBatch, frames_within


@dataclass(frozen=True)
class ActorNetworkConfig:
    """ACTOR: transformers of these sizes to one latent of their width and back."""

    transformer: TransformerSizes = field(default_factory=lambda: TransformerSizes(8, 256, 4, 1024))
    joint_weight: float = 1.0
    kl_weight: float = 1e-5


class Actor(PeerNetwork):
    """Conditional transformer VAE with one latent per motion."""

    def __init__(self, config: ActorNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        transformer = config.transformer
        width = transformer.width
        self.config, self.space, self.width = config, inputs.space, width
        self.frame_in = nn.Linear(inputs.space.num_features, width)
        self.mean_token, self.variance_token = (
            ConditionVector(inputs.conditions, width),
            ConditionVector(inputs.conditions, width),
        )
        self.bias = ConditionVector(inputs.conditions, width)
        self.dropout = nn.Dropout(transformer.dropout)
        self.encoder = nn.TransformerEncoder(encoder_layer(transformer), transformer.layers, enable_nested_tensor=False)
        self.decoder = nn.TransformerDecoder(decoder_layer(transformer), transformer.layers)
        self.frame_out = nn.Linear(width, inputs.space.num_features)

    def encode(
        self, rows: Rows, lengths: Lengths, conditions: Conditions
    ) -> tuple[Float[Tensor, "batch width"], Float[Tensor, "batch width"]]:
        """μ and log σ²: the outputs of two condition tokens."""
        first = torch.stack((self.mean_token(conditions), self.variance_token(conditions)), dim=1)
        tokens = torch.cat((first, self.frame_in(rows)), dim=1)
        hidden = ~frames_within(lengths + 2, tokens.shape[1])
        tokens = self.encoder(self.dropout(tokens + self._positions(tokens)), src_key_padding_mask=hidden)
        return tokens[:, 0], tokens[:, 1]

    def decode(self, latents: Float[Tensor, "batch width"], mask: Mask, conditions: Conditions) -> Rows:
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

    def sample(self, batch: SampleBatch, diffusion: DiffusionConfig) -> Rows:
        """Standardised rows decoded from z ~ N(0, I)."""
        latents = batch.noise(self.width).to(batch.device, torch.float32)
        mask = batch.mask
        return self.decode(latents, mask, batch.conditions.to(batch.device))

    def _positions(self, tokens: Float[Tensor, "batch tokens width"]) -> Float[Tensor, "tokens width"]:
        return sinusoids(torch.arange(tokens.shape[1], device=tokens.device), self.width)


ACTOR = PeerStage(
    "actor",
    "ACTOR: a conditional VAE of whole motions",
    Actor,
    {
        "nano": {
            "network": ActorNetworkConfig(SMALL),
            "conditions": GIVEN_MINILM,
            "schedule": cosine(2900, 16, 5e-4),
            "precision": "auto",
        },
        "paper": {
            "network": ActorNetworkConfig(),
            "motions": MotionsConfig(max_frames=60),
            "conditions": replace(GIVEN, kind="action"),
            "schedule": Schedule(epochs=5000, batch_size=20),
            "optimizer": OptimizerConfig(weight_decay=0.01),
        },
    },
)
