"""Conditions of generative models: a text, an action or nothing, of each row of a batch and of training windows."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Bool, Float, Float32, Int64

NO_ACTION = -1


@dataclass(frozen=True)
class ConditionSizes:
    """What a network's conditions are: the size of a text embedding (0: no texts) and the names of the actions."""

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

    Where none is `given`, `text` is the null embedding and `action` is `NO_ACTION`; `duration` is in units of the
    longest one that the model knows.
    """

    text: Float32[Tensor, "batch text"]
    action: Int64[Tensor, "batch"]
    given: Bool[Tensor, "batch"]
    duration: Float32[Tensor, "batch"]

    @classmethod
    def zero_masked(
        cls, text: Float32[Tensor, "batch text"], action: Int64[Tensor, "batch"], duration: Float32[Tensor, "batch"]
    ) -> "Conditions":
        """Conditions whose null embedding is zeros: given wherever there is a text or an action."""
        return cls(text, action, (action >= 0) | text.any(dim=1), duration)

    def dropped(self, where: Bool[Tensor, "batch"], null: Float32[Tensor, "text"] | None = None) -> "Conditions":
        """The same without the condition in the rows `where`: its text is `null` (None: zeros). Durations stay."""
        return Conditions(
            text=torch.where(where[:, None], torch.zeros_like(self.text) if null is None else null, self.text),
            action=torch.where(where, NO_ACTION, self.action),
            given=self.given & ~where,
            duration=self.duration,
        )

    def unconditional(self, null: Float32[Tensor, "text"] | None = None) -> "Conditions":
        """∅: no row has a condition; durations stay."""
        return self.dropped(torch.ones_like(self.given), null)

    def guidance(self, scale: float) -> float:
        """The scale of guidance: 1 if no row has a condition."""
        return scale if bool(self.given.any()) else 1.0

    def rows(self, rows: slice | Int64[Tensor, "some"]) -> "Conditions":
        """Some of the rows."""
        return Conditions(*(tensor[rows] for tensor in vars(self).values()))

    def to(self, device: torch.device | str) -> "Conditions":
        """The same conditions on a device."""
        return Conditions(*(tensor.to(device) for tensor in vars(self).values()))


ConditionalNetwork = Callable[[Tensor, Tensor, Conditions], Tensor]
"""(noisy [batch, …], steps [batch], conditions) → an output of the same shape."""


def guided(
    network: ConditionalNetwork,
    noisy: Float[Tensor, "batch *shape"],
    steps: Float[Tensor, "batch"] | Int64[Tensor, "batch"],
    conditions: Conditions,
    unconditional: Conditions,
    scale: float,
) -> Float[Tensor, "batch *shape"]:
    """scale·network(x, k, c) + (1 − scale)·network(x, k, ∅) (NeRM, Eq. 6), both in one batch.

    Valid for predicted noise, clean values and velocities, which are linear in one another at a given x. A scale of 1
    takes a single pass (`Conditions.guidance`).
    """
    if scale == 1.0:
        return network(noisy, steps, conditions)
    pairs = zip(vars(conditions).values(), vars(unconditional).values(), strict=True)
    stacked = Conditions(*(torch.cat(pair) for pair in pairs))
    both = network(torch.cat((noisy, noisy)), torch.cat((steps, steps)), stacked)
    with_condition, without = both.chunk(2)
    return scale * with_condition + (1 - scale) * without


@dataclass(frozen=True, eq=False)
class WindowConditions:
    """The captions and actions of training windows.

    A window's captions are rows of `text`, whose row 0 is the null embedding: the first `num_captions` of
    `caption_rows`. `action` is `NO_ACTION` where there is none.
    """

    text: Float32[Tensor, "texts dimension"]
    caption_rows: Int64[Tensor, "windows most"]
    num_captions: Int64[Tensor, "windows"]
    action: Int64[Tensor, "windows"]
    duration: Float32[Tensor, "windows"]
    sizes: ConditionSizes

    def draw(
        self,
        rows: Int64[Tensor, "batch"],
        chance: Float[Tensor, "3 batch"],
        *,
        drop: float,
        action_share: float = 0.0,
    ) -> Conditions:
        """One condition per window: none with probability `drop`, else one of its captions or its action.

        Windows with both get the action with probability `action_share`. `chance` is uniform in [0, 1).
        """
        counts, action = self.num_captions[rows], self.action[rows]
        has_text, has_action = counts > 0, action >= 0
        use_action = has_action & (~has_text | (chance[0] < action_share))
        choice = (chance[1] * counts).to(torch.int64).clamp(max=(counts - 1).clamp(min=0))
        use_text = has_text & ~use_action
        given = Conditions(
            text=torch.where(use_text[:, None], self.text[self.caption_rows[rows, choice]], self.text[0]),
            action=torch.where(use_action, action, NO_ACTION),
            given=use_text | use_action,
            duration=self.duration[rows],
        )
        return given.dropped(chance[2] < drop, self.text[0])


def window_conditions(
    captions: Sequence[Sequence[str]],
    actions: Sequence[str],
    duration: Float32[Tensor, "windows"],
    embed: Callable[[list[str]], Float32[Tensor, "texts dimension"]],
) -> WindowConditions:
    """Index the captions and actions ("": none) of all windows; `embed` gets "" (the null text), then all others."""
    texts = sorted({text for of_window in captions for text in of_window})
    row_of = {text: row for row, text in enumerate(texts, start=1)}
    caption_rows = torch.zeros((len(captions), max(1, *map(len, captions))), dtype=torch.int64)
    for window, of_window in enumerate(captions):
        caption_rows[window, : len(of_window)] = torch.tensor([row_of[text] for text in of_window], dtype=torch.int64)
    text, names = embed(["", *texts]), tuple(sorted({action for action in actions if action}))
    sizes = ConditionSizes(text.shape[1], names)
    return WindowConditions(
        text=text,
        caption_rows=caption_rows,
        num_captions=torch.tensor([len(of_window) for of_window in captions], dtype=torch.int64),
        action=torch.tensor([sizes.action_index(action) for action in actions], dtype=torch.int64),
        duration=duration,
        sizes=sizes,
    )
