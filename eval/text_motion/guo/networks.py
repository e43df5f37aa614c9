"""The three networks of Guo et al.'s evaluator: movement, motion and text encoder.

They compute in float64: a row then depends on its batch by rounding alone (1e-14), and lies within float32's rounding
of what the published code computes from the same weights. Source: text-to-motion, networks/modules.py.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.utils.rnn import pack_sequence

from eval.text_motion.guo.kind import KINDS, GuoKind
from eval.text_motion.guo.words import NUM_NUMBERS, PARTS_OF_SPEECH
from motionkit.core.shapes import Float, Float64
from motionkit.training.loop import CheckpointError, fill_checked, foreign_tensors

WHAT = "the evaluator of Guo et al."
FRAMES_PER_TOKEN = 4
SLOPE = 0.2
FIRST = "main.0.weight"


@dataclass(frozen=True)
class GuoWidths:
    """Widths of the networks; the defaults are the published ones."""

    movement: int = 512
    motion: int = 1024
    text: int = 512
    shared: int = 512


PUBLISHED = GuoWidths()


@runtime_checkable
class MotionNetworks(Protocol):
    """Networks that read standardised frames of one kind of pose vectors."""

    kind: GuoKind
    num_features: int

    def embed_motions(self, motions: list[Tensor], num_tokens: list[int]) -> Float[Tensor, "batch shared"]:
        """One embedding per motion [frames, numbers], over its `num_tokens` tokens."""
        ...

    def published(self) -> dict[str, dict[str, Tensor]]:
        """The parameters by the published checkpoint's keys and names."""
        ...


class MovementEncoder(nn.Module):
    """Two convolutions that halve time, and a linear layer: one token for every four frames."""

    def __init__(self, num_inputs: int, width: int) -> None:
        super().__init__()
        # The published dropouts are modules 1 and 4; at evaluation they do nothing.
        self.main = nn.Sequential(
            *(nn.Conv1d(num_inputs, width, 4, 2, 1), nn.Identity(), nn.LeakyReLU(SLOPE)),
            *(nn.Conv1d(width, width, 4, 2, 1), nn.Identity(), nn.LeakyReLU(SLOPE)),
        )
        self.out_net = nn.Linear(width, width)

    def forward(self, frames: Float64[Tensor, "frames numbers"]) -> Float64[Tensor, "tokens width"]:
        """Tokens of one motion's standardised frames."""
        tokens: Tensor = self.out_net(self.main(frames.T).T)
        return tokens


class SequenceEncoder(nn.Module):
    """A linear layer, a bidirectional GRU from a learned initial state, and two layers on its two last states."""

    def __init__(self, num_inputs: int, width: int, num_outputs: int) -> None:
        super().__init__()
        self.input_emb = nn.Linear(num_inputs, width)
        self.gru = nn.GRU(width, width, batch_first=True, bidirectional=True)
        self.output_net = nn.Sequential(
            nn.Linear(2 * width, width), nn.LayerNorm(width), nn.LeakyReLU(SLOPE), nn.Linear(width, num_outputs)
        )
        self.hidden = nn.Parameter(torch.zeros(2, 1, width))

    def forward(self, sequences: list[Tensor]) -> Float64[Tensor, "batch outputs"]:
        """One vector for each sequence [steps, numbers], in order; they are packed, so none is padded."""
        packed = pack_sequence(sequences, enforce_sorted=False)
        start = self.hidden.expand(-1, len(sequences), -1).contiguous()
        _, last = self.gru(packed._replace(data=self.input_emb(packed.data)), start)
        outputs: Tensor = self.output_net(torch.cat((last[0], last[1]), dim=-1))
        return outputs


class GuoNetworks(nn.Module):
    """The networks of one evaluator, uninitialised until `fill_networks`."""

    def __init__(self, kind: GuoKind, widths: GuoWidths = PUBLISHED) -> None:
        super().__init__()
        self.kind, self.num_features = kind, widths.shared
        self.movement = MovementEncoder(kind.num_inputs, widths.movement)
        self.motion = SequenceEncoder(widths.movement, widths.motion, widths.shared)
        self.parts = nn.Linear(len(PARTS_OF_SPEECH), NUM_NUMBERS)
        self.text = SequenceEncoder(NUM_NUMBERS, widths.text, widths.shared)
        self.double().eval().requires_grad_(False)

    def embed_motions(self, motions: list[Tensor], num_tokens: list[int]) -> Float64[Tensor, "batch shared"]:
        """Embeddings of standardised frames [frames, numbers]; the convolutions also see frames past the tokens."""
        tokens = [self.movement(frames)[:number] for frames, number in zip(motions, num_tokens, strict=True)]
        embeddings: Tensor = self.motion(tokens)
        return embeddings

    def embed_texts(self, words: list[Tensor], parts: list[Tensor]) -> Float64[Tensor, "batch shared"]:
        """Embeddings of sentences: word vectors [steps, 300] and parts of speech [steps, parts] of each."""
        steps = [word + self.parts(part) for word, part in zip(words, parts, strict=True)]
        embeddings: Tensor = self.text(steps)
        return embeddings

    def published(self) -> dict[str, dict[str, Tensor]]:
        """The parameters by the published checkpoint's keys and names."""
        text = (*self.text.named_parameters(), *self.parts.named_parameters(prefix="pos_emb"))
        named = {
            "movement_encoder": self.movement.named_parameters(),
            "motion_encoder": self.motion.named_parameters(),
            "text_encoder": text,
        }
        return {key: {name: parameter.data for name, parameter in parameters} for key, parameters in named.items()}


def networks_of(loaded: Mapping[str, Any], path: Path, widths: GuoWidths = PUBLISHED) -> GuoNetworks:
    """The networks with the weights of a checkpoint (`finest.tar`); other keys are ignored.

    Raises `CheckpointError` that names a tensor that is missing, unexpected, of another shape, or not finite.
    """
    found = {key: foreign_tensors(loaded, key, path, WHAT) for key in ("movement_encoder", "motion_encoder")}
    found["text_encoder"] = foreign_tensors(loaded, "text_encoder", path, WHAT)
    first = found["movement_encoder"].get(FIRST)
    shape = () if first is None else tuple(first.shape)
    if len(shape) != 3 or shape[1] not in KINDS:
        raise CheckpointError(
            f"{path}: movement_encoder/{FIRST} is {shape or 'missing'}; {WHAT} begins with 259 numbers (HumanML3D), "
            "247 (KIT), or MARDM's 67 and 64"
        )
    networks = GuoNetworks(KINDS[shape[1]], widths)
    for key, own in networks.published().items():
        fill_checked(own, found[key], key, path, WHAT)
    return networks


def weights_digest(terms: str, tensors: Mapping[str, torch.Tensor]) -> str:
    """First 16 hex digits of the sha256 over settings and weights, independent of the weights' order."""
    digest = hashlib.sha256(terms.encode())
    for name in sorted(tensors):
        digest.update(name.encode() + np.ascontiguousarray(tensors[name].numpy(), dtype="<f4").tobytes())
    return digest.hexdigest()[:16]
