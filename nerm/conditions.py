"""NeRM's conditions as a denoiser's tokens: a text, an action or nothing, and a duration.

The null condition is a zero mask, as in the paper: the embedding of the text or action is replaced by zeros, so that
its token is the projection's bias alone. Guidance never drops the duration: the field needs it to decode the motion,
so both passes of Eq. 6 see it.
"""

import numpy as np
import torch
from torch import Tensor, nn

from motionkit.core.shapes import Float, Float32
from motionkit.training.conditions import Conditions, ConditionSizes


def unit_rows(embeddings: Float32[np.ndarray, "texts dimension"]) -> Float32[np.ndarray, "texts dimension"]:
    """Embeddings scaled to length 1; rows of zeros stay zeros."""
    lengths = np.linalg.norm(embeddings, axis=1, keepdims=True)
    return np.asarray(embeddings / np.where(lengths > 0, lengths, 1.0), dtype=np.float32)


DURATION_FREQUENCIES = 8


class ConditionEmbedding(nn.Module):
    """Conditions → three tokens: text, action, duration."""

    num_tokens = 3

    def __init__(self, sizes: ConditionSizes, width: int) -> None:
        super().__init__()
        self.text_in = nn.Linear(sizes.text_dimension, width)
        self.actions = nn.Embedding(max(len(sizes.actions), 1), width)
        self.duration_in = nn.Sequential(nn.Linear(2 * DURATION_FREQUENCIES, width), nn.SiLU(), nn.Linear(width, width))
        frequencies = 2.0 ** torch.arange(DURATION_FREQUENCIES) * (torch.pi / 8)
        self.register_buffer("frequencies", frequencies, persistent=False)
        self.frequencies: Tensor

    def forward(self, conditions: Conditions) -> Float[Tensor, "batch 3 width"]:
        """One token each; text embeddings are scaled to a root mean square of 1 before the projection."""
        text = self.text_in(conditions.text * conditions.text.shape[1] ** 0.5)
        known = (conditions.action >= 0)[:, None].to(text.dtype)
        action = self.actions(conditions.action.clamp(min=0)) * known
        angles = conditions.duration[:, None] * self.frequencies
        duration = self.duration_in(torch.cat((angles.cos(), angles.sin()), dim=1))
        return torch.stack((text, action, duration), dim=1)
