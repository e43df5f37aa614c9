"""Conditions of a batch: a text, an action or nothing, and a duration.

The null condition is a zero mask, as in the paper: the embedding of the text or action is replaced by zeros, so that
its token is the projection's bias alone. Guidance never drops the duration: the field needs it to decode the motion,
so both passes of Eq. 6 see it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor, nn

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Bool, Float, Float32, Int64

NO_ACTION = -1


@dataclass(frozen=True)
class ConditionLayout:
    """The conditions of a denoiser: the size of a text embedding and the names of the actions."""

    text_dimension: int
    actions: tuple[str, ...]

    def action_index(self, action: str) -> int:
        """Index of an action, `NO_ACTION` for an empty name; raises `UsageError` naming the known ones."""
        if not action:
            return NO_ACTION
        if action not in self.actions:
            known = ", ".join(self.actions) or "none (its training data had no actions)"
            raise UsageError(f"the model knows no action {action!r}; it knows {known}")
        return self.actions.index(action)


@dataclass(frozen=True, eq=False)
class Conditions:
    """A batch of conditions.

    `text` holds unit-length embeddings, zeros where there is no text; `action` indices, `NO_ACTION` where there is
    none; `duration` is in units of l_max.
    """

    text: Float32[Tensor, "batch text"]
    action: Int64[Tensor, "batch"]
    duration: Float32[Tensor, "batch"]

    def dropped(self, where: Bool[Tensor, "batch"]) -> "Conditions":
        """The same conditions, zero-masked in the rows `where`; durations stay."""
        return replace(
            self,
            text=torch.where(where[:, None], torch.zeros_like(self.text), self.text),
            action=torch.where(where, torch.full_like(self.action, NO_ACTION), self.action),
        )

    def unconditional(self) -> "Conditions":
        """∅: every row zero-masked; durations stay."""
        return self.dropped(torch.ones(len(self.action), dtype=torch.bool, device=self.action.device))

    def stacked_on(self, other: "Conditions") -> "Conditions":
        """These rows followed by the other's."""
        return Conditions(
            text=torch.cat((self.text, other.text)),
            action=torch.cat((self.action, other.action)),
            duration=torch.cat((self.duration, other.duration)),
        )

    def rows(self, rows: slice) -> "Conditions":
        """Some of the rows."""
        return Conditions(self.text[rows], self.action[rows], self.duration[rows])

    def to(self, device: torch.device | str) -> "Conditions":
        """The same conditions on a device."""
        return Conditions(self.text.to(device), self.action.to(device), self.duration.to(device))


def unit_rows(embeddings: Float32[np.ndarray, "texts dimension"]) -> Float32[np.ndarray, "texts dimension"]:
    """Embeddings scaled to length 1; rows of zeros stay zeros."""
    lengths = np.linalg.norm(embeddings, axis=1, keepdims=True)
    return np.asarray(embeddings / np.where(lengths > 0, lengths, 1.0), dtype=np.float32)


ConditionalDenoiser = Callable[[Tensor, Tensor, Conditions], Tensor]
"""(z_k [batch, latent], k [batch], c) → the network's output [batch, latent]."""


def guided(
    denoiser: ConditionalDenoiser,
    latents: Float[Tensor, "batch latent"],
    steps: Int64[Tensor, "batch"],
    conditions: Conditions,
    guidance_scale: float,
) -> Float[Tensor, "batch latent"]:
    """r·ε(z, k, c) + (1 − r)·ε(z, k, ∅) (Eq. 6), both passes in one batch.

    Valid for predicted latents and velocities too, since they are linear in ε at a given z_k. A single pass is done if
    r is 1 or no row has a condition.
    """
    nothing_given = bool((conditions.action < 0).all()) and not bool(conditions.text.any())
    if guidance_scale == 1.0 or nothing_given:
        return denoiser(latents, steps, conditions)
    both = denoiser(latents.repeat(2, 1), steps.repeat(2), conditions.stacked_on(conditions.unconditional()))
    conditional, unconditional = both.chunk(2)
    return guidance_scale * conditional + (1 - guidance_scale) * unconditional


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
        """One token each; text embeddings are scaled to a root mean square of 1 before the projection."""
        text = self.text_in(conditions.text * conditions.text.shape[1] ** 0.5)
        known = (conditions.action >= 0)[:, None].to(text.dtype)
        action = self.actions(conditions.action.clamp(min=0)) * known
        angles = conditions.duration[:, None] * self.frequencies
        duration = self.duration_in(torch.cat((angles.cos(), angles.sin()), dim=1))
        return torch.stack((text, action, duration), dim=1)
