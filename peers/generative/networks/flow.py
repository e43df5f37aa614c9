"""ACMDM's small form (Meng et al. 2025; neu-vi/ACMDM, models/ACMDM.py): a rectified flow of absolute coordinates."""

from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn.functional import scaled_dot_product_attention, silu

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Bool, Float, Int64
from motionkit.training.diffusion.settings import DiffusionConfig
from peers.generative.batches import (
    Conditions,
    ConditionSizes,
    MotionBatch,
    PoseSpace,
    SampleBatch,
    frames_within,
    joined_conditions,
)
from peers.generative.networks.layers import ConditionVector, sinusoids
from peers.generative.settings import FlowNetworkConfig, TransformerSizes

# Flow times lie in [0, 1]; the sinusoidal embedding expects diffusion steps.
TIME_SCALE = 1000


class Flow(nn.Module):
    """Predicts the velocity from noise to motion: one token per frame, time and condition in every layer (AdaLN)."""

    diffusion: DiffusionConfig | None = None

    def __init__(
        self, config: FlowNetworkConfig, space: PoseSpace, sizes: ConditionSizes, earlier: Mapping[str, nn.Module]
    ) -> None:
        super().__init__()
        width = config.transformer.width
        self.config, self.width, self.numbers = config, width, space.num_features
        self.coordinates = (AbsoluteCoordinates(space),)  # in a tuple: not a submodule, its buffers are the space's
        self.frame_in = nn.Linear(self.numbers, width)
        self.condition = ConditionVector(sizes, width)
        self.time_in = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.layers = nn.ModuleList(FlowLayer(config.transformer) for _ in range(config.transformer.layers))
        self.norm = nn.RMSNorm(width, elementwise_affine=False)
        self.last = nn.Linear(width, 2 * width)
        self.frame_out = nn.Linear(width, self.numbers)
        zero_init(self.last)
        zero_init(self.frame_out)

    def forward(
        self,
        noisy: Float[Tensor, "batch frames numbers"],
        times: Float[Tensor, "batch"],
        conditions: Conditions,
        lengths: Int64[Tensor, "batch"],
    ) -> Float[Tensor, "batch frames numbers"]:
        """dx/dt; padding frames are masked out of the attention."""
        embedding = silu(self.time_in(sinusoids(times * TIME_SCALE, self.width)) + self.condition(conditions))
        mask = frames_within(lengths, noisy.shape[1])
        tokens = self.frame_in(noisy)
        for layer in self.layers:
            tokens = layer(tokens, embedding, mask)
        shift, scale = self.last(embedding)[:, None].chunk(2, dim=-1)
        velocity: Tensor = self.frame_out(self.norm(tokens) * (1 + scale) + shift)
        return velocity

    def losses(self, batch: MotionBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Mean squared error of the velocity x − ε at (1 − t)·ε + t·x, t uniform, over valid frames."""
        clean = self.coordinates[0].absolute(batch.rows) * batch.mask[..., None]
        noise = torch.randn(clean.shape, generator=generator).to(clean.device) * batch.mask[..., None]
        times = torch.rand(len(clean), generator=generator).to(clean.device)
        noisy = noise + times[:, None, None] * (clean - noise)
        errors = (self(noisy, times, batch.conditions, batch.lengths) - (clean - noise)).square().mean(dim=-1)
        return {"loss": ((errors * batch.mask).sum(dim=1) / batch.lengths).mean()}

    def sample(self, batch: SampleBatch, diffusion: DiffusionConfig) -> Float[Tensor, "batch frames numbers"]:
        """Standardised rows, by uniform Euler steps; with guidance both velocities share one batch."""
        twice = batch.guided and self.config.guidance_scale != 1.0
        conditions = joined_conditions(batch) if twice else batch.conditions.to(batch.device)
        lengths = batch.lengths.to(batch.device).repeat(1 + twice)
        x = batch.noise_of_frames(self.numbers).to(batch.device, torch.float32)
        for step in range(self.config.sampling_steps):
            times = torch.full((len(lengths),), step / self.config.sampling_steps, device=batch.device)
            velocity: Tensor = self(x.repeat(1 + twice, 1, 1), times, conditions, lengths)
            if twice:
                conditional, unconditional = velocity.chunk(2)
                velocity = unconditional + self.config.guidance_scale * (conditional - unconditional)
            x = x + velocity / self.config.sampling_steps
        return self.coordinates[0].relative(x)


class AbsoluteCoordinates:
    """Standardised `field` rows ↔ coordinates of all joints in the window's frame, standardised as well.

    Raises `UsageError` for rows of another convention.
    """

    def __init__(self, space: PoseSpace) -> None:
        self.space = space
        if space.num_features != 3 * space.vectors.skeleton.num_joints:
            raise UsageError("absolute coordinates are of field vectors: motions.pose_vectors=field")

    def _standard(self) -> tuple[Float[Tensor, "joints 3"], Float[Tensor, "joints 3"]]:
        """Mean and scale of coordinates, assuming independent root and joints."""
        mean, square = self.space.mean.view(-1, 3), self.space.scale.view(-1, 3).square()
        return self._added(mean), self._added(square).sqrt()

    def _added(self, values: Float[Tensor, "*some joints 3"]) -> Float[Tensor, "*some joints 3"]:
        return torch.cat((values[..., :1, :], values[..., 1:, :] + values[..., :1, :]), dim=-2)

    def absolute(self, rows: Float[Tensor, "batch frames numbers"]) -> Float[Tensor, "batch frames numbers"]:
        """Absolute joint coordinates: the root added to every other joint."""
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
    """Attention and SwiGLU with adaptive norms: time and condition shift, scale and gate them (AdaLN-zero_init)."""

    def __init__(self, sizes: TransformerSizes) -> None:
        super().__init__()
        width = sizes.width
        self.heads, self.dropout = sizes.heads, nn.Dropout(sizes.dropout)
        self.norm = nn.RMSNorm(width, elementwise_affine=False)
        self.moved = nn.Linear(width, 6 * width)
        zero_init(self.moved)
        self.qkv, self.attended = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.query_norm, self.key_norm = nn.RMSNorm(width // sizes.heads), nn.RMSNorm(width // sizes.heads)
        self.gate_up, self.down = nn.Linear(width, 2 * sizes.inner), nn.Linear(sizes.inner, width)

    def forward(
        self,
        tokens: Float[Tensor, "batch frames width"],
        embedding: Float[Tensor, "batch width"],
        mask: Bool[Tensor, "batch frames"],
    ) -> Float[Tensor, "batch frames width"]:
        """The tokens after the layer."""
        shift, scale, gate, then_shift, then_scale, then_gate = self.moved(embedding)[:, None].chunk(6, dim=-1)
        tokens = tokens + gate * self.dropout(self._attention(self.norm(tokens) * (1 + scale) + shift, mask))
        gated, up = self.gate_up(self.norm(tokens) * (1 + then_scale) + then_shift).chunk(2, dim=-1)
        made: Tensor = tokens + then_gate * self.dropout(self.down(silu(gated) * up))
        return made

    def _attention(
        self, tokens: Float[Tensor, "batch frames width"], mask: Bool[Tensor, "batch frames"]
    ) -> Float[Tensor, "batch frames width"]:
        q, k, v = self.qkv(tokens).unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4)
        # float32 even under autocast: torch warns about a norm whose weights have another dtype.
        q, k = (rotary(norm(each.float()).to(v.dtype)) for norm, each in ((self.query_norm, q), (self.key_norm, k)))
        mixed = scaled_dot_product_attention(q, k, v, attn_mask=mask[:, None, None])
        made: Tensor = self.attended(mixed.transpose(1, 2).flatten(2))
        return made


def zero_init(layer: nn.Linear) -> None:
    """Zero-initialise a layer."""
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)


def rotary(values: Float[Tensor, "batch heads frames size"]) -> Float[Tensor, "batch heads frames size"]:
    """Rotary position embedding: pairs (i, i + size/2) rotated by frame·10,000^(−2i/size) (RoPE, Su et al. 2021)."""
    frames, size = values.shape[-2:]
    exponents = torch.arange(size // 2, device=values.device) / (size // 2)
    angles = torch.arange(frames, device=values.device)[:, None] * 10_000.0 ** (-exponents)
    first, second = values.chunk(2, dim=-1)
    cosine, sine = angles.cos(), angles.sin()
    return torch.cat((first * cosine - second * sine, first * sine + second * cosine), dim=-1)
