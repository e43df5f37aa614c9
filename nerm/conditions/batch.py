"""What the motions of a batch are conditioned on: a text, an action or nothing, and a duration.

"Nothing" is a zero mask, as in the paper: the embedding of the text or action is replaced by zeros, so that its token
holds the projection's bias alone. The duration is not a condition that guidance may drop: the field has to know how
long the motion lasts, so both passes of Eq. 6 see it (`nerm.conditions.guidance`).
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float32, Int64
from torch import Tensor

from motionkit.errors import UsageError

NO_ACTION = -1


@dataclass(frozen=True)
class ConditionLayout:
    """What a denoiser can be conditioned on: the size of a text embedding and the names of the actions."""

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
