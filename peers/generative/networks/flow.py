"""ACMDM's small form (Meng et al. 2025; neu-vi/ACMDM, models/ACMDM.py): a rectified flow of absolute coordinates."""

from collections.abc import Mapping

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor, nn
from torch.nn.functional import scaled_dot_product_attention, silu

from motionkit.core.errors import UsageError
from motionkit.training.diffusion.settings import DiffusionConfig
from peers.generative.batches import (
    Conditions,
    ConditionSizes,
    MotionBatch,
    PoseSpace,
    Wanted,
    frames_within,
    joined_conditions,
)
from peers.generative.networks.layers import ConditionVector, sinusoids
from peers.generative.settings import FlowNetworkConfig, TransformerSizes

# Times go from 0 to 1, sinusoids want steps.
TIME_SCALE = 1000


class Flow(nn.Module):
    """The velocity from noise to motion, at any of its times; a token a frame, time and condition in every layer."""

    diffusion: DiffusionConfig | None = None

    def __init__(
        self, config: FlowNetworkConfig, space: PoseSpace, sizes: ConditionSizes, earlier: Mapping[str, nn.Module]
    ) -> None:
        super().__init__()
        width = config.transformer.width
        self.config, self.width, self.numbers = config, width, space.num_numbers
        self.coordinates = (AbsoluteCoordinates(space),)  # its numbers are the space's own
        self.frame_in = nn.Linear(self.numbers, width)
        self.condition = ConditionVector(sizes, width)
        self.time_in = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.layers = nn.ModuleList(FlowLayer(config.transformer) for _ in range(config.transformer.layers))
        self.norm = nn.RMSNorm(width, elementwise_affine=False)
        self.last = nn.Linear(width, 2 * width)
        self.frame_out = nn.Linear(width, self.numbers)
        zero(self.last)
        zero(self.frame_out)

    def forward(
        self,
        noisy: Float[Tensor, "batch frames numbers"],
        times: Float[Tensor, "batch"],
        conditions: Conditions,
        lengths: Int64[Tensor, "batch"],
    ) -> Float[Tensor, "batch frames numbers"]:
        """dx/dt; frames behind a motion's length are attended to by none."""
        told = silu(self.time_in(sinusoids(times * TIME_SCALE, self.width)) + self.condition(conditions))
        seen = frames_within(lengths, noisy.shape[1])
        tokens = self.frame_in(noisy)
        for layer in self.layers:
            tokens = layer(tokens, told, seen)
        shift, scale = self.last(told)[:, None].chunk(2, dim=-1)
        velocity: Tensor = self.frame_out(self.norm(tokens) * (1 + scale) + shift)
        return velocity

    def losses(self, batch: MotionBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """The mean squared error of the velocity x − ε at (1 − t)·ε + t·x, t uniform, of the frames there are."""
        clean = self.coordinates[0].absolute(batch.rows) * batch.seen[..., None]
        noise = torch.randn(clean.shape, generator=generator).to(clean.device) * batch.seen[..., None]
        times = torch.rand(len(clean), generator=generator).to(clean.device)
        noisy = noise + times[:, None, None] * (clean - noise)
        errors = (self(noisy, times, batch.conditions, batch.lengths) - (clean - noise)).square().mean(dim=-1)
        return {"loss": ((errors * batch.seen).sum(dim=1) / batch.lengths).mean()}

    def sample(self, wanted: Wanted, diffusion: DiffusionConfig) -> Float[Tensor, "batch frames numbers"]:
        """Standardised rows, by even Euler steps; with guidance both velocities in one batch."""
        twice = wanted.guided and self.config.guidance_scale != 1.0
        conditions = joined_conditions(wanted) if twice else wanted.conditions.to(wanted.device)
        lengths = wanted.lengths.to(wanted.device).repeat(1 + twice)
        made = wanted.noise_of_frames(self.numbers).to(wanted.device, torch.float32)
        for step in range(self.config.sampling_steps):
            times = torch.full((len(lengths),), step / self.config.sampling_steps, device=wanted.device)
            velocity: Tensor = self(made.repeat(1 + twice, 1, 1), times, conditions, lengths)
            if twice:
                with_it, without = velocity.chunk(2)
                velocity = without + self.config.guidance_scale * (with_it - without)
            made = made + velocity / self.config.sampling_steps
        return self.coordinates[0].relative(made)


class AbsoluteCoordinates:
    """Standardised `field` rows ↔ coordinates of all joints in the window's frame, standardised as well.

    Raises `UsageError` for rows of another convention.
    """

    def __init__(self, space: PoseSpace) -> None:
        self.space = space
        if space.num_numbers != 3 * space.vectors.skeleton.num_joints:
            raise UsageError("absolute coordinates are of field vectors: motions.pose_vectors=field")

    def _standard(self) -> tuple[Float[Tensor, "joints 3"], Float[Tensor, "joints 3"]]:
        """Mean and scale of coordinates, those of root and joint taken as independent."""
        mean, square = self.space.mean.view(-1, 3), self.space.scale.view(-1, 3).square()
        return self._added(mean), self._added(square).sqrt()

    def _added(self, values: Float[Tensor, "*some joints 3"]) -> Float[Tensor, "*some joints 3"]:
        return torch.cat((values[..., :1, :], values[..., 1:, :] + values[..., :1, :]), dim=-2)

    def absolute(self, rows: Float[Tensor, "batch frames numbers"]) -> Float[Tensor, "batch frames numbers"]:
        """The root added to every other joint."""
        mean, scale = self._standard()
        joints = self._added(_by_joint(rows * self.space.scale + self.space.mean))
        return ((joints - mean) / scale).flatten(-2)

    def relative(self, rows: Float[Tensor, "batch frames numbers"]) -> Float[Tensor, "batch frames numbers"]:
        """The inverse of `absolute`."""
        mean, scale = self._standard()
        joints = _by_joint(rows) * scale + mean
        relative = torch.cat((joints[..., :1, :], joints[..., 1:, :] - joints[..., :1, :]), dim=-2).flatten(-2)
        return (relative - self.space.mean) / self.space.scale


def _by_joint(rows: Float[Tensor, "batch frames numbers"]) -> Float[Tensor, "batch frames joints 3"]:
    return rows.reshape(*rows.shape[:2], -1, 3)


class FlowLayer(nn.Module):
    """Attention and SwiGLU behind norms that time and condition shift, scale and gate (AdaLN-zero)."""

    def __init__(self, sizes: TransformerSizes) -> None:
        super().__init__()
        width = sizes.width
        self.heads, self.dropout = sizes.heads, nn.Dropout(sizes.dropout)
        self.norm = nn.RMSNorm(width, elementwise_affine=False)
        self.moved = nn.Linear(width, 6 * width)
        zero(self.moved)
        self.qkv, self.attended = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.query_norm, self.key_norm = nn.RMSNorm(width // sizes.heads), nn.RMSNorm(width // sizes.heads)
        self.gate_up, self.down = nn.Linear(width, 2 * sizes.inner), nn.Linear(sizes.inner, width)

    def forward(
        self,
        tokens: Float[Tensor, "batch frames width"],
        told: Float[Tensor, "batch width"],
        seen: Bool[Tensor, "batch frames"],
    ) -> Float[Tensor, "batch frames width"]:
        """The tokens after the layer."""
        shift, scale, gate, then_shift, then_scale, then_gate = self.moved(told)[:, None].chunk(6, dim=-1)
        tokens = tokens + gate * self.dropout(self._attention(self.norm(tokens) * (1 + scale) + shift, seen))
        gated, up = self.gate_up(self.norm(tokens) * (1 + then_scale) + then_shift).chunk(2, dim=-1)
        made: Tensor = tokens + then_gate * self.dropout(self.down(silu(gated) * up))
        return made

    def _attention(
        self, tokens: Float[Tensor, "batch frames width"], seen: Bool[Tensor, "batch frames"]
    ) -> Float[Tensor, "batch frames width"]:
        q, k, v = self.qkv(tokens).unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4)
        # In float32 under autocast too: torch warns of a norm whose weights are of another type.
        q, k = (turned(norm(each.float()).to(v.dtype)) for norm, each in ((self.query_norm, q), (self.key_norm, k)))
        mixed = scaled_dot_product_attention(q, k, v, attn_mask=seen[:, None, None])
        made: Tensor = self.attended(mixed.transpose(1, 2).flatten(2))
        return made


def zero(layer: nn.Linear) -> None:
    """Make a layer that gives nothing at first."""
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)


def turned(values: Float[Tensor, "batch heads frames size"]) -> Float[Tensor, "batch heads frames size"]:
    """Pairs (i, i + size/2) turned by the frame's number times 10,000^(−2i/size) (RoPE, Su et al. 2021)."""
    frames, size = values.shape[-2:]
    exponents = torch.arange(size // 2, device=values.device) / (size // 2)
    angles = torch.arange(frames, device=values.device)[:, None] * 10_000.0 ** (-exponents)
    first, second = values.chunk(2, dim=-1)
    cosine, sine = angles.cos(), angles.sin()
    return torch.cat((first * cosine - second * sine, first * sine + second * cosine), dim=-1)
