"""ACMDM's small form (Meng et al. 2025; neu-vi/ACMDM, models/ACMDM.py): a rectified flow of absolute coordinates."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import scaled_dot_product_attention, silu

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float
from motionkit.training.config import Schedule
from motionkit.training.networks import Conditions, VectorScaling, guided
from peers import layers
from peers.generating import CLIP, MINILM, PeerConfig, PeerStage, cosine
from peers.layers import ConditionVector, Latents, NetworkInputs, PeerNetwork, Tokens, TransformerSizes
from peers.motions import Mask, MotionBatch, MotionsConfig, PoseSpace, Rows, SampleBatch

# Flow times lie in [0, 1]; the sinusoidal embedding expects diffusion steps.
TIME_SCALE = 1000


@dataclass(frozen=True)
class FlowNetworkConfig:
    """ACMDM's small form: a transformer of these sizes, sampled by `sampling_steps` Euler steps."""

    transformer: TransformerSizes = TransformerSizes(8, 512, 8, 1365)
    sampling_steps: int = 50
    guidance_scale: float = 3.0


class Flow(PeerNetwork):
    """ACMDM-S: predicts the velocity from noise to motion; one token per frame, all else in every layer (AdaLN)."""

    def __init__(self, config: FlowNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        width = config.transformer.width
        self.config, self.width, self.numbers = config, width, inputs.space.num_features
        self.coordinates = AbsoluteCoordinates(inputs.space)
        self.frame_in = nn.Linear(self.numbers, width)
        self.condition = ConditionVector(inputs.conditions, width)
        self.time_in = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.layers = nn.ModuleList(FlowLayer(config.transformer) for _ in range(config.transformer.layers))
        self.norm = nn.RMSNorm(width, elementwise_affine=False)
        self.last, self.frame_out = zeros(nn.Linear(width, 2 * width)), zeros(nn.Linear(width, self.numbers))

    def forward(self, noisy: Rows, times: Float[Tensor, "batch"], conditions: Conditions, mask: Mask) -> Rows:
        """dx/dt; padding frames are masked out of the attention."""
        embedding = silu(self.time_in(layers.sinusoids(times * TIME_SCALE, self.width)) + self.condition(conditions))
        tokens = self.frame_in(noisy)
        for layer in self.layers:
            tokens = layer(tokens, embedding, mask)
        shift, scale = self.last(embedding)[:, None].chunk(2, dim=-1)
        velocity: Tensor = self.frame_out(self.norm(tokens) * (1 + scale) + shift)
        return velocity

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Mean squared error of the velocity x − ε at (1 − t)·ε + t·x, t uniform, over valid frames."""
        clean = self.coordinates.absolute(batch.rows) * batch.mask[..., None]
        noise = torch.randn(clean.shape, generator=batch.generator).to(clean.device) * batch.mask[..., None]
        times = torch.rand(len(clean), generator=batch.generator).to(clean.device)
        noisy = noise + times[:, None, None] * (clean - noise)
        errors = (self(noisy, times, batch.conditions, batch.mask) - (clean - noise)).square().mean(dim=-1)
        return {"loss": ((errors * batch.mask).sum(dim=1) / batch.lengths).mean()}

    def sample(self, batch: SampleBatch) -> Rows:
        """Standardised rows, by uniform Euler steps."""
        network, steps = layers.with_inputs(self, batch.mask), self.config.sampling_steps
        scale = batch.conditions.guidance(self.config.guidance_scale)
        x = batch.noise_within(batch.lengths, self.numbers).float()
        for step in range(steps):
            times = torch.full((len(x),), step / steps, device=batch.device)
            x = x + guided(network, x, times, batch.conditions, batch.unconditional, scale) / steps
        return self.coordinates.relative(x)


class AbsoluteCoordinates:
    """Standardised `field` rows ↔ coordinates of all joints in the window's frame, standardised as well.

    Their mean and scale assume independent root and joints. Raises `UsageError` for rows of another convention.
    """

    def __init__(self, space: PoseSpace) -> None:
        if space.num_features != 3 * space.vectors.skeleton.num_joints:
            raise UsageError("absolute coordinates are of field vectors: motions.pose_vectors=field")
        self.rows = space.scaling
        variance = _added(space.scaling.scale.square())
        self.joints = VectorScaling(_added(space.scaling.mean), variance.sqrt())

    def absolute(self, rows: Rows) -> Rows:
        """Absolute joint coordinates: the root added to every other joint."""
        return self.joints.apply(_added(self.rows.invert(rows)))

    def relative(self, rows: Rows) -> Rows:
        """The inverse of `absolute`."""
        return self.rows.apply(_added(self.joints.invert(rows), -1))


def _added(numbers: Float[Tensor, "*frames numbers"], times: int = 1) -> Float[Tensor, "*frames numbers"]:
    """The coordinates with the root's added to every other joint's, so many times."""
    joints = numbers.reshape(*numbers.shape[:-1], -1, 3)
    return torch.cat((joints[..., :1, :], joints[..., 1:, :] + times * joints[..., :1, :]), dim=-2).flatten(-2)


class FlowLayer(nn.Module):
    """Attention and SwiGLU with adaptive norms: time and condition shift, scale and gate them (AdaLN-zero)."""

    def __init__(self, sizes: TransformerSizes) -> None:
        super().__init__()
        width = sizes.width
        self.heads, self.dropout = sizes.heads, nn.Dropout(sizes.dropout)
        self.norm = nn.RMSNorm(width, elementwise_affine=False)
        self.moved = zeros(nn.Linear(width, 6 * width))
        self.qkv, self.attended = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.query_norm, self.key_norm = nn.RMSNorm(width // sizes.heads), nn.RMSNorm(width // sizes.heads)
        self.gate_up, self.down = nn.Linear(width, 2 * sizes.inner), nn.Linear(sizes.inner, width)

    def forward(self, tokens: Tokens, embedding: Latents, mask: Mask) -> Tokens:
        """The tokens after the layer."""
        shift, scale, gate, then_shift, then_scale, then_gate = self.moved(embedding)[:, None].chunk(6, dim=-1)
        tokens = tokens + gate * self.dropout(self._attention(self.norm(tokens) * (1 + scale) + shift, mask))
        gated, up = self.gate_up(self.norm(tokens) * (1 + then_scale) + then_shift).chunk(2, dim=-1)
        outputs: Tensor = tokens + then_gate * self.dropout(self.down(silu(gated) * up))
        return outputs

    def _attention(self, tokens: Tokens, mask: Mask) -> Tokens:
        q, k, v = self.qkv(tokens).unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4)
        # float32 even under autocast: torch warns about a norm whose weights have another dtype.
        q, k = (rotary(norm(each.float()).to(v.dtype)) for norm, each in ((self.query_norm, q), (self.key_norm, k)))
        mixed = scaled_dot_product_attention(q, k, v, attn_mask=mask[:, None, None])
        outputs: Tensor = self.attended(mixed.transpose(1, 2).flatten(2))
        return outputs


def zeros(layer: nn.Linear) -> nn.Linear:
    """The layer, initialised to zeros."""
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)
    return layer


def rotary(values: Float[Tensor, "batch heads frames size"]) -> Float[Tensor, "batch heads frames size"]:
    """Rotary position embedding: pairs (i, i + size/2) rotated by frame·10,000^(−2i/size) (RoPE, Su et al. 2021)."""
    frames, size = values.shape[-2:]
    exponents = torch.arange(size // 2, device=values.device) / (size // 2)
    angles = torch.arange(frames, device=values.device)[:, None] * 10_000.0 ** (-exponents)
    first, second = values.chunk(2, dim=-1)
    cosine, sine = angles.cos(), angles.sin()
    return torch.cat((first * cosine - second * sine, first * sine + second * cosine), dim=-1)


COORDINATES = MotionsConfig(pose_vectors="field", crops="whole")
SIZES = FlowNetworkConfig(TransformerSizes(4, 128, 2, 341, 0.0), sampling_steps=25, guidance_scale=1.0)
NANO = PeerConfig(SIZES, cosine(5000, 16, 3e-3), MINILM, COORDINATES, precision="auto", ema_decay=0.995)
PUBLISHED = Schedule(epochs=500, learning_rate=2e-4)
PAPER = PeerConfig(FlowNetworkConfig(), PUBLISHED, CLIP, COORDINATES, ema_decay=0.9999, weight_decay=0.01)
FLOW = PeerStage("flow", Flow, NANO, PAPER)
