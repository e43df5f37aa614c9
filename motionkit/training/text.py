"""Frozen text encoders by name, and a cache of their embeddings.

A package lists functions `load(name) -> TextEncoder` in `TEXT_ENCODERS` (`motionkit.core.plugins`); folders and hub
names go to the one called `transformers`. Embeddings are cached in a file per encoder, with rows keyed
by the sha256 of their text.
"""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from motionkit.core import plugins
from motionkit.core.errors import UsageError
from motionkit.core.files import whole_file
from motionkit.core.progress import warn
from motionkit.core.shapes import Float32
from motionkit.store.cache import writable
from motionkit.training.run import RunError


@runtime_checkable
class TextEncoder(Protocol):
    """A frozen encoder of sentences."""

    @property
    def name(self) -> str:
        """Its requested name: `minilm`, `clip`, a folder or a hub name."""
        ...

    @property
    def fingerprint(self) -> str:
        """Hexadecimal hash of weights and pooling: equal embeddings for equal fingerprints."""
        ...

    @property
    def dimension(self) -> int:
        """Size of an embedding."""
        ...

    def encode(self, texts: Sequence[str]) -> Float32[np.ndarray, "texts dimension"]:
        """One embedding per text, in order."""
        ...


def load_text_encoder(name: str) -> TextEncoder:
    """Load an installed encoder by its name, or one of a local folder or a hub name.

    Raises `UsageError` for an unknown name, and what the package's function raises.
    """
    installed = plugins.names("TEXT_ENCODERS")
    listed = name if name in installed else "transformers"
    if listed not in installed:
        raise UsageError(f"no text encoder is called {name!r}; installed: {', '.join(sorted(installed)) or 'none'}")
    encoder: TextEncoder = plugins.load("TEXT_ENCODERS", listed)(name)
    return encoder


def load_same_encoder(name: str, fingerprint: str, model: str) -> TextEncoder:
    """The encoder that a model was trained with; raises `RunError` where its weights have changed."""
    encoder = load_text_encoder(name)
    if encoder.fingerprint != fingerprint:
        raise RunError(
            f"the text encoder {name!r} is not the one that {model} was trained with (fingerprint "
            f"{encoder.fingerprint[:16]}, expected {fingerprint[:16]})"
        )
    return encoder


def embed_texts(encoder: TextEncoder, texts: Sequence[str], folder: Path) -> Float32[np.ndarray, "texts dimension"]:
    """Embeddings of texts in order, cached in `folder`.

    The file is named by the encoder's fingerprint and is replaced atomically, so two processes cannot damage it (the
    later one's additions win).
    """
    path = folder / f"text-embeddings-{encoder.fingerprint[:16]}.safetensors"
    known = _read(path)
    missing = list(dict.fromkeys(text for text in texts if _key(text) not in known))
    if missing:
        fresh = zip(missing, encoder.encode(missing), strict=True)
        known |= {_key(text): row for text, row in fresh}
        keys = np.frombuffer(b"".join(known), dtype=np.uint8).reshape(-1, 32)
        arrays = {"text_sha256": keys.copy(), "embeddings": np.stack(list(known.values()))}
        with writable(), whole_file(path) as temporary:
            save_file(arrays, temporary)
    rows = [known[_key(text)] for text in texts]
    return np.array(rows, dtype=np.float32).reshape(len(texts), encoder.dimension)


def _key(text: str) -> bytes:
    return hashlib.sha256(text.encode()).digest()


def _read(path: Path) -> dict[bytes, np.ndarray]:
    """The cached embeddings; empty, with a warning, if the file is damaged."""
    if not path.is_file():
        return {}
    try:
        arrays = load_file(path)
        keys, embeddings = arrays["text_sha256"], arrays["embeddings"]
        return {row.tobytes(): embedding for row, embedding in zip(keys, embeddings, strict=True)}
    except (SafetensorError, KeyError, ValueError) as error:
        warn(f"{path} is not a cache of text embeddings ({error}): computing them anew")
        return {}
