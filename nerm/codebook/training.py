"""Training the VQ-VAE on the store resampled to 20 fps (T2M-GPT, train_vq.py)."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32, Int64
from torch.nn.functional import smooth_l1_loss

from motionkit.clips.windows import PositionSource
from motionkit.errors import UsageError
from motionkit.resample import resample_positions
from motionkit.training.precision import autocast
from motionkit.training.randomness import seeded_initialisation
from motionkit.training.ranks import ALONE, Ranks
from motionkit.training.schedule import set_rate
from motionkit.training.tensors import load_optimizer_tensors, optimizer_tensors, prefixed, unprefixed
from nerm.codebook.network import CodebookNetwork
from nerm.codebook.vectors import codebook_vectors, joint_positions_block
from nerm.settings.codebook import CodebookConfig

SMALLEST_SCALE = 1e-3


@dataclass(frozen=True, eq=False)
class VectorCorpus:
    """Pose vectors of all sequences, one after the other, at one framerate, as a memory map.

    `first_rows` are the rows at which a training window may start; `mean` and `scale` standardise number by number.
    """

    vectors: Float32[np.ndarray, "rows numbers"]
    first_rows: Int64[np.ndarray, "starts"]
    mean: Float32[torch.Tensor, "numbers"]
    scale: Float32[torch.Tensor, "numbers"]

    def windows(
        self, starts: Int64[torch.Tensor, "batch"], frames: int
    ) -> Float32[torch.Tensor, "batch frames numbers"]:
        """Standardised windows from the n-th possible starts."""
        rows = self.first_rows[starts.numpy()][:, None] + np.arange(frames)
        return (torch.from_numpy(np.asarray(self.vectors[rows])) - self.mean) / self.scale


def build_vector_corpus(source: PositionSource, config: CodebookConfig, path: Path) -> VectorCorpus:
    """Resample every sequence to `config.fps`, write its `codebook_vectors` to `path`, measure them on the way.

    A file that is there already is used again (a resumed run). Raises `UsageError` as `check_lengths` does.
    """
    check_lengths(source, config)
    lengths_path = path.with_suffix(".json")
    if not lengths_path.is_file():
        lengths = _write_vectors(source, config, path)
        lengths_path.write_text(json.dumps(lengths), encoding="utf-8")
    lengths = json.loads(lengths_path.read_text(encoding="utf-8"))
    size = 6 * source.positions.shape[1] + 1
    frames = config.window_frames
    ends = np.cumsum(lengths)
    starts = [np.arange(end - length, end - frames + 1) for end, length in zip(ends, lengths, strict=True)]
    first_rows = np.concatenate([*starts, np.zeros(0, dtype=np.int64)]).astype(np.int64)
    vectors = np.memmap(path, dtype="<f4", mode="r", shape=(int(ends[-1]), size)).view(np.ndarray)
    mean, scale = _statistics(vectors)
    return VectorCorpus(vectors, first_rows, mean, scale)


def check_lengths(source: PositionSource, config: CodebookConfig) -> None:
    """Raise `UsageError` where no sequence lasts a training window."""
    frames, fps = config.window_frames, config.fps
    if not (_num_vectors(source, fps) >= frames).any():
        seconds = (source.num_frames - 1) * source.fps_denominator / source.fps_numerator
        raise UsageError(
            f"no sequence has {frames} poses at {fps} fps ({frames / fps:g} s), the codebook's windows; the longest "
            f"lasts {seconds.max():.3g} s: set codebook.window_frames lower"
        )


def _num_vectors(source: PositionSource, fps: int) -> Int64[np.ndarray, "sequences"]:
    """Rows that `codebook_vectors` gives for each sequence resampled to `fps`."""
    intervals = (source.num_frames.astype(np.int64) - 1) * fps * source.fps_denominator
    return np.asarray(intervals // source.fps_numerator, dtype=np.int64)


def _write_vectors(source: PositionSource, config: CodebookConfig, path: Path) -> list[int]:
    lengths = []
    with path.open("wb") as file:
        for vectors in _resampled_vectors(source, config):
            file.write(np.ascontiguousarray(vectors, dtype="<f4").tobytes())
            lengths.append(len(vectors))
    return lengths


def _resampled_vectors(source: PositionSource, config: CodebookConfig) -> Iterator[Float32[np.ndarray, "rows numbers"]]:
    fps = Fraction(config.fps)
    for index in np.flatnonzero(_num_vectors(source, config.fps) >= config.window_frames).tolist():
        start, count = int(source.start_row[index]), int(source.num_frames[index])
        native_fps = Fraction(int(source.fps_numerator[index]), int(source.fps_denominator[index]))
        positions = resample_positions(np.asarray(source.positions[start : start + count]), native_fps, fps)
        yield codebook_vectors(positions, fps)


def _statistics(
    vectors: Float32[np.ndarray, "rows numbers"],
) -> tuple[Float32[torch.Tensor, "numbers"], Float32[torch.Tensor, "numbers"]]:
    total = np.zeros(vectors.shape[1])
    squares = np.zeros(vectors.shape[1])
    for start in range(0, len(vectors), 16_384):
        block = vectors[start : start + 16_384].astype(np.float64)
        total += block.sum(0)
        squares += np.square(block).sum(0)
    mean = total / len(vectors)
    scale = np.sqrt(np.maximum(squares / len(vectors) - mean**2, SMALLEST_SCALE**2))
    return torch.from_numpy(mean).float(), torch.from_numpy(scale).float()


class CodebookTraining:
    """The VQ-VAE with its optimiser: what `train_loop` steps."""

    def __init__(
        self, corpus: VectorCorpus, config: CodebookConfig, *, seed: int, device: torch.device, ranks: Ranks = ALONE
    ) -> None:
        self.corpus, self.config, self.device, self.ranks = corpus, config, device, ranks
        with seeded_initialisation(seed, "codebook"):
            self.network = CodebookNetwork(config, len(corpus.mean)).to(device)
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=config.rate, betas=(0.9, 0.99), weight_decay=config.weight_decay
        )
        self.positions = joint_positions_block((len(corpus.mean) - 1) // 6)

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, torch.Tensor]:
        """SmoothL1 + 0.5·SmoothL1 on the joint positions + 0.02·commitment, then the codes' moving averages."""
        config, quantiser = self.config, self.network.quantiser
        starts = torch.randint(len(self.corpus.first_rows), (config.batch,), generator=generator)
        starts = starts[self.ranks.part(config.batch)]
        share = len(starts) / config.batch
        vectors = self.corpus.windows(starts, config.window_frames).to(self.device)
        with autocast(config.precision, self.device):
            features = self.network.encode(vectors).float()
        everywhere = self.ranks.all_rows(features.detach(), config.batch)
        quantiser.start(everywhere, generator)
        quantised = quantiser(features)
        with autocast(config.precision, self.device):
            decoded = self.network.decode(quantised.values).float()
        reconstruction = smooth_l1_loss(decoded, vectors)
        positions = smooth_l1_loss(decoded[..., self.positions], vectors[..., self.positions])
        terms = reconstruction + config.position_weight * positions + config.commitment_weight * quantised.commitment
        loss = share * terms
        self.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        set_rate(self.optimizer, config.rate * (config.rate_drop if step >= config.rate_drop_at else 1.0))
        self.ranks.add_up_gradients(self.network.parameters())
        self.optimizer.step()
        which = self.ranks.all_rows(quantised.which, config.batch)
        quantiser.update(everywhere, which, generator)
        return {
            "loss": loss,
            "reconstruction": share * reconstruction,
            "commitment": share * quantised.commitment,
            "perplexity": share * perplexity(which, config.num_codes),
        }

    def state_tensors(self) -> dict[str, torch.Tensor]:
        """Weights, codes and moments."""
        return prefixed("network", self.network.state_dict()) | prefixed("optimizer", optimizer_tensors(self.optimizer))

    def load_state_tensors(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Go back to a state."""
        self.network.load_state_dict(unprefixed("network", tensors))
        load_optimizer_tensors(self.optimizer, unprefixed("optimizer", tensors))


def perplexity(which: Int64[torch.Tensor, "*shape"], num_codes: int) -> Float32[torch.Tensor, ""]:
    """exp of the entropy of the codes' use: how many codes are in use, effectively."""
    shares = torch.bincount(which.reshape(-1), minlength=num_codes).float() / which.numel()
    return torch.exp(-torch.xlogy(shares, shares).sum())
