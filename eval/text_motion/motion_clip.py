"""MotionCLIP as trained by MARDM: a text and a motion encoder; the cosine of their embeddings is its CLIP-score.

It reads the 67 numbers (KIT-ML: 64) that MARDM's other evaluator reads. The text encoder has CLIP's vocabulary and
token embeddings and a transformer of its own; it attends to all 77 places. Source: neu-vi/MARDM @ 443313b,
utils/evaluators.py; the name is its class's, and it is not the MotionCLIP of Tevet et al. 2022.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from eval.text_motion.guo import GuoError, GuoEvaluator, fingerprint_of, kind_of, read_statistics, with_weights
from motionkit.core.errors import MissingExtraError
from motionkit.core.motion import Caption
from motionkit.core.shapes import Float, Int64
from motionkit.training.loop import CheckpointError, foreign_tensors, read_foreign

WHAT, KEY = "MARDM's MotionCLIP", "contrast_model"
NUM_HEADS = 8
START, END = "<|startoftext|>", "<|endoftext|>"


def _transformer(width: int, feedforward: int, layers: int) -> nn.TransformerEncoder:
    layer = nn.TransformerEncoderLayer(width, NUM_HEADS, feedforward, activation="gelu", batch_first=True)
    return nn.TransformerEncoder(layer, layers, enable_nested_tensor=False)


class MotionEncoder(nn.Module):
    """The output of a class token that is prepended to motions of one length."""

    def __init__(self, num_inputs: int, num_positions: int, sizes: tuple[int, int, int]) -> None:
        super().__init__()
        width = sizes[0]
        self.query_token = nn.Parameter(torch.zeros(1, width))
        self.embed_motion = nn.Linear(num_inputs, width)
        self.sequence_pos_encoder = nn.ParameterDict({"pe": torch.zeros(num_positions, width)})
        self.transformer = _transformer(*sizes)
        self.out_ln = nn.LayerNorm(width)
        self.out = nn.Linear(width, width)

    def forward(self, frames: Float[Tensor, "batch frames numbers"]) -> Float[Tensor, "batch width"]:
        """One vector per motion."""
        token = self.query_token.expand(len(frames), 1, -1)
        steps = torch.cat((token, self.embed_motion(frames)), dim=1)
        states = self.transformer(steps + self.sequence_pos_encoder["pe"][: steps.shape[1]])
        embedded: Tensor = self.out(self.out_ln(states[:, 0]))
        return embedded


class MotionClip(nn.Module):
    """Both encoders; parameters have the published names. `sizes`: width, width of feedforward layers, layers.

    Published sizes: 512, 1024, 8; 49,408 word pieces, 77 places of a text, 2,000 of a motion.
    """

    def __init__(
        self, num_inputs: int, num_positions: int, vocabulary: int, context: int, sizes: tuple[int, int, int]
    ) -> None:
        super().__init__()
        width = sizes[0]
        self.motion_encoder = MotionEncoder(num_inputs, num_positions, sizes)
        self.token_embedding = nn.Embedding(vocabulary, width)
        self.positional_embedding = nn.Parameter(torch.zeros(context, width))
        self.logit_scale = nn.Parameter(torch.zeros(()))
        self.textTransEncoder = _transformer(*sizes)
        self.text_ln = nn.LayerNorm(width)
        self.out = nn.Linear(width, width)

    def embed_motions(self, motions: list[Tensor]) -> Float[Tensor, "batch width"]:
        """Unit-length embeddings of standardised frames [frames, numbers]; motions of one length form a batch."""
        lengths = np.array([len(motion) for motion in motions])
        embedded = torch.empty(len(motions), len(self.out.bias))
        for length in np.unique(lengths).tolist():
            rows = np.flatnonzero(lengths == length).tolist()
            embedded[rows] = self.motion_encoder(torch.stack([motions[row] for row in rows]).float())
        return nn.functional.normalize(embedded, dim=1)

    def embed_texts(self, tokens: Int64[Tensor, "texts places"]) -> Float[Tensor, "texts width"]:
        """Unit-length embeddings: the state at the first end-of-text token, which has the highest id."""
        states = self.text_ln(self.textTransEncoder(self.token_embedding(tokens) + self.positional_embedding))
        embedded: Tensor = self.out(states[torch.arange(len(tokens)), tokens.argmax(dim=1)])
        return nn.functional.normalize(embedded, dim=1)


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


def load_motion_clip(folder: Path) -> GuoEvaluator:
    """Load a folder with MARDM's weights and statistics and CLIP's vocabulary, as an evaluator of cosines.

    finest.tar of its `text_mot_match_clip/model`; eval_mean.npy and eval_std.npy of `utils/eval_mean_std`; vocab.json
    and merges.txt.

    Raises `CheckpointError` for invalid weights, `GuoError` for other invalid files, and `MissingExtraError` without
    the extra `text`.
    """
    path = folder / "finest.tar"
    tensors = foreign_tensors(read_foreign(path), KEY, path, WHAT)
    kind = kind_of(tensors.get("motion_encoder.embed_motion.weight"), ("mardm",), path, WHAT)
    try:
        vocabulary, width = tensors["token_embedding.weight"].shape
        (context, _), (num_positions, _) = (
            tensors[name].shape for name in ("positional_embedding", "motion_encoder.sequence_pos_encoder.pe")
        )
        feedforward = len(tensors["textTransEncoder.layers.0.linear1.bias"])
    except (KeyError, ValueError, TypeError) as error:
        raise CheckpointError(f"{path}: not {WHAT} ({error})") from None
    layers = sum(name.startswith("textTransEncoder.") and name.endswith("linear1.bias") for name in tensors)
    with torch.device("meta"):
        network = MotionClip(kind.num_inputs, num_positions, vocabulary, context, (width, feedforward, layers))
    network = with_weights(network, tensors, path, WHAT)
    if not (folder / "merges.txt").is_file():
        raise GuoError(f"{folder}: there is no merges.txt; CLIP's tokenizer has vocab.json and merges.txt")
    try:
        words = json.loads((folder / "vocab.json").read_text(encoding="utf-8"))
        ends = [words.get(token) for token in (START, END)]
    except (ValueError, AttributeError, OSError) as error:
        raise GuoError(f"{folder}/vocab.json: not a vocabulary ({error})") from None
    if len(words) != vocabulary or ends != [vocabulary - 2, vocabulary - 1]:
        raise GuoError(
            f"{folder}: {len(words)} word pieces with start and end of text at {ends}; CLIP's are {vocabulary:,}, "
            "these two the last"
        )
    try:
        from transformers import CLIPTokenizer
    except ImportError:
        raise MissingExtraError("transformers", "text") from None
    tokenizer = CLIPTokenizer.from_pretrained(folder, local_files_only=True)

    def embed_captions(captions: list[Caption]) -> Tensor:
        plain = [tokenizer(caption.text, add_special_tokens=False)["input_ids"] for caption in captions]
        return network.embed_texts(torch.from_numpy(clip_tokens(plain, vocabulary - 2, vocabulary - 1, context)))

    statistics = read_statistics(folder, kind)
    fingerprint = fingerprint_of(f"motion-clip {kind.dataset}", network, statistics)
    return GuoEvaluator(
        "motion-clip", kind, statistics, fingerprint, network.embed_motions, embed_captions, "clip_score"
    )
