"""Frozen text encoders by name: entry points of the group `motionkit.text_encoders`.

An entry point NAME = "module:load" names `load(name) -> TextEncoder`. Folders and hub names, which nobody can install
under a name, go to the entry point `transformers`.
"""

from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32

from motionkit.core.errors import UsageError

GROUP = "motionkit.text_encoders"
FOLDERS_AND_HUB = "transformers"


@runtime_checkable
class TextEncoder(Protocol):
    """A frozen encoder of sentences."""

    @property
    def name(self) -> str:
        """What it was asked for by: `minilm`, `clip`, a folder or a hub name."""
        ...

    @property
    def fingerprint(self) -> str:
        """Hexadecimal name of its weights and its way of pooling: equal embeddings for equal fingerprints."""
        ...

    @property
    def dimension(self) -> int:
        """Size of an embedding."""
        ...

    def encode(self, texts: Sequence[str]) -> Float32[np.ndarray, "texts dimension"]:
        """One embedding per text, in order."""
        ...


def load_text_encoder(name: str) -> TextEncoder:
    """Load an encoder by the name of an entry point, a local folder or a hub name.

    Raises `UsageError` where nothing is installed that could be meant, and what the entry point's loader raises.
    """
    installed = {entry.name: entry for entry in entry_points(group=GROUP)}
    entry = installed.get(name) or installed.get(FOLDERS_AND_HUB)
    if entry is None:
        raise UsageError(f"no text encoder is called {name!r}; installed: {', '.join(sorted(installed)) or 'none'}")
    load: Callable[[str], TextEncoder] = entry.load()
    return load(name)
