"""MDM (Tevet et al. 2023; GuyTevet/motion-diffusion-model, model/mdm.py): diffusion of whole motions."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn
from torch.nn.functional import pad

from motionkit.training.config import DiffusionConfig, Schedule
from motionkit.training.networks import Conditions
from peers import layers
from peers.generating import MINILM, SMALL, PeerConfig, PeerStage, cosine
from peers.layers import ConditionVector, NetworkInputs, PeerNetwork, Steps, TransformerSizes, positions, sinusoids
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
    """MDM: predicts x̂₀ of noisy frames with a transformer encoder over [time + condition; frames]."""

    def __init__(self, config: MdmNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        width = config.transformer.width
        self.diffusion: DiffusionConfig = config.diffusion
        self.width, self.numbers = width, inputs.space.num_features
        self.frame_in = nn.Linear(self.numbers, width)
        self.condition = ConditionVector(inputs.conditions, width, null_text=True)
        self.step_in = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.dropout = nn.Dropout(config.transformer.dropout)
        self.layers = layers.encoder(config.transformer)
        self.frame_out = nn.Linear(width, self.numbers)

    def forward(self, noisy: Rows, steps: Steps, conditions: Conditions, mask: Mask) -> Rows:
        """The clean motion; padding frames are masked out of the attention."""
        first = self.step_in(sinusoids(steps, self.width)) + self.condition(conditions)
        tokens = torch.cat((first[:, None], self.frame_in(noisy)), dim=1)
        tokens = self.layers(self.dropout(tokens + positions(tokens)), src_key_padding_mask=pad(~mask, (1, 0)))
        clean: Tensor = self.frame_out(tokens[:, 1:])
        return clean

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Mean squared error over valid frames."""
        network = layers.with_inputs(self, batch.mask)
        return {"loss": layers.diffusion_loss(network, self.diffusion, batch, batch.rows, batch.mask)}

    def sample(self, batch: SampleBatch) -> Rows:
        """Standardised rows."""
        network = layers.with_inputs(self, batch.mask)
        return layers.diffusion_sample(network, batch, lambda: batch.noise_within(batch.lengths, self.numbers))


NANO = PeerConfig(MdmNetworkConfig(SMALL), cosine(6000, 16, 1e-3), MINILM, precision="auto", ema_decay=0.995)
PAPER = PeerConfig(MdmNetworkConfig(), Schedule(steps=600_000))
IN_50 = replace(MdmNetworkConfig().diffusion, num_steps=50, sampling_steps=50)
NANO_50 = replace(NANO, network=MdmNetworkConfig(SMALL, IN_50))
PAPER_50 = replace(PAPER, network=MdmNetworkConfig(diffusion=IN_50), ema_decay=0.9999)
MDM, MDM_50 = PeerStage("mdm", Mdm, NANO, PAPER), PeerStage("mdm-50", Mdm, NANO_50, PAPER_50)
