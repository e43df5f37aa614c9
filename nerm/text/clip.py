"""CLIP's text tower, the paper's text encoder."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float32

from nerm.text.pretrained import batches, load, load_model, tell_of_cut_texts


@dataclass(frozen=True)
class ClipTextEncoder:
    """CLIP's text tower: the projected embedding of the end-of-text token (Radford et al. 2021), as CLIP gives it."""

    name: str
    location: str
    weights_sha256: str

    @property
    def fingerprint(self) -> str:
        """The weights' sha256 (of a hub model, its name's) and the pooling."""
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
        """One embedding per text, in order; texts longer than the tower's 77 tokens are cut."""
        import torch

        tokenizer, model = self._parts
        longest = int(model.config.max_position_embeddings)
        rows = [np.zeros((0, self.dimension), dtype=np.float32)]
        for batch in batches(texts):
            tokens = tokenizer(batch, padding=True, truncation=True, max_length=longest, return_tensors="pt")
            tell_of_cut_texts(self.name, tokens, longest)
            with torch.inference_mode():
                rows.append(model(**tokens).text_embeds.numpy())
        return np.concatenate(rows)
