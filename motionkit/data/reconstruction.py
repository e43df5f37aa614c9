"""The interface of models that reconstruct windows of motion."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from motionkit.core.shapes import Int64
from motionkit.data.windows import Windows
from motionkit.fields.motion_field import MotionField
from motionkit.store.cache import PositionCache
from motionkit.store.reader import Store


@dataclass(frozen=True, eq=False)
class ModelWindows:
    """Windows of sequences, and their reconstruction by a model.

    `fields` returns motion fields on [0, duration] for windows by their indices, in the window's own frame; it may be
    slow. `described` is the method: "from their μ", "encoded by optimisation".
    """

    source: PositionCache
    windows: Windows
    fields: Callable[[Int64[np.ndarray, "chosen"]], Sequence[MotionField]]
    described: str


@runtime_checkable
class ReconstructsWindows(Protocol):
    """An encoder that reconstructs whole windows of motion, from its training and others."""

    @property
    def name(self) -> str:
        """Name for tables."""

    @property
    def store_fingerprint(self) -> str:
        """Fingerprint of the store that it was trained on."""

    def training_windows(self, store: Store) -> ModelWindows:
        """The training windows, from their trained latents."""

    def other_windows(self, store: Store, where: str | None) -> ModelWindows:
        """Windows of the sequences that match this SQL condition; raises `UsageError` if there are none."""
