"""The VQ-VAE whose codes enrich the coordinates: T2M-GPT's (Zhang et al. 2023a; appendix B.1).

Encoder: Conv k3, then twice (Conv k4 stride 2, ResNet-1D with dilations 9, 3, 1), Conv k3: four-fold downsampling in
time. The decoder mirrors it with nearest upsampling. ReLU, no norm. Codes are moving averages of what they encode.

It is trained on the store at 20 fps. Its pose vectors have 6·J + 1 numbers, 133 for 22 joints: yaw rate (rad/s), root
velocity to the body's left and front (m/s), root height (m), joints 1 … J − 1 relative to the root's ground point and
facing Z+ (m, HumanML3D's "RIC" block), velocities of all joints in the same axes (m/s). The published vector's
rotations and contacts are left out: both are functions of positions.
"""

import dataclasses
import time
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import smooth_l1_loss

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float, Float32, Int64
from motionkit.data.windows import chunks
from motionkit.features import field
from motionkit.store.cache import PositionCache, open_cache
from motionkit.training.loop import (
    CheckpointError,
    Learner,
    foreign_tensors,
    prefixed,
    read_foreign,
    run_training,
    save_tensors,
    seeded_initialisation,
)
from motionkit.training.networks import ALONE, Ranks, autocast, resolve_device, with_precision_of
from motionkit.training.run import StageContext
from nerm.recipes import CodebookConfig, CodebookNetworkConfig, NermConfig

FPS = 20
EMA_DECAY, SMALLEST_COUNT = 0.99, 1.0
POSITION_WEIGHT, COMMITMENT_WEIGHT = 0.5, 0.02
PUBLISHED_CODES = "vqvae.quantizer.codebook"


class ResidualConvolution(nn.Module):
    """x + Conv1(ReLU(Conv3(ReLU(x)))), the first convolution dilated."""

    def __init__(self, width: int, dilation: int) -> None:
        super().__init__()
        self.dilated = nn.Conv1d(width, width, 3, padding=dilation, dilation=dilation)
        self.pointwise = nn.Conv1d(width, width, 1)

    def forward(self, x: Float[Tensor, "batch width frames"]) -> Float[Tensor, "batch width frames"]:
        """One block."""
        updated: Tensor = x + self.pointwise(torch.relu(self.dilated(torch.relu(x))))
        return updated


class Quantiser(nn.Module):
    """N codes, updated by exponential moving averages of the features nearest to them (van den Oord et al. 2017, A.1).

    Codes are initialised with features of the first batch; a code whose averaged count falls below 1 is reset to one
    of the current features (T2M-GPT, models/quantize_cnn.py).
    """

    codes: Tensor
    sums: Tensor
    counts: Tensor
    started: Tensor

    def __init__(self, config: CodebookNetworkConfig) -> None:
        super().__init__()
        self.register_buffer("codes", torch.zeros(config.num_codes, config.width))
        self.register_buffer("sums", torch.zeros(config.num_codes, config.width))
        self.register_buffer("counts", torch.ones(config.num_codes))
        self.register_buffer("started", torch.tensor(False))

    def forward(
        self, features: Float[Tensor, "batch code frames"]
    ) -> tuple[Float[Tensor, "batch code frames"], Int64[Tensor, "batch frames"], Float[Tensor, ""]]:
        """The nearest code of each vector, its index, and the commitment loss.

        Gradients pass straight from the codes to the features.
        """
        vectors = features.detach().transpose(1, 2)
        which = (self.codes.square().sum(1) - 2.0 * vectors @ self.codes.T).argmin(dim=2)
        codes = self.codes[which].transpose(1, 2)
        return features + (codes - features).detach(), which, (features - codes).square().mean()

    @torch.no_grad()
    def start(self, features: Float[Tensor, "batch code frames"], generator: torch.Generator) -> None:
        """Initialise the codes with a batch's features, repeated with a little noise if they are too few."""
        if bool(self.started):
            return
        self.codes.copy_(self._random_features(features, generator))
        self.sums.copy_(self.codes)
        self.counts.fill_(1.0)
        self.started.fill_(True)

    @torch.no_grad()
    def update(
        self,
        features: Float[Tensor, "batch code frames"],
        which: Int64[Tensor, "batch frames"],
        generator: torch.Generator,
    ) -> None:
        """Move the codes towards the features assigned to them, and reset rarely used ones."""
        vectors = features.detach().transpose(1, 2).reshape(-1, features.shape[1])
        chosen = which.reshape(-1)
        counts = torch.bincount(chosen, minlength=len(self.codes)).to(self.counts.dtype)
        sums = torch.zeros_like(self.sums).index_add_(0, chosen, vectors)
        self.counts.lerp_(counts, 1.0 - EMA_DECAY)
        self.sums.lerp_(sums, 1.0 - EMA_DECAY)
        in_use = (self.counts >= SMALLEST_COUNT)[:, None]
        replacements = self._random_features(features, generator)
        self.codes.copy_(torch.where(in_use, self.sums / self.counts[:, None].clamp(min=1e-9), replacements))

    def _random_features(
        self, features: Float[Tensor, "batch code frames"], generator: torch.Generator
    ) -> Float[Tensor, "codes code"]:
        vectors = features.detach().transpose(1, 2).reshape(-1, features.shape[1])
        num_codes, width = self.codes.shape
        repeats = -(-num_codes // len(vectors))
        order = torch.cat([torch.randperm(len(vectors), generator=generator) for _ in range(repeats)])[:num_codes]
        chosen = vectors[order.to(vectors.device)]
        if repeats > 1:
            noise = torch.randn(num_codes, width, generator=generator).to(vectors.device)
            chosen = chosen + 0.01 * width**-0.5 * noise
        return chosen


class CodebookNetwork(nn.Module):
    """Encoder, quantiser and decoder on standardised pose vectors [batch, numbers, frames], frames a multiple of 4."""

    def __init__(self, config: CodebookNetworkConfig, num_features: int) -> None:
        super().__init__()
        width = config.width

        def residual_stack() -> nn.Sequential:
            return nn.Sequential(*(ResidualConvolution(width, dilation) for dilation in (9, 3, 1)))

        def down() -> list[nn.Module]:
            return [nn.Conv1d(width, width, 4, stride=2, padding=1), residual_stack()]

        def convolution(inputs: int, outputs: int) -> nn.Conv1d:
            return nn.Conv1d(inputs, outputs, 3, padding=1)

        def up() -> list[nn.Module]:
            return [residual_stack(), nn.Upsample(scale_factor=2, mode="nearest"), convolution(width, width)]

        self.encoder = nn.Sequential(
            convolution(num_features, width), nn.ReLU(), *down(), *down(), convolution(width, width)
        )
        self.quantiser = Quantiser(config)
        self.decoder = nn.Sequential(
            *(convolution(width, width), nn.ReLU(), *up(), *up()),
            *(convolution(width, width), nn.ReLU(), convolution(width, num_features)),
        )


def codebook_vectors(
    joint_positions: Float[np.ndarray, "frames joints 3"], fps: Fraction
) -> Float32[np.ndarray, "rows numbers"]:
    """T − 1 vectors of T poses in metres; raises `ValueError` for fewer than two poses."""
    if len(joint_positions) < 2:
        raise ValueError("pose vectors need two poses or more")
    # Float32 rounds yaw to 1e-7 rad, its rate to 1e-5 rad/s at 120 fps, and differently on each processor.
    joint_positions = joint_positions.astype(np.float64)
    yaw = np.unwrap(field.heading(joint_positions))
    rate = float(fps)
    here, facing = joint_positions[:-1], yaw[:-1]
    turned = field.to_window(here[:, None], facing, here[:, 0, (0, 2)])[:, 0]
    velocities = (
        field.to_window(np.diff(joint_positions, axis=0)[:, None], facing, np.zeros((len(here), 2)))[:, 0] * rate
    )
    blocks = (
        (np.diff(yaw) * rate)[:, None],
        velocities[:, 0, (0, 2)],
        turned[:, 0, 1:2],
        turned[:, 1:].reshape(len(here), -1),
        velocities.reshape(len(here), -1),
    )
    return np.concatenate(blocks, axis=1).astype(np.float32)


SMALLEST_SCALE = 1e-3


@dataclass(frozen=True, eq=False)
class VectorCorpus:
    """Pose vectors of all sequences, concatenated, at 20 fps.

    `first_rows` are the rows at which a training window may start; `mean` and `scale` standardise each number.
    """

    vectors: Float32[np.ndarray, "rows numbers"]
    first_rows: Int64[np.ndarray, "starts"]
    mean: Float32[Tensor, "numbers"]
    scale: Float32[Tensor, "numbers"]

    def windows(self, starts: Int64[Tensor, "batch"], frames: int) -> Float32[Tensor, "batch frames numbers"]:
        """Standardised windows from the n-th possible starts."""
        rows = self.first_rows[starts.numpy()][:, None] + np.arange(frames)
        return (torch.from_numpy(self.vectors[rows]) - self.mean) / self.scale


def vector_corpus(source: PositionCache, config: CodebookConfig) -> VectorCorpus:
    """The pose vectors of a corpus, every sequence resampled to 20 fps; 500 bytes a pose in memory."""
    from motionkit.fields.resample import resample_positions  # deferred: the field reads codes alone

    lengths, blocks = sequence_lengths(source, config), []
    for index in np.flatnonzero(lengths).tolist():
        positions = np.asarray(source.sequence_positions(index))
        positions = resample_positions(positions, source.exact_fps(index), Fraction(FPS))
        blocks.append(codebook_vectors(positions, Fraction(FPS)))
    ends, frames = np.cumsum(lengths), config.window_frames
    starts = [np.arange(end - length, end - frames + 1) for end, length in zip(ends, lengths, strict=True) if length]
    vectors = np.concatenate(blocks)
    total, squares = np.zeros(vectors.shape[1]), np.zeros(vectors.shape[1])
    for rows in chunks(len(vectors), 16_384):
        block = vectors[rows].astype(np.float64)
        total += block.sum(0)
        squares += np.square(block).sum(0)
    mean = total / len(vectors)
    scale = np.sqrt(np.maximum(squares / len(vectors) - mean**2, SMALLEST_SCALE**2))
    return VectorCorpus(
        vectors, np.concatenate(starts), torch.from_numpy(mean).float(), torch.from_numpy(scale).float()
    )


def sequence_lengths(source: PositionCache, config: CodebookConfig) -> Int64[np.ndarray, "sequences"]:
    """Rows of each sequence at 20 fps, 0 for those shorter than a training window.

    Raises `UsageError` if all are shorter.
    """
    intervals = (source.num_frames.astype(np.int64) - 1) * source.fps_denominator
    lengths, frames = intervals * FPS // source.fps_numerator, config.window_frames
    if not (lengths >= frames).any():
        raise UsageError(
            f"no sequence has {frames} poses at {FPS} fps ({frames / FPS:g} s), the codebook's windows; the longest "
            f"lasts {(intervals / source.fps_numerator).max():.3g} s: set codebook.window_frames lower"
        )
    return np.where(lengths >= frames, lengths, 0)


class CodebookTraining:
    """A `motionkit.training.loop.Trainable`: the VQ-VAE with its optimiser."""

    def __init__(
        self, corpus: VectorCorpus, config: CodebookConfig, *, seed: int, device: torch.device, ranks: Ranks = ALONE
    ) -> None:
        self.corpus, self.config, self.device, self.ranks = corpus, config, device, ranks
        with seeded_initialisation(seed, "codebook"):
            self.network = CodebookNetwork(config.network, len(corpus.mean)).to(device)
        optimizer = torch.optim.AdamW(
            self.network.parameters(),
            lr=config.schedule.learning_rate,
            betas=(0.9, 0.99),
            weight_decay=0.0,
        )
        self.learner = Learner(self.network, optimizer, ranks=ranks)
        self.state_tensors, self.load_state_tensors = self.learner.state_tensors, self.learner.load_state_tensors
        self.steps = config.schedule.num_steps(len(corpus.first_rows))
        self.positions = slice(4, 4 + (len(corpus.mean) - 7) // 2)  # the RIC block of 3·(J − 1) numbers

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, Tensor]:
        """SmoothL1 + 0.5·SmoothL1 of joint positions + 0.02·commitment, then update the codes' moving averages."""
        config, schedule, quantiser = self.config, self.config.schedule, self.network.quantiser
        starts = torch.randint(len(self.corpus.first_rows), (schedule.batch_size,), generator=generator)
        starts = starts[self.ranks.rows_of(schedule.batch_size)]
        share = len(starts) / schedule.batch_size
        vectors = self.corpus.windows(starts, config.window_frames).to(self.device)
        with autocast(config.precision, self.device):
            features = self.network.encoder(vectors.transpose(1, 2)).float()
        everywhere = self.ranks.all_rows(features.detach(), schedule.batch_size)
        quantiser.start(everywhere, generator)
        codes, nearest, commitment = quantiser(features)
        with autocast(config.precision, self.device):
            decoded = self.network.decoder(codes).transpose(1, 2).float()
        reconstruction = smooth_l1_loss(decoded, vectors)
        positions = smooth_l1_loss(decoded[..., self.positions], vectors[..., self.positions])
        terms = reconstruction + POSITION_WEIGHT * positions
        loss = share * (terms + COMMITMENT_WEIGHT * commitment)
        self.learner.descend(loss, step, schedule.learning_rate * schedule.factor(step, self.steps))
        which = self.ranks.all_rows(nearest, schedule.batch_size)
        shares = torch.bincount(which.reshape(-1), minlength=config.network.num_codes).float() / which.numel()
        quantiser.update(everywhere, which, generator)
        return {
            "loss": loss,
            "reconstruction": share * reconstruction,
            "commitment": share * commitment,
            "perplexity": share * torch.exp(-torch.xlogy(shares, shares).sum()),  # the effective number of codes
        }


def load_published(path: Path) -> Float32[Tensor, "codes dimension"]:
    """The codes of T2M-GPT's own checkpoint (`net_last.pth`); raises `CheckpointError` for any other file."""
    codes = foreign_tensors(read_foreign(path), "net", path, "T2M-GPT's VQ-VAE").get(PUBLISHED_CODES)
    if codes is None or codes.dim() != 2 or not bool(torch.isfinite(codes).all()):
        raise CheckpointError(f"{path}: net/{PUBLISHED_CODES} is no codebook of finite numbers")
    return codes.float()


def train_codebook(context: StageContext, config: NermConfig) -> None:
    """Train the VQ-VAE, or take T2M-GPT's own codes; write codes [N, d] and network to model.safetensors."""
    store, device, ranks = context.open_store(), resolve_device(context.device), context.ranks
    settings = with_precision_of(config.codebook, device)
    config = dataclasses.replace(config, codebook=settings)
    if settings.published_weights:
        codes = load_published(Path(settings.published_weights))
        folder = context.begin("codebook", config, store_fingerprint=store.fingerprint)
        if ranks.is_first:
            save_tensors(folder.model_path, {"codes": codes}, {"fps": FPS})
            folder.finish({"codes": len(codes), "from": settings.published_weights})
        return
    started = time.perf_counter()
    source = open_cache(store, layout="smpl22", where=settings.where or None)
    sequence_lengths(source, settings)
    folder = context.begin("codebook", config, store_fingerprint=store.fingerprint)
    corpus = vector_corpus(source, settings)
    training = CodebookTraining(corpus, settings, seed=context.seed, device=device, ranks=ranks)
    figures = run_training(context, training, folder)
    if not ranks.is_first:
        return
    tensors = {"codes": training.network.quantiser.codes, "mean": corpus.mean, "scale": corpus.scale}
    save_tensors(folder.model_path, tensors | prefixed("network", training.network.state_dict()), {"fps": FPS})
    facts = {"poses": len(corpus.vectors), "wall_seconds": round(time.perf_counter() - started, 1)}
    folder.finish({**figures, **facts})


def check_codebook(context: StageContext, config: NermConfig) -> None:
    """Raise early what would stop this stage: no sequence that is long enough, published weights of another kind."""
    settings = config.codebook
    if settings.published_weights:
        load_published(Path(settings.published_weights))
    else:
        sequence_lengths(open_cache(context.open_store(), layout="smpl22", where=settings.where or None), settings)
