"""Conditions as the denoiser's tokens."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nerm.conditions.batch import ConditionLayout, Conditions

DURATION_FREQUENCIES = 8


class ConditionEmbedding(nn.Module):
    """Conditions → three tokens: text, action, duration."""

    num_tokens = 3

    def __init__(self, layout: ConditionLayout, width: int) -> None:
        super().__init__()
        self.text_in = nn.Linear(layout.text_dimension, width)
        self.actions = nn.Embedding(max(len(layout.actions), 1), width)
        self.duration_in = nn.Sequential(nn.Linear(2 * DURATION_FREQUENCIES, width), nn.SiLU(), nn.Linear(width, width))
        frequencies = 2.0 ** torch.arange(DURATION_FREQUENCIES) * (torch.pi / 8)
        self.register_buffer("frequencies", frequencies, persistent=False)
        self.frequencies: Tensor

    def forward(self, conditions: Conditions) -> Float[Tensor, "batch 3 width"]:
        """One token each; text is brought to a root mean square of 1 before its projection."""
        text = self.text_in(conditions.text * conditions.text.shape[1] ** 0.5)
        known = (conditions.action >= 0)[:, None].to(text.dtype)
        action = self.actions(conditions.action.clamp(min=0)) * known
        angles = conditions.duration[:, None] * self.frequencies
        duration = self.duration_in(torch.cat((angles.cos(), angles.sin()), dim=1))
        return torch.stack((text, action, duration), dim=1)
