"""MDM (Tevet et al. 2023; GuyTevet/motion-diffusion-model, model/mdm.py): diffusion of whole motions."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from motionkit.training.config import DiffusionConfig, Schedule
from motionkit.training.networks import Conditions
from peers import layers
from peers.generating import MINILM, SMALL, PeerConfig, PeerStage, cosine
from peers.layers import NetworkInputs, PeerNetwork, Steps, TransformerSizes, positions, sinusoids
from peers.motions import Mask, MotionBatch, Rows, SampleBatch


@dataclass(frozen=True)
class MdmNetworkConfig:
    """MDM: a transformer encoder over one token of time and condition, then frames; predicts the clean motion.

    1,000 steps as first published, all of them sampled; `mdm-50` is trained separately with 50.
    """

    transformer: TransformerSizes = TransformerSizes(8, 512, 4, 1024)
    diffusion: DiffusionConfig = DiffusionConfig(
        schedule="cosine", prediction="latent", sampler="ddpm", sampling_steps=1000, guidance_scale=2.5
    )


class Mdm(PeerNetwork):
    """Predicts x̂₀ of noisy frames with a transformer encoder over [time + condition; frames]."""

    def __init__(self, config: MdmNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        width = config.transformer.width
        self.config, self.diffusion, self.width = config, config.diffusion, width
        self.numbers = inputs.space.num_features
        self.frame_in = nn.Linear(self.numbers, width)
        size, actions = inputs.conditions.text_dimension, inputs.conditions.actions
        self.text_in = nn.Linear(size, width) if size else None
        self.actions = nn.Embedding(len(actions), width) if actions else None
        self.step_in = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.dropout = nn.Dropout(config.transformer.dropout)
        self.layers = layers.encoder(config.transformer)
        self.frame_out = nn.Linear(width, self.numbers)

    def forward(self, noisy: Rows, steps: Steps, conditions: Conditions, mask: Mask) -> Rows:
        """The clean motion; padding frames are masked out of the attention."""
        first = self.step_in(sinusoids(steps, self.width))
        if self.text_in is not None:
            first = first + self.text_in(conditions.text)
        if self.actions is not None:
            known = (conditions.action >= 0)[:, None]
            first = first + self.actions(conditions.action.clamp(min=0)) * known
        tokens = torch.cat((first[:, None], self.frame_in(noisy)), dim=1)
        hidden = layers.hidden_tokens(mask, first=1)
        tokens = self.layers(self.dropout(tokens + positions(tokens)), src_key_padding_mask=hidden)
        clean: Tensor = self.frame_out(tokens[:, 1:])
        return clean

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Mean squared error over valid frames."""
        network = layers.with_inputs(self, batch.mask)
        return {"loss": layers.diffusion_loss(network, self.config.diffusion, batch, batch.rows, batch.mask)}

    def sample(self, batch: SampleBatch) -> Rows:
        """Standardised rows."""
        network = layers.with_inputs(self, batch.mask)
        return layers.diffusion_sample(network, batch, lambda: batch.noise_within(batch.lengths, self.numbers))


NANO = PeerConfig(
    MdmNetworkConfig(SMALL), conditions=MINILM, schedule=cosine(6000, 16, 1e-3), ema_decay=0.995, precision="auto"
)
PAPER = PeerConfig(MdmNetworkConfig(), schedule=Schedule(steps=600_000))


def _in_50_steps(config: PeerConfig, ema_decay: float) -> PeerConfig:
    """The same training with 50 diffusion steps."""
    diffusion = replace(config.network.diffusion, num_steps=50, sampling_steps=50)
    network = replace(config.network, diffusion=diffusion)
    return replace(config, network=network, ema_decay=ema_decay)


MDM = PeerStage("mdm", "MDM: diffusion of whole motions in 1,000 steps (NeRM's peer)", Mdm, NANO, PAPER)
MDM_50 = PeerStage(
    "mdm-50", "MDM trained with 50 diffusion steps", Mdm, _in_50_steps(NANO, 0.995), _in_50_steps(PAPER, 0.9999)
)
