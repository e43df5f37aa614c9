"""MDM (Tevet et al. 2023; GuyTevet/motion-diffusion-model, model/mdm.py): diffusion of whole motions."""

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Float, Int64
from motionkit.training.diffusion.settings import DiffusionConfig
from peers.generative.batches import Conditions, ConditionSizes, MotionBatch, PoseSpace, SampleBatch, frames_within
from peers.generative.networks.layers import diffusion_loss, diffusion_sample, encoder_layer, sinusoids
from peers.generative.settings import MdmNetworkConfig


class Mdm(nn.Module):
    """Predicts x̂₀ of noisy frames with a transformer encoder over [time + condition; frames]."""

    def __init__(
        self, config: MdmNetworkConfig, space: PoseSpace, sizes: ConditionSizes, earlier: Mapping[str, nn.Module]
    ) -> None:
        super().__init__()
        width = config.transformer.width
        self.config, self.diffusion, self.width = config, config.diffusion, width
        self.numbers = space.num_features
        self.frame_in = nn.Linear(self.numbers, width)
        self.text_in = nn.Linear(sizes.text_dimension, width) if sizes.text_dimension else None
        self.actions = nn.Embedding(len(sizes.actions), width) if sizes.actions else None
        self.step_in = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.dropout = nn.Dropout(config.transformer.dropout)
        self.layers = nn.TransformerEncoder(
            encoder_layer(config.transformer), config.transformer.layers, enable_nested_tensor=False
        )
        self.frame_out = nn.Linear(width, self.numbers)

    def forward(
        self,
        noisy: Float[Tensor, "batch frames numbers"],
        steps: Int64[Tensor, "batch"],
        conditions: Conditions,
        lengths: Int64[Tensor, "batch"],
    ) -> Float[Tensor, "batch frames numbers"]:
        """The clean motion; padding frames are masked out of the attention."""
        first = self.step_in(sinusoids(steps, self.width))
        if self.text_in is not None:
            first = first + self.text_in(conditions.text)
        if self.actions is not None:
            known = (conditions.action >= 0)[:, None]
            first = first + self.actions(conditions.action.clamp(min=0)) * known
        tokens = torch.cat((first[:, None], self.frame_in(noisy)), dim=1)
        positions = sinusoids(torch.arange(tokens.shape[1], device=tokens.device), self.width)
        hidden = ~frames_within(lengths + 1, tokens.shape[1])
        tokens = self.layers(self.dropout(tokens + positions), src_key_padding_mask=hidden)
        clean: Tensor = self.frame_out(tokens[:, 1:])
        return clean

    def losses(self, batch: MotionBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Mean squared error over valid frames."""
        loss = diffusion_loss(
            lambda noisy, steps, conditions: self(noisy, steps, conditions, batch.lengths),
            *(batch.rows, batch.mask, batch.conditions, self.diffusion, generator),
        )
        return {"loss": loss}

    def sample(self, batch: SampleBatch, diffusion: DiffusionConfig) -> Float[Tensor, "batch frames numbers"]:
        """Standardised rows."""
        lengths = batch.lengths.to(batch.device)

        def output(noisy: Tensor, steps: Tensor, conditions: Conditions) -> Tensor:
            clean: Tensor = self(noisy, steps, conditions, lengths.repeat(len(noisy) // len(lengths)))
            return clean

        return diffusion_sample(output, batch, lambda: batch.noise_of_frames(self.numbers), diffusion)
