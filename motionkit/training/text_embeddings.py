"""Text embeddings computed once: a file per encoder, rows found by the sha256 of their text."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float32
from safetensors.numpy import load_file, save

from motionkit.core.errors import DamagedFileError
from motionkit.core.files import require_no_link
from motionkit.core.progress import warn
from motionkit.store.cache.folder import writable
from motionkit.training.sealed_tensors import checked_metadata, write_sealed_tensors
from motionkit.training.text_encoders import TextEncoder


def embed_texts(encoder: TextEncoder, texts: Sequence[str], folder: Path) -> Float32[np.ndarray, "texts dimension"]:
    """Embeddings of texts in order, from `folder`'s cache where it has them; new ones are added to it.

    The file is named by the encoder's fingerprint and is replaced in one step, so two processes cannot damage it (the
    later one's additions win).
    """
    path = folder / f"text-embeddings-{encoder.fingerprint[:16]}.safetensors"
    known = _read(path)
    missing = list(dict.fromkeys(text for text in texts if _key(text) not in known))
    if missing:
        fresh = zip(missing, encoder.encode(missing), strict=True)
        known |= {_key(text): row for text, row in fresh}
        _write(path, known)
    if not texts:
        return np.zeros((0, encoder.dimension), dtype=np.float32)
    return np.stack([known[_key(text)] for text in texts])


def _key(text: str) -> bytes:
    return hashlib.sha256(text.encode()).digest()


def _read(path: Path) -> dict[bytes, np.ndarray]:
    """What is known; nothing where the file is damaged, which is warned of: it is computed anew."""
    if not path.is_file():
        return {}
    try:
        checked_metadata(path, set(), "computing its embeddings anew")
        arrays = load_file(path)
        keys, embeddings = arrays["text_sha256"], arrays["embeddings"]
        return {row.tobytes(): embedding for row, embedding in zip(keys, embeddings, strict=True)}
    except DamagedFileError as error:
        warn(str(error))
    except (KeyError, ValueError) as error:
        warn(f"{path} is no cache of text embeddings ({error}): computing them anew")
    return {}


def _write(path: Path, known: dict[bytes, np.ndarray]) -> None:
    require_no_link(path.parent, "delete the link, or use a copy of the store")
    keys = np.frombuffer(b"".join(known), dtype=np.uint8).reshape(-1, 32)
    arrays = {"text_sha256": keys.copy(), "embeddings": np.stack(list(known.values()))}
    with writable():
        write_sealed_tensors(path, arrays, {}, save)
