"""MotionCLIP as trained by MARDM: a text and a motion encoder; the cosine of their embeddings is its CLIP-score.

It reads the 67 numbers (KIT-ML: 64) that MARDM's other evaluator reads. The text encoder has CLIP's vocabulary and
token embeddings and a transformer of its own; it attends to all 77 places. Source: neu-vi/MARDM @ 443313b,
utils/evaluators.py; the name is its class's, and it is not the MotionCLIP of Tevet et al. 2022.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from eval.text_motion.guo.evaluator import GuoEvaluator
from eval.text_motion.guo.kind import KINDS, GuoError, GuoKind, read_statistics
from eval.text_motion.guo.networks import FRAMES_PER_TOKEN
from motionkit.core.errors import MissingExtraError
from motionkit.core.motion import Caption
from motionkit.core.shapes import Float, Float64, Int64
from motionkit.training.loop import CheckpointError, fill_checked, foreign_tensors, read_foreign

WHAT = "MARDM's MotionCLIP"
KEY = "contrast_model"
WEIGHTS = "finest.tar"
FIRST = "motion_encoder.embed_motion.weight"
START, END = "<|startoftext|>", "<|endoftext|>"
TEXTS_AT_ONCE = 64


@dataclass(frozen=True)
class MotionClipSizes:
    """Sizes of the networks; the defaults are the published ones. `positions`: rows of the stored table."""

    width: int = 512
    feedforward: int = 1024
    layers: int = 8
    heads: int = 8
    vocabulary: int = 49408
    context: int = 77
    positions: int = 2000


PUBLISHED = MotionClipSizes()


def _transformer(sizes: MotionClipSizes) -> nn.TransformerEncoder:
    layer = nn.TransformerEncoderLayer(sizes.width, sizes.heads, sizes.feedforward, activation="gelu", batch_first=True)
    return nn.TransformerEncoder(layer, sizes.layers, enable_nested_tensor=False)


class _Positions(nn.Module):
    """Sinusoidal positional encoding, as the checkpoint stores it."""

    pe: Tensor

    def __init__(self, sizes: MotionClipSizes) -> None:
        super().__init__()
        rate = torch.exp(torch.arange(0, sizes.width, 2) * (-math.log(10000.0) / sizes.width))
        angle = torch.arange(sizes.positions)[:, None] * rate
        self.register_buffer("pe", torch.stack((angle.sin(), angle.cos()), dim=-1).flatten(1))


class _MotionEncoder(nn.Module):
    def __init__(self, num_inputs: int, sizes: MotionClipSizes) -> None:
        super().__init__()
        self.query_token = nn.Parameter(torch.zeros(1, sizes.width))
        self.embed_motion = nn.Linear(num_inputs, sizes.width)
        self.sequence_pos_encoder = _Positions(sizes)
        self.transformer = _transformer(sizes)
        self.out_ln = nn.LayerNorm(sizes.width)
        self.out = nn.Linear(sizes.width, sizes.width)

    def forward(self, frames: Float[Tensor, "batch frames numbers"]) -> Float[Tensor, "batch width"]:
        """The output of a class token that is prepended to motions of one length."""
        token = self.query_token.expand(len(frames), 1, -1)
        steps = torch.cat((token, self.embed_motion(frames)), dim=1)
        states = self.transformer(steps + self.sequence_pos_encoder.pe[: steps.shape[1]])
        embedded: Tensor = self.out(self.out_ln(states[:, 0]))
        return embedded


class MotionClip(nn.Module):
    """Both encoders, uninitialised until weights are loaded; parameters have the published names."""

    def __init__(self, kind: GuoKind, sizes: MotionClipSizes = PUBLISHED) -> None:
        super().__init__()
        self.kind, self.num_features, self.sizes = kind, sizes.width, sizes
        self.motion_encoder = _MotionEncoder(kind.num_inputs, sizes)
        self.token_embedding = nn.Embedding(sizes.vocabulary, sizes.width)
        self.positional_embedding = nn.Parameter(torch.zeros(sizes.context, sizes.width))
        self.logit_scale = nn.Parameter(torch.zeros(()))
        self.textTransEncoder = _transformer(sizes)
        self.text_ln = nn.LayerNorm(sizes.width)
        self.out = nn.Linear(sizes.width, sizes.width)
        self.eval().requires_grad_(False)

    def embed_motions(self, motions: list[Tensor], num_tokens: list[int]) -> Float[Tensor, "batch width"]:
        """Unit-length embeddings of standardised frames [frames, numbers]; padding is masked."""
        lengths = np.array([number * FRAMES_PER_TOKEN for number in num_tokens])
        embedded = torch.empty(len(motions), self.num_features)
        for length in np.unique(lengths).tolist():
            rows = np.flatnonzero(lengths == length).tolist()
            embedded[rows] = self.motion_encoder(torch.stack([motions[row][:length] for row in rows]).float())
        return nn.functional.normalize(embedded, dim=1)

    def embed_texts(self, tokens: Int64[Tensor, "texts places"]) -> Float[Tensor, "texts width"]:
        """Unit-length embeddings: the state at the first end-of-text token, which has the highest id."""
        states = self.text_ln(self.textTransEncoder(self.token_embedding(tokens) + self.positional_embedding))
        embedded: Tensor = self.out(states[torch.arange(len(tokens)), tokens.argmax(dim=1)])
        return nn.functional.normalize(embedded, dim=1)

    def published(self) -> dict[str, dict[str, Tensor]]:
        """Parameters and positional encodings by the checkpoint's key and names."""
        return {KEY: {name: tensor.data for name, tensor in self.state_dict().items()}}


def clip_tokens(
    numbers: Sequence[Sequence[int]], start: int, end: int, context: int
) -> Int64[np.ndarray, "texts context"]:
    """Tokens between start and end of text, padded with zeros; longer texts are truncated, with the end of text last.

    As `clip.tokenize(…, truncate=True)` (openai/CLIP, clip/clip.py).
    """
    rows = np.zeros((len(numbers), context), dtype=np.int64)
    for row, pieces in zip(rows, numbers, strict=True):
        kept = [start, *pieces[: context - 2], end]
        row[: len(kept)] = kept
    return rows


def _embed_captions(
    networks: MotionClip, tokenizer: Any, captions: Sequence[Caption]
) -> Float64[np.ndarray, "texts features"]:
    """One row per caption, in order; texts of more than 75 tokens are truncated."""
    plain = [tokenizer(caption.text, add_special_tokens=False)["input_ids"] for caption in captions]
    start, end = (int(tokenizer.convert_tokens_to_ids(token)) for token in (START, END))
    tokens = torch.from_numpy(clip_tokens(plain, start, end, networks.sizes.context))
    with torch.inference_mode():
        rows = [networks.embed_texts(some) for some in torch.split(tokens, TEXTS_AT_ONCE)]
    return np.asarray(torch.cat(rows).double().numpy())


def load_motion_clip(folder: Path, sizes: MotionClipSizes = PUBLISHED) -> GuoEvaluator:
    """Load a folder with MARDM's weights and statistics and CLIP's vocabulary, as an evaluator of cosines.

    finest.tar of its `text_mot_match_clip/model`; eval_mean.npy and eval_std.npy of `utils/eval_mean_std`; vocab.json
    and merges.txt.

    Raises `CheckpointError` for invalid weights, `GuoError` for other invalid files, and `MissingExtraError` without
    the extra `text`.
    """
    weights = folder / WEIGHTS
    found = foreign_tensors(read_foreign(weights), KEY, weights, WHAT)
    shape = tuple(found[FIRST].shape) if FIRST in found else ()
    if len(shape) != 2 or shape[1] not in KINDS or KINDS[shape[1]].is_weighted:
        raise CheckpointError(f"{weights}: {KEY}/{FIRST} is {shape or 'missing'}; {WHAT} reads 67 or 64 numbers")
    networks = MotionClip(KINDS[shape[1]], sizes)
    fill_checked(networks.published()[KEY], found, KEY, weights, WHAT)
    statistics = read_statistics(folder, networks.kind)
    captions = partial(_embed_captions, networks, _tokenizer(folder, sizes))
    return GuoEvaluator(networks, statistics, captions=captions, title="motion-clip", pair_score="clip_score")


def _tokenizer(folder: Path, sizes: MotionClipSizes) -> Any:
    for name in ("vocab.json", "merges.txt"):
        if not (folder / name).is_file():
            raise GuoError(f"{folder}: there is no {name}; CLIP's tokenizer has vocab.json and merges.txt")
    try:
        from transformers import CLIPTokenizer
    except ImportError:
        raise MissingExtraError("transformers", "text") from None
    try:
        words = json.loads((folder / "vocab.json").read_text(encoding="utf-8"))
        ends = [words.get(token) for token in (START, END)]
    except (ValueError, AttributeError, OSError) as error:
        raise GuoError(f"{folder}/vocab.json: not a vocabulary ({error})") from None
    if len(words) != sizes.vocabulary or ends != [sizes.vocabulary - 2, sizes.vocabulary - 1]:
        raise GuoError(
            f"{folder}: {len(words)} word pieces with start and end of text at {ends}; CLIP's are "
            f"{sizes.vocabulary:,}, these two the last"
        )
    return CLIPTokenizer.from_pretrained(folder, local_files_only=True)
