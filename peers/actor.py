"""ACTOR (Petrovich et al. 2021; Mathux/ACTOR, src/models/architectures/transformer.py): a conditional VAE."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss, pad

from motionkit.training.config import Schedule
from motionkit.training.networks import Conditions, kl_divergence, reparameterized
from peers import layers
from peers.generating import GIVEN_ACTION, GIVEN_MINILM, SMALL, PeerConfig, PeerStage, cosine
from peers.layers import ConditionVector, Latents, NetworkInputs, PeerNetwork, TransformerSizes, positions
from peers.motions import Mask, MotionBatch, MotionsConfig, Rows, SampleBatch


@dataclass(frozen=True)
class ActorNetworkConfig:
    """ACTOR: transformers of these sizes to one latent of their width and back."""

    transformer: TransformerSizes = TransformerSizes(8, 256, 4, 1024)
    kl_weight: float = 1e-5


class Actor(PeerNetwork):
    """ACTOR: a conditional transformer VAE with one latent per motion."""

    def __init__(self, config: ActorNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        sizes, width = config.transformer, config.transformer.width
        self.config, self.space, self.width = config, inputs.space, width
        self.frame_in = nn.Linear(inputs.space.num_features, width)
        self.mean_token, self.variance_token, self.bias = (ConditionVector(inputs.conditions, width) for _ in range(3))
        self.dropout = nn.Dropout(sizes.dropout)
        self.encoder = layers.encoder(sizes)
        self.decoder = nn.TransformerDecoder(layers.decoder_layer(sizes), sizes.layers)
        self.frame_out = nn.Linear(width, inputs.space.num_features)

    def encode(self, rows: Rows, mask: Mask, conditions: Conditions) -> tuple[Latents, Latents]:
        """μ and log σ²: the outputs of two condition tokens."""
        first = torch.stack((self.mean_token(conditions), self.variance_token(conditions)), dim=1)
        tokens = torch.cat((first, self.frame_in(rows)), dim=1)
        tokens = self.encoder(self.dropout(tokens + positions(tokens)), src_key_padding_mask=pad(~mask, (2, 0)))
        return tokens[:, 0], tokens[:, 1]

    def decode(self, latents: Latents, mask: Mask, conditions: Conditions) -> Rows:
        """Standardised rows, zeros outside the mask: queries attend to the latent, shifted by the condition."""
        memory = (latents + self.bias(conditions))[:, None]
        queries = torch.zeros((*mask.shape, self.width), device=latents.device)
        queries = self.dropout(queries + positions(queries))
        rows: Tensor = self.frame_out(self.decoder(queries, memory, tgt_key_padding_mask=~mask)) * mask[..., None]
        return rows

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Mean squared errors of pose vectors and joints over valid frames, and KL summed over the batch."""
        mask, joints_of = batch.mask, self.space.joints
        mean, log_variance = self.encode(batch.rows, mask, batch.conditions)
        predicted = self.decode(reparameterized(mean, log_variance, batch.generator), mask, batch.conditions)
        features = mse_loss(predicted[mask], batch.rows[mask])
        joints = mse_loss(joints_of(predicted)[mask], joints_of(batch.rows)[mask])
        kl = kl_divergence(mean, log_variance).sum()
        loss = features + joints + self.config.kl_weight * kl
        return {"loss": loss, "features": features, "joints": joints, "kl": kl}

    def sample(self, batch: SampleBatch) -> Rows:
        """Standardised rows decoded from z ~ N(0, I)."""
        return self.decode(batch.noise(self.width).float(), batch.mask, batch.conditions)


NANO = PeerConfig(ActorNetworkConfig(SMALL), cosine(2900, 16, 5e-4), GIVEN_MINILM, precision="auto")
PUBLISHED, SHORT = Schedule(epochs=5000, batch_size=20), MotionsConfig(max_frames=60)
PAPER = PeerConfig(ActorNetworkConfig(), PUBLISHED, GIVEN_ACTION, SHORT, weight_decay=0.01)
ACTOR = PeerStage("actor", Actor, NANO, PAPER)
