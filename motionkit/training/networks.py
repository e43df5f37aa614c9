"""What networks of several systems share: layers, conditions and guidance, diffusion, devices and ranks.

Weights, moments and losses are always float32; matrix products may be bfloat16. With torchrun, every rank draws the
whole batch (from the same generator), computes its own rows, and results are summed. So N ranks follow one rank's
losses up to the order of floating-point sums, and a checkpoint can be resumed with another number of ranks.
"""

import functools
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from datetime import timedelta
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import torch
from torch import Tensor, distributed, nn

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Bool, Float, Float32, Float64, Int64, Shaped
from motionkit.features.convention import PoseVectors, PoseVectorsName
from motionkit.features.field import FIELD_VECTORS
from motionkit.features.native import NativeVectors
from motionkit.features.rotations import RotationVectors, smpl_rig
from motionkit.training.config import ConfigT, DiffusionConfig, Precision, Prediction

if TYPE_CHECKING:
    from motionkit.data.windows import WindowPoses


def reparameterized(
    mean: Float[Tensor, "batch *numbers"], log_variance: Float[Tensor, "batch *numbers"], generator: torch.Generator
) -> Float[Tensor, "batch *numbers"]:
    """Sample z ~ N(μ, σ²) by the reparameterisation trick, with noise from a CPU generator."""
    noise = torch.randn(mean.shape, generator=generator).to(mean.device)
    return mean + (0.5 * log_variance).exp() * noise


def kl_divergence(
    mean: Float[Tensor, "*numbers"], log_variance: Float[Tensor, "*numbers"]
) -> Float[Tensor, "*numbers"]:
    """Elementwise KL divergence of N(μ, σ²) from N(0, 1), in float32 even under autocast."""
    mean, log_variance = mean.float(), log_variance.float()
    return 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance)


def through_long_skips(
    tokens: Float[Tensor, "batch tokens width"],
    layers: Sequence[nn.Module] | nn.ModuleList,
    joins: Sequence[nn.Module] | nn.ModuleList,
    call: Callable[[nn.Module, Tensor], Tensor],
) -> Float[Tensor, "batch tokens width"]:
    """The tokens after an odd number n of layers; layer n − 1 − i also sees what layer i gave (U-ViT, Bao et al. 2023).

    Each of the (n − 1) / 2 `joins` is a linear map of both, concatenated. `call` applies a layer to tokens.
    """
    half, kept = len(joins), []
    for layer in layers[:half]:
        tokens = call(layer, tokens)
        kept.append(tokens)
    tokens = call(layers[half], tokens)
    for join, layer in zip(joins, layers[half + 1 :], strict=True):
        tokens = call(layer, join(torch.cat((tokens, kept.pop()), dim=-1)))
    return tokens


NO_ACTION = -1


@dataclass(frozen=True)
class ConditionSizes:
    """What a network's conditions are: the size of a text embedding (0: no texts) and the names of the actions."""

    text_dimension: int
    actions: tuple[str, ...]

    def action_index(self, action: str) -> int:
        """Index of an action, `NO_ACTION` for an empty name; raises `UsageError` naming the known ones."""
        if not action:
            return NO_ACTION
        if action not in self.actions:
            known = ", ".join(self.actions) or "none (its training data had no actions)"
            raise UsageError(f"the model knows no action {action!r}; it knows {known}")
        return self.actions.index(action)


@dataclass(frozen=True, eq=False)
class Conditions:
    """A batch of conditions.

    Where none is `given`, `text` is the null embedding and `action` is `NO_ACTION`; `duration` is in units of the
    longest one that the model knows.
    """

    text: Float32[Tensor, "batch text"]
    action: Int64[Tensor, "batch"]
    given: Bool[Tensor, "batch"]
    duration: Float32[Tensor, "batch"]

    @classmethod
    def zero_masked(
        cls, text: Float32[Tensor, "batch text"], action: Int64[Tensor, "batch"], duration: Float32[Tensor, "batch"]
    ) -> "Conditions":
        """Conditions whose null embedding is zeros: given wherever there is a text or an action."""
        return cls(text, action, (action >= 0) | text.any(dim=1), duration)

    def dropped(self, where: Bool[Tensor, "batch"], null: Float32[Tensor, "text"] | None = None) -> "Conditions":
        """The same without the condition in the rows `where`: its text is `null` (None: zeros). Durations stay."""
        return Conditions(
            text=torch.where(where[:, None], torch.zeros_like(self.text) if null is None else null, self.text),
            action=torch.where(where, NO_ACTION, self.action),
            given=self.given & ~where,
            duration=self.duration,
        )

    def unconditional(self, null: Float32[Tensor, "text"] | None = None) -> "Conditions":
        """∅: no row has a condition; durations stay."""
        return self.dropped(torch.ones_like(self.given), null)

    def guidance(self, scale: float) -> float:
        """The scale of guidance: 1 if no row has a condition."""
        return scale if bool(self.given.any()) else 1.0

    def paired(self, unconditional: "Conditions", scale: float) -> "Conditions":
        """The rows of both passes of `guided`, these first; at a scale of 1 these alone."""
        pairs = zip(vars(self).values(), vars(unconditional).values(), strict=True)
        return self if scale == 1.0 else Conditions(*(torch.cat(pair) for pair in pairs))

    def rows(self, rows: slice | Int64[Tensor, "some"]) -> "Conditions":
        """Some of the rows."""
        return Conditions(*(tensor[rows] for tensor in vars(self).values()))

    def to(self, device: torch.device | str) -> "Conditions":
        """The same conditions on a device."""
        return Conditions(*(tensor.to(device) for tensor in vars(self).values()))


ConditionalNetwork = Callable[[Tensor, Tensor, Conditions], Tensor]
"""(noisy [batch, …], steps [batch], conditions) → an output of the same shape."""


ConditionsT = TypeVar("ConditionsT")


def guided(
    network: Callable[[Tensor, Tensor, ConditionsT], Tensor],
    noisy: Float[Tensor, "batch *shape"],
    steps: Float[Tensor, "batch"] | Int64[Tensor, "batch"],
    conditions: ConditionsT,
    scale: float,
) -> Float[Tensor, "batch *shape"]:
    """scale·network(x, k, c) + (1 − scale)·network(x, k, ∅) (NeRM, Eq. 6), both in one batch.

    `conditions` are those of both passes (`Conditions.paired`). Valid for predicted noise, clean values and velocities,
    which are linear in one another at a given x. A scale of 1 takes a single pass (`Conditions.guidance`).
    """
    if scale == 1.0:
        return network(noisy, steps, conditions)
    both = network(torch.cat((noisy, noisy)), torch.cat((steps, steps)), conditions)
    with_condition, without = both.chunk(2)
    return scale * with_condition + (1 - scale) * without


@dataclass(frozen=True, eq=False)
class WindowConditions:
    """The captions and actions of training windows.

    A window's captions are rows of `text`, whose row 0 is the null embedding: the first `num_captions` of
    `caption_rows`. `action` is `NO_ACTION` where there is none.
    """

    text: Float32[Tensor, "texts dimension"]
    caption_rows: Int64[Tensor, "windows most"]
    num_captions: Int64[Tensor, "windows"]
    action: Int64[Tensor, "windows"]
    duration: Float32[Tensor, "windows"]
    sizes: ConditionSizes

    def draw(
        self, rows: Int64[Tensor, "batch"], chance: Float[Tensor, "3 batch"], *, drop: float, action_share: float = 0.0
    ) -> Conditions:
        """One condition per window: none with probability `drop`, else one of its captions or its action.

        Windows with both get the action with probability `action_share`. `chance` is uniform in [0, 1).
        """
        counts, action = self.num_captions[rows], self.action[rows]
        has_text, has_action = counts > 0, action >= 0
        use_action = has_action & (~has_text | (chance[0] < action_share))
        choice = (chance[1] * counts).to(torch.int64).clamp(max=(counts - 1).clamp(min=0))
        use_text = has_text & ~use_action
        given = Conditions(
            text=torch.where(use_text[:, None], self.text[self.caption_rows[rows, choice]], self.text[0]),
            action=torch.where(use_action, action, NO_ACTION),
            given=use_text | use_action,
            duration=self.duration[rows],
        )
        return given.dropped(chance[2] < drop, self.text[0])


def window_conditions(
    captions: Sequence[Sequence[str]],
    actions: Sequence[str],
    duration: Float32[Tensor, "windows"],
    embed: Callable[[list[str]], Float32[Tensor, "texts dimension"]],
) -> WindowConditions:
    """Index the captions and actions ("": none) of all windows; `embed` gets "" (the null text), then all others."""
    texts = sorted({text for of_window in captions for text in of_window})
    row_of = {text: row for row, text in enumerate(texts, start=1)}
    caption_rows = torch.zeros((len(captions), max(1, *map(len, captions))), dtype=torch.int64)
    for window, of_window in enumerate(captions):
        caption_rows[window, : len(of_window)] = torch.tensor([row_of[text] for text in of_window], dtype=torch.int64)
    text, names = embed(["", *texts]), tuple(sorted({action for action in actions if action}))
    sizes = ConditionSizes(text.shape[1], names)
    return WindowConditions(
        text=text,
        caption_rows=caption_rows,
        num_captions=torch.tensor([len(of_window) for of_window in captions], dtype=torch.int64),
        action=torch.tensor([sizes.action_index(action) for action in actions], dtype=torch.int64),
        duration=duration,
        sizes=sizes,
    )


NoisePredictor = Callable[[Tensor, Tensor], Tensor]
"""(z_k [batch, latent], k [batch]) → predicted noise [batch, latent]."""

Adjust = Callable[[Tensor, int, float], Tensor]
"""(predicted clean z [batch, latent], index of the visited step, its ᾱ) → the clean z to continue with."""

LARGEST_COSINE_BETA = 0.999


def cumulative_alphas(config: DiffusionConfig) -> Float64[Tensor, "steps"]:
    """ᾱ_k = ∏ (1 − β_j) for j ≤ k.

    √β is linear from √beta_start to √beta_end, or ᾱ follows cos²(π/2 · (k/K + s) / (1 + s)) with s = 0.008 and β ≤
    0.999 (Nichol & Dhariwal 2021, Eq. 17).
    """
    if config.schedule == "scaled_linear":
        roots = torch.linspace(config.beta_start**0.5, config.beta_end**0.5, config.num_steps, dtype=torch.float64)
        return torch.cumprod(1.0 - roots**2, dim=0)
    times = torch.arange(config.num_steps + 1, dtype=torch.float64) / config.num_steps
    curve = torch.cos((times + 0.008) / 1.008 * (math.pi / 2)).square()
    betas = (1.0 - curve[1:] / curve[:-1]).clamp(max=LARGEST_COSINE_BETA)
    return torch.cumprod(1.0 - betas, dim=0)


def sampling_steps(config: DiffusionConfig) -> tuple[int, ...]:
    """The steps k visited at inference, noisiest first."""
    if config.sampling_spacing == "trailing":
        ratio = config.num_steps / config.sampling_steps
        return tuple(round(config.num_steps - i * ratio) - 1 for i in range(config.sampling_steps))
    stride = config.num_steps // config.sampling_steps
    steps = (min(i * stride + 1, config.num_steps - 1) for i in range(config.sampling_steps))
    return tuple(sorted(set(steps), reverse=True))


def add_noise(
    latents: Float[Tensor, "batch latent"],
    noise: Float[Tensor, "batch latent"],
    steps: Int64[Tensor, "batch"],
    alphas: Float64[Tensor, "steps"],
) -> Float[Tensor, "batch latent"]:
    """z_k = √ᾱ_k z + √(1 − ᾱ_k) ε: the input of ε_φ in Eq. 5."""
    kept = alphas[steps][:, None]
    return (kept.sqrt() * latents + (1 - kept).sqrt() * noise).to(latents.dtype)


def prediction_target(
    prediction: Prediction,
    latents: Float[Tensor, "batch latent"],
    noise: Float[Tensor, "batch latent"],
    steps: Int64[Tensor, "batch"],
    alphas: Float64[Tensor, "steps"],
) -> Float[Tensor, "batch latent"]:
    """The target of the network at z_k: ε, z or √ᾱ_k ε − √(1 − ᾱ_k) z."""
    if prediction == "noise":
        return noise
    if prediction == "latent":
        return latents
    kept = alphas[steps][:, None]
    return (kept.sqrt() * noise - (1 - kept).sqrt() * latents).to(latents.dtype)


def predicted_noise(
    prediction: Prediction, output: Float[Tensor, "batch latent"], noisy: Float[Tensor, "batch latent"], alpha: float
) -> Float[Tensor, "batch latent"]:
    """The noise from a network's output; the inverse of `prediction_target` at a known z_k."""
    if prediction == "noise":
        return output
    if prediction == "latent":
        noise: Tensor = (noisy - alpha**0.5 * output) / (1 - alpha) ** 0.5
        return noise
    from_velocity: Tensor = alpha**0.5 * output + (1 - alpha) ** 0.5 * noisy
    return from_velocity


def sample(
    predict_noise: NoisePredictor,
    start: Float64[Tensor, "batch latent"],
    alphas: Float64[Tensor, "num_steps"],
    steps: Sequence[int],
    *,
    draw_noise: Callable[[], Tensor] | None = None,
    adjust: Adjust | None = None,
) -> Float64[Tensor, "batch latent"]:
    """Sample from z_K over decreasing steps; the last update goes to ᾱ = 1, to the last prediction of the clean latent.

    Without `draw_noise` deterministically (DDIM, η = 0; Song et al. 2021, Eq. 12). With it, ancestrally (DDPM; Ho et
    al. 2020, Eq. 7): it returns fresh N(0, I) numbers of the shape of `start`, the last update adds none, and the
    variance is that of the true posterior q(z_{k−1} | z_k, z_0), for steps that are skipped too. `adjust` may change
    each prediction of the clean latent.
    """
    latents = start
    targets = [float(alphas[k]) for k in steps[1:]] + [1.0]
    for index, (k, target) in enumerate(zip(steps, targets, strict=True)):
        alpha = float(alphas[k])
        noise = predict_noise(latents, torch.full((len(latents),), k, dtype=torch.int64))
        clean: Tensor = (latents - (1 - alpha) ** 0.5 * noise.to(torch.float64)) / alpha**0.5
        if adjust is not None:
            clean = adjust(clean, index, alpha)
            noise = predicted_noise("latent", clean, latents, alpha)
        if draw_noise is None:
            latents = target**0.5 * clean + (1 - target) ** 0.5 * noise
            continue
        kept = alpha / target
        latents = (target**0.5 * (1 - kept) * clean + kept**0.5 * (1 - target) * latents) / (1 - alpha)
        if target < 1.0:
            latents = latents + ((1 - target) / (1 - alpha) * (1 - kept)) ** 0.5 * draw_noise()
    return latents


SMALLEST_SCALE = 1e-3
RIG = "rig.offsets"


@dataclass(frozen=True, eq=False)
class VectorScaling:
    """Elementwise (vector − mean) / scale; `scale` in the vectors' own units."""

    mean: Float32[Tensor, "features"]
    scale: Float32[Tensor, "features"]

    def apply(self, vectors: Float[Tensor, "*poses features"]) -> Float[Tensor, "*poses features"]:
        """Standardise vectors."""
        return (vectors - self.mean) / self.scale

    def invert(self, standardised: Float[Tensor, "*poses features"]) -> Float[Tensor, "*poses features"]:
        """The inverse of `apply`."""
        return standardised * self.scale + self.mean

    def to(self, device: torch.device) -> "VectorScaling":
        """Move to a device."""
        return VectorScaling(self.mean.to(device), self.scale.to(device))


def measure_scaling(
    poses: "WindowPoses",
    *,
    grouped: bool,
    root_weight: float = 1.0,
    centred_path: bool = False,
    poses_per_window: int = 32,
) -> VectorScaling:
    """Mean and scale of the windows' vectors, from poses spread evenly over each window; one pass, constant memory.

    Each number has its own scale; with `grouped`, each of the convention's groups has one (`field` vectors: the root's
    x and z, and everything else), so that errors are weighted as in millimetres. `root_weight` then multiplies the
    first group, the root's path. With `centred_path` x and z of positions have mean zero, so that standardised poses
    can be rotated.
    """
    vectors = poses.frames.vectors
    size = vectors.num_features
    count, total, squares = 0, torch.zeros(size, dtype=torch.float64), torch.zeros(size, dtype=torch.float64)
    for start in range(0, len(poses.windows), 512):
        rows = np.arange(start, min(start + 512, len(poses.windows)))
        some = torch.from_numpy(poses.evenly(rows, poses_per_window).vectors).double().flatten(0, 1)
        count += len(some)
        total, squares = total + some.sum(0), squares + some.square().sum(0)
    mean = total / count
    if centred_path:
        mean.view(-1, 3)[:, [0, 2]] = 0.0
    variance = squares / count - mean.square()
    groups = [list(group) for group in vectors.groups]
    if grouped:
        for group in groups:
            variance[group] = variance[group].mean()
    scale = variance.clamp(min=SMALLEST_SCALE**2).sqrt()
    scale[groups[0]] /= root_weight
    return VectorScaling(mean.float(), scale.float())


def vector_tensors(vectors: PoseVectors) -> dict[str, Tensor]:
    """Tensors that a convention adds to a checkpoint: the rig of `rotations`, else none."""
    return {RIG: torch.from_numpy(vectors.skeleton.offsets)} if isinstance(vectors, RotationVectors) else {}


def vectors_of(name: PoseVectorsName, tensors: Mapping[str, Tensor]) -> PoseVectors:
    """The convention of a checkpoint; raises `KeyError` if the rig is missing."""
    if name == "rotations":
        return RotationVectors(smpl_rig(tensors[RIG].numpy()))
    return FIELD_VECTORS if name == "field" else NativeVectors()


# A rank may wait for long while the first one trains a stage alone; torchrun ends all ranks if one dies.
PATIENCE = timedelta(days=7)


@dataclass(frozen=True)
class Ranks:
    """This process' rank among `size`."""

    rank: int = 0
    size: int = 1

    @property
    def is_first(self) -> bool:
        """Whether this is the rank that prints and writes."""
        return self.rank == 0

    def rows_of(self, count: int) -> slice:
        """This rank's share of `count` rows: shares are contiguous, in order of ranks, and differ by at most one.

        Raises `UsageError` if a rank would have none.
        """
        if count < self.size:
            raise UsageError(f"a batch of {count} can't be shared by {self.size} ranks")
        return slice(count * self.rank // self.size, count * (self.rank + 1) // self.size)

    def add_up(self, tensors: Iterable[torch.Tensor]) -> None:
        """All-reduce (sum) tensors of one type on one device in place, in a single message."""
        own = list(tensors)
        if self.size == 1 or not own:
            return
        message = torch.cat([tensor.detach().flatten() for tensor in own])
        distributed.all_reduce(message)
        for tensor, total in zip(own, torch.split(message, [tensor.numel() for tensor in own]), strict=True):
            tensor.detach().copy_(total.view_as(tensor))

    def all_rows(self, own: Shaped[torch.Tensor, "own *rest"], count: int) -> Shaped[torch.Tensor, "count *rest"]:
        """Gather the rows of all ranks, of which each has its `rows_of(count)`."""
        if self.size == 1:
            return own
        rows = own.new_zeros((count, *own.shape[1:]))
        rows[self.rows_of(count)] = own
        self.add_up([rows])
        return rows

    def agree(self, *flags: bool) -> tuple[bool, ...]:
        """For each flag, whether it is true on any rank."""
        if self.size == 1:
            return flags
        raised = torch.tensor(flags, dtype=torch.int32)
        distributed.all_reduce(raised, distributed.ReduceOp.MAX)
        return tuple(bool(flag) for flag in raised)

    def wait(self) -> None:
        """Barrier: wait for all ranks."""
        self.agree(False)

    def on_first(self, action: Callable[[], object]) -> None:
        """Call a function on the first rank while the others wait; if it raises, the others exit silently."""
        failed = True
        try:
            if self.is_first:
                action()
            failed = False
        finally:
            (any_failed,) = self.agree(failed)
        if any_failed:
            raise SystemExit(1)


ALONE = Ranks()


def present_ranks() -> Ranks:
    """The ranks that this process has joined, or a single one."""
    if distributed.is_available() and distributed.is_initialized():
        return Ranks(distributed.get_rank(), distributed.get_world_size())
    return ALONE


@contextmanager
def joined_ranks() -> Iterator[Ranks]:
    """Join the process group of torchrun's environment; does nothing without torchrun, or with one process.

    The backend is NCCL for GPUs and Gloo for CPUs; "cuda" then is the GPU of this rank.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield ALONE
        return
    backend = "gloo"
    if torch.cuda.is_available():
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")) % torch.cuda.device_count())
        backend = "cpu:gloo,cuda:nccl"
    distributed.init_process_group(backend, timeout=PATIENCE)
    try:
        yield present_ranks()
    finally:
        distributed.destroy_process_group()


class DealtRows:
    """Partition of a table's rows, such as latents, over ranks.

    Each rank has consecutive rows in a given order, of about the same total weight.
    """

    def __init__(self, ranks: Ranks, weight: Float[np.ndarray, "rows"], order: Int64[np.ndarray, "rows"]) -> None:
        self.ranks = ranks
        before = np.cumsum(weight[order]) - 0.5 * weight[order]
        owner = np.empty(len(order), dtype=np.int64)
        owner[order] = np.minimum(ranks.size * before / weight.sum(), ranks.size - 1).astype(np.int64)
        self.owner = torch.from_numpy(owner)
        self.rows = torch.nonzero(self.owner == ranks.rank)[:, 0]

    def mine(self, rows: Int64[torch.Tensor, "batch"]) -> Int64[torch.Tensor, "mine"]:
        """Positions in a batch of the rows that this rank owns."""
        return torch.nonzero(self.owner[rows] == self.ranks.rank)[:, 0]

    def place(self, rows: Int64[torch.Tensor, "mine"]) -> Int64[torch.Tensor, "mine"]:
        """Indices in this rank's own table of rows that it owns."""
        return torch.searchsorted(self.rows, rows)

    def gather(self, table: Shaped[torch.Tensor, "own *rest"]) -> Shaped[torch.Tensor, "all *rest"]:
        """Gather the whole table on the CPU of the first rank; the others get an empty one."""
        table = table.detach().cpu()
        if self.ranks.size == 1:
            return table
        if not self.ranks.is_first:
            distributed.send(table.contiguous(), dst=0)
            return table[:0]
        whole = table.new_empty((len(self.owner), *table.shape[1:]))
        whole[self.rows] = table
        for rank in range(1, self.ranks.size):
            rows = torch.nonzero(self.owner == rank)[:, 0]
            received = table.new_empty((len(rows), *table.shape[1:]))
            distributed.recv(received, src=rank)
            whole[rows] = received
        return whole


@functools.cache
def has_bfloat16(device: torch.device) -> bool:
    """Whether the CPU has native bfloat16 products; otherwise they are emulated, and slower than float32."""
    if device.type == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    # torch calls it "avx512_bf16", "amx_bf16" or alike; older versions don't say.
    capabilities: dict[str, Any] = getattr(torch.cpu, "get_capabilities", dict)()
    return device.type == "cpu" and any("bf16" in name and value is True for name, value in capabilities.items())


def with_precision_of(settings: ConfigT, device: torch.device) -> ConfigT:
    """The settings with `precision` "auto" replaced by bfloat16 if the device supports it, else by float32.

    So the run's config.json records the choice, and a run is not silently resumed in another precision.
    """
    precision: Precision = vars(settings)["precision"]
    if precision != "auto":
        return settings
    chosen = "bfloat16" if has_bfloat16(device) else "float32"
    return replace(settings, precision=chosen)


def autocast(precision: Precision, device: torch.device) -> AbstractContextManager[None]:
    """Autocast matrix products inside, and later their gradients, to bfloat16 if that is the precision."""
    chosen = precision == "bfloat16" or (precision == "auto" and has_bfloat16(device))
    return torch.autocast(device.type, torch.bfloat16, enabled=chosen)


def resolve_device(name: str) -> torch.device:
    """The device a user named; "auto" is the first CUDA device, else the CPU.

    Raises `UsageError` for an unknown name or a missing device.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise UsageError(f"--device {name}: {str(error).splitlines()[0]}") from None
    return device
