"""MDM, CAMDM and MLD, diffusion models, and ACMDM's small form, a rectified flow.

MDM (Tevet et al. 2023; GuyTevet/motion-diffusion-model, model/mdm.py): diffusion of whole motions.
CAMDM (Chen et al. 2024; AIGAnimation/CAMDM, PyTorch/network): autoregressive diffusion of segments in four steps.
MLD (Chen et al. 2023; ChenFengYe/motion-latent-diffusion, mld/models): diffusion in the latent space of a VAE.
ACMDM (Meng et al. 2025; neu-vi/ACMDM, models/ACMDM.py): a rectified flow of absolute coordinates.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn
from torch.nn.functional import pad, scaled_dot_product_attention, silu, smooth_l1_loss

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Bool, Float
from motionkit.training import networks
from motionkit.training.config import DiffusionConfig, Schedule
from motionkit.training.networks import Conditions, guided, kl_divergence, reparameterized
from peers import layers
from peers.generating import CLIP, MINILM, SMALL, UNCONDITIONAL, PeerConfig, PeerStage, cosine
from peers.layers import ConditionVector, Latents, NetworkInputs, PeerNetwork, Steps, Tokens, TransformerSizes
from peers.motions import Mask, MotionBatch, MotionsConfig, PoseSpace, Rows, SampleBatch

# Ankle and foot joints of the 22-joint skeleton; a foot that moves less than this per frame (metres) is in contact.
FEET, CONTACT_METRES = (7, 10, 8, 11), 0.01
# Flow times lie in [0, 1]; the sinusoidal embedding expects diffusion steps.
TIME_SCALE = 1000


def with_inputs(network: Callable[..., Tensor], *inputs: Tensor) -> networks.ConditionalNetwork:
    """A network with these further inputs for each motion, repeated where guidance repeats the batch."""
    return lambda noisy, steps, conditions: network(
        noisy, steps, conditions, *(torch.cat([each] * (len(noisy) // len(each))) for each in inputs)
    )


def noised(clean: Rows, config: DiffusionConfig, generator: torch.Generator) -> tuple[Rows, Steps, Rows]:
    """Noise each motion to a random step, drawn on the CPU; gives noisy motions, steps and noise on their device."""
    steps = torch.randint(config.num_steps, (len(clean),), generator=generator).to(clean.device)
    noise = torch.randn(clean.shape, generator=generator).to(clean.device)
    alphas = networks.cumulative_alphas(config).to(clean.device)
    return networks.add_noise(clean.flatten(1), noise.flatten(1), steps, alphas).view(clean.shape), steps, noise


def diffusion_loss(
    network: networks.ConditionalNetwork, config: DiffusionConfig, batch: MotionBatch, clean: Rows, mask: Mask
) -> Float[Tensor, ""]:
    """Squared error of the prediction at random steps, averaged over each motion's valid frames, then over motions."""
    alphas = networks.cumulative_alphas(config).to(clean.device)
    noisy, steps, noise = noised(clean, config, batch.generator)
    target = networks.prediction_target(config.prediction, clean.flatten(1), noise.flatten(1), steps, alphas)
    predicted = network(noisy * mask[..., None], steps, batch.conditions).float()
    errors = (predicted - target.view(clean.shape)).square().mean(dim=-1) * mask
    return (errors.sum(dim=1) / mask.sum(dim=1)).mean()


@torch.inference_mode()
def diffusion_sample(network: networks.ConditionalNetwork, batch: SampleBatch, draw: Callable[[], Rows]) -> Rows:
    """Sample clean motions or latents, float64; `draw` returns fresh noise."""
    config, start = batch.diffusion, draw()
    conditions = batch.conditions.paired(batch.unconditional, config.guidance_scale)
    alphas = networks.cumulative_alphas(config)

    def predict_noise(flat: Tensor, steps: Tensor) -> Tensor:
        noisy, at = flat.view(start.shape).float(), steps.to(start.device)
        output = guided(network, noisy, at, conditions, config.guidance_scale)
        alpha = float(alphas[int(steps[0])])
        return networks.predicted_noise(config.prediction, output.double().flatten(1), flat, alpha)

    draw_noise = (lambda: draw().flatten(1)) if config.sampler == "ddpm" else None
    steps = networks.sampling_steps(config)
    return networks.sample(predict_noise, start.flatten(1), alphas, steps, draw_noise=draw_noise).view(start.shape)


@dataclass(frozen=True)
class MdmNetworkConfig:
    """MDM: a transformer encoder over one token of time and condition, then frames; predicts the clean motion.

    1,000 steps as first published, all of them sampled; `mdm-50` is trained separately with 50.
    """

    transformer: TransformerSizes = TransformerSizes(8, 512, 4, 1024)
    diffusion: DiffusionConfig = DiffusionConfig(
        schedule="cosine", prediction="latent", sampler="ddpm", sampling_steps=1000, guidance_scale=2.5
    )


class Mdm(PeerNetwork):
    """MDM: predicts x̂₀ of noisy frames with a transformer encoder over [time + condition; frames]."""

    def __init__(self, config: MdmNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        width = config.transformer.width
        self.diffusion: DiffusionConfig = config.diffusion
        self.width, self.numbers = width, inputs.space.num_features
        self.frame_in = nn.Linear(self.numbers, width)
        self.condition = ConditionVector(inputs.conditions, width, null_text=True)
        self.step_in = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.dropout = nn.Dropout(config.transformer.dropout)
        self.layers = layers.encoder(config.transformer)
        self.frame_out = nn.Linear(width, self.numbers)

    def forward(self, noisy: Rows, steps: Steps, conditions: Conditions, mask: Mask) -> Rows:
        """The clean motion; padding frames are masked out of the attention."""
        first = self.step_in(layers.sinusoids(steps, self.width)) + self.condition(conditions)
        tokens = torch.cat((first[:, None], self.frame_in(noisy)), dim=1)
        tokens = self.layers(self.dropout(tokens + layers.positions(tokens)), src_key_padding_mask=pad(~mask, (1, 0)))
        clean: Tensor = self.frame_out(tokens[:, 1:])
        return clean

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Mean squared error over valid frames."""
        network = with_inputs(self, batch.mask)
        return {"loss": diffusion_loss(network, self.diffusion, batch, batch.rows, batch.mask)}

    def sample(self, batch: SampleBatch) -> Rows:
        """Standardised rows."""
        network = with_inputs(self, batch.mask)
        return diffusion_sample(network, batch, lambda: batch.noise_within(batch.lengths, self.numbers))


@dataclass(frozen=True)
class CamdmNetworkConfig:
    """CAMDM: predicts `future` frames from `past` ones, which are dropped with probability `no_past`."""

    transformer: TransformerSizes = TransformerSizes(4, 256, 4, 1024)
    past: int = 10
    future: int = 45
    no_past: float = 0.15
    diffusion: DiffusionConfig = DiffusionConfig(
        num_steps=4, schedule="cosine", prediction="latent", sampler="ddpm", sampling_steps=4, guidance_scale=1.0
    )


class Camdm(PeerNetwork):
    """CAMDM: predicts x̂₀ of future frames with a transformer over [time; condition; past frames; noisy frames]."""

    def __init__(self, config: CamdmNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        width = config.transformer.width
        self.config, self.diffusion, self.width = config, config.diffusion, width
        self.space, self.numbers = inputs.space, inputs.space.num_features
        self.frame_in, self.past_in = nn.Linear(self.numbers, width), nn.Linear(self.numbers, width)
        self.no_past = nn.Parameter(torch.zeros(width))
        self.condition = ConditionVector(inputs.conditions, width)
        self.step_in = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.dropout = nn.Dropout(config.transformer.dropout)
        self.layers = layers.encoder(config.transformer)
        self.frame_out = nn.Linear(width, self.numbers)

    def forward(
        self,
        noisy: Rows,
        steps: Steps,
        conditions: Conditions,
        past: Float[Tensor, "batch past numbers"],
        has_past: Bool[Tensor, "batch"],
    ) -> Rows:
        """The clean frames that follow `past`; rows without `has_past` start a motion."""
        time = self.step_in(layers.sinusoids(steps, self.width))
        before = torch.where(has_past[:, None, None], self.past_in(past), self.no_past)
        first = torch.stack((time, self.condition(conditions)), dim=1)
        tokens = torch.cat((first, before, self.frame_in(noisy)), dim=1)
        tokens = self.layers(self.dropout(tokens + layers.positions(tokens)))
        clean: Tensor = self.frame_out(tokens[:, -noisy.shape[1] :])
        return clean

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Squared errors of pose vectors, joints, their frame differences, and the velocity of feet in contact."""
        past, clean = batch.rows[:, : self.config.past], batch.rows[:, self.config.past :]
        mask = batch.mask[:, self.config.past :]
        has_past = (torch.rand(len(past), generator=batch.generator) >= self.config.no_past).to(past.device)
        noisy, steps, _ = noised(clean, self.config.diffusion, batch.generator)
        predicted = self(noisy * mask[..., None], steps, batch.conditions, past, has_past)
        both = mask[:, 1:] & mask[:, :-1]
        joints, truth = self.space.joints(predicted), self.space.joints(clean)
        moved, true_moved = joints.diff(dim=1), truth.diff(dim=1)
        contact = (true_moved[:, :, FEET].norm(dim=-1) <= CONTACT_METRES) & both[..., None]
        terms = {
            "pose": (predicted - clean)[mask].square().mean(),
            "pose_change": (predicted.diff(dim=1) - clean.diff(dim=1))[both].square().mean(),
            "joints": (joints - truth)[mask].square().mean(),
            "joint_change": (moved - true_moved)[both].square().mean(),
            "feet": (moved[:, :, FEET].square().sum(dim=-1) * contact).sum() / contact.sum().clamp(min=1),
        }
        return {"loss": torch.stack(list(terms.values())).sum(), **terms}

    def sample(self, batch: SampleBatch) -> Rows:
        """Standardised rows, segment after segment."""
        count, past = len(batch.lengths), self.config.past
        rows = torch.zeros((count, past, self.numbers), device=batch.device)
        for start in range(0, batch.frames, self.config.future):
            has_past = torch.full((count,), start > 0, device=batch.device)
            network = with_inputs(self, rows[:, -past:], has_past)
            segment = diffusion_sample(network, batch, lambda: batch.noise(self.config.future, self.numbers))
            rows = torch.cat((rows, segment.float()), dim=1)
        return rows[:, past : past + batch.frames]


@dataclass(frozen=True)
class MldVaeNetworkConfig:
    """MLD's VAE: transformers of these sizes and one latent of their width; `longest` counts learned positions."""

    transformer: TransformerSizes = TransformerSizes(9, 256, 4, 1024)
    longest: int = 500
    kl_weight: float = 1e-4


@dataclass(frozen=True)
class MldNetworkConfig:
    """MLD's denoiser over the tokens latent, time and condition; `time_features` is the size of the step embedding.

    Training draws `noises` noise samples per latent, since encoding costs far more than denoising.
    """

    transformer: TransformerSizes = TransformerSizes(9, 256, 4, 1024)
    time_features: int = 768
    noises: int = 1
    diffusion: DiffusionConfig = DiffusionConfig(sampling_spacing="leading")


class LongSkips(nn.Module):
    """Layers with long skip connections, then a layer norm (mld/models/operator/cross_attention.py)."""

    def __init__(self, sizes: TransformerSizes, layer: type[layers.Layer]) -> None:
        super().__init__()
        self.layers = nn.ModuleList(layers.attention(layer, sizes) for _ in range(sizes.layers))
        self.joins = nn.ModuleList(nn.Linear(2 * sizes.width, sizes.width) for _ in range(sizes.layers // 2))
        self.norm = nn.LayerNorm(sizes.width)

    def forward(self, tokens: Tokens, *memory: Tensor, **masks: Tensor) -> Tokens:
        """The tokens after all layers, which get `memory` and torch's padding masks too."""
        tokens = networks.through_long_skips(
            tokens, self.layers, self.joins, lambda layer, each: layer(each, *memory, **masks)
        )
        normed: Tensor = self.norm(tokens)
        return normed


class MldVae(PeerNetwork):
    """MLD, stage 1, a VAE with one latent per motion: transformers with long skip connections."""

    def __init__(self, config: MldVaeNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        width = config.transformer.width
        self.config, self.space, self.width = config, inputs.space, width
        self.frame_in = nn.Linear(inputs.space.num_features, width)
        self.distribution = nn.Parameter(torch.randn(2, width))
        self.encoder_positions = nn.Parameter(torch.rand(config.longest, width))
        self.decoder_positions = nn.Parameter(torch.rand(config.longest, width))
        self.encoder = LongSkips(config.transformer, nn.TransformerEncoderLayer)
        self.decoder = LongSkips(config.transformer, nn.TransformerDecoderLayer)
        self.frame_out = nn.Linear(width, inputs.space.num_features)

    def encode(self, rows: Rows, mask: Mask) -> tuple[Latents, Latents]:
        """μ and log σ²."""
        tokens = torch.cat((self.distribution.expand(len(rows), -1, -1), self.frame_in(rows)), dim=1)
        tokens = tokens + self.encoder_positions[: tokens.shape[1]]
        tokens = self.encoder(tokens, src_key_padding_mask=pad(~mask, (2, 0)))
        return tokens[:, 0], tokens[:, 1]

    def decode(self, latents: Latents, mask: Mask) -> Rows:
        """Standardised rows, zeros outside the mask."""
        queries = self.decoder_positions[: mask.shape[1]].expand(len(latents), -1, -1)
        tokens = self.decoder(queries, latents[:, None], tgt_key_padding_mask=~mask)
        rows: Tensor = self.frame_out(tokens) * mask[..., None]
        return rows

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Smooth L1 of pose vectors and of joints over valid frames, and KL, each averaged over elements."""
        mask, joints_of = batch.mask, self.space.joints
        mean, log_variance = self.encode(batch.rows, mask)
        predicted = self.decode(reparameterized(mean, log_variance, batch.generator), mask)
        features = smooth_l1_loss(predicted[mask], batch.rows[mask])
        joints = smooth_l1_loss(joints_of(predicted)[mask], joints_of(batch.rows)[mask])
        kl = kl_divergence(mean, log_variance).mean()
        loss = features + joints + self.config.kl_weight * kl
        return {"loss": loss, "features": features, "joints": joints, "kl": kl}


class Mld(PeerNetwork):
    """MLD, stage 2: predicts a latent's noise with a long-skip transformer over [latent, time, condition]."""

    def __init__(self, config: MldNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        vae, width = inputs.earlier, config.transformer.width
        assert isinstance(vae, MldVae)
        self.config, self.diffusion, self.width = config, config.diffusion, width
        self.vae = (vae,)  # in a tuple: frozen, and saved with its own stage
        self.step_in = nn.Sequential(nn.Linear(config.time_features, width), nn.SiLU(), nn.Linear(width, width))
        self.condition = ConditionVector(inputs.conditions, width, null_text=True)
        has_condition = bool(inputs.conditions.text_dimension or inputs.conditions.actions)
        self.positions = nn.Parameter(torch.rand(2 + has_condition, width))
        self.layers = LongSkips(config.transformer, nn.TransformerEncoderLayer)

    def forward(self, noisy: Tokens, steps: Steps, conditions: Conditions) -> Float[Tensor, "batch 1 width"]:
        """ε of a noisy latent, [batch, 1, width]."""
        # Sinusoids with cos before sin (diffusers' `Timesteps` with `flip_sin_to_cos`).
        half = self.config.time_features // 2
        angles = steps[:, None].to(torch.float32) * 10_000.0 ** -(torch.arange(half, device=steps.device) / half)
        time = self.step_in(torch.cat((angles.cos(), angles.sin()), dim=1))
        condition = self.condition(replace(conditions, text=conditions.text.relu()))
        tokens = torch.cat((noisy, time[:, None], condition[:, None]), dim=1)[:, : len(self.positions)]
        outputs: Tensor = self.layers(tokens + self.positions)
        return outputs[:, :1]

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Squared error of ε, with latents resampled at every step."""
        with torch.no_grad():
            latents = reparameterized(*self.vae[0].encode(batch.rows, batch.mask), batch.generator)[:, None]
        rows = torch.arange(len(latents)).repeat(self.config.noises)
        latents, batch = latents[rows], replace(batch, conditions=batch.conditions.rows(rows))
        every = torch.ones(latents.shape[:2], dtype=torch.bool, device=latents.device)
        return {"loss": diffusion_loss(self, self.config.diffusion, batch, latents, every)}

    def sample(self, batch: SampleBatch) -> Rows:
        """Standardised rows."""
        latents = diffusion_sample(self, batch, lambda: batch.noise(1, self.width))
        return self.vae[0].decode(latents[:, 0].float(), batch.mask)


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
        network, steps = with_inputs(self, batch.mask), self.config.sampling_steps
        scale = batch.conditions.guidance(self.config.guidance_scale)
        conditions = batch.conditions.paired(batch.unconditional, scale)
        x = batch.noise_within(batch.lengths, self.numbers).float()
        for step in range(steps):
            times = torch.full((len(x),), step / steps, device=batch.device)
            x = x + guided(network, x, times, conditions, scale) / steps
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
        self.joints = networks.VectorScaling(_added(space.scaling.mean), variance.sqrt())

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


MDM_NANO = PeerConfig(MdmNetworkConfig(SMALL), cosine(6000, 16, 1e-3), MINILM, precision="auto", ema_decay=0.995)
MDM_PAPER = PeerConfig(MdmNetworkConfig(), Schedule(steps=600_000))
IN_50 = replace(MdmNetworkConfig().diffusion, num_steps=50, sampling_steps=50)
MDM_NANO_50 = replace(MDM_NANO, network=MdmNetworkConfig(SMALL, IN_50))
MDM_PAPER_50 = replace(MDM_PAPER, network=MdmNetworkConfig(diffusion=IN_50), ema_decay=0.9999)
MDM = PeerStage("mdm", Mdm, MDM_NANO, MDM_PAPER)
MDM_50 = PeerStage("mdm-50", Mdm, MDM_NANO_50, MDM_PAPER_50)

SEGMENTS = MotionsConfig(fps=30.0, max_frames=294, sampled_frames=55)
CAMDM_SIZES, MINILM_15, CLIP_15 = CamdmNetworkConfig(SMALL), replace(MINILM, drop=0.15), replace(CLIP, drop=0.15)
CAMDM_NANO = PeerConfig(CAMDM_SIZES, cosine(6000, 64, 3e-3), MINILM_15, SEGMENTS, precision="auto", ema_decay=0.995)
CAMDM_PUBLISHED = Schedule(epochs=100, batch_size=512)
CAMDM_PAPER = PeerConfig(CamdmNetworkConfig(), CAMDM_PUBLISHED, CLIP_15, SEGMENTS, weight_decay=0.01)
CAMDM = PeerStage("camdm", Camdm, CAMDM_NANO, CAMDM_PAPER)

SKIPS, PUBLISHED_VAE = TransformerSizes(5, 128, 2, 256, dropout=0.0), Schedule(epochs=6000, batch_size=128)
NANO_VAE = PeerConfig(MldVaeNetworkConfig(SKIPS), cosine(1200, 16, 5e-4, 0.1), UNCONDITIONAL, precision="auto")
PAPER_VAE = PeerConfig(MldVaeNetworkConfig(), PUBLISHED_VAE, UNCONDITIONAL, weight_decay=0.01)
MLD_VAE = PeerStage("mld-vae", MldVae, NANO_VAE, PAPER_VAE)
MLD_SIZES, MINILM_OF_NOTHING = MldNetworkConfig(SKIPS, time_features=128, noises=8), replace(MINILM, nothing="empty")
MLD_NANO = PeerConfig(MLD_SIZES, cosine(4000, 16, 3e-3), MINILM_OF_NOTHING, precision="auto", ema_decay=0.995)
MLD_PAPER = PeerConfig(MldNetworkConfig(), Schedule(epochs=2000), replace(CLIP, nothing="empty"), weight_decay=0.01)
MLD = PeerStage("mld", Mld, MLD_NANO, MLD_PAPER, builds_on=MLD_VAE)

COORDINATES = MotionsConfig(pose_vectors="field", crops="whole")
FLOW_SIZES = FlowNetworkConfig(TransformerSizes(4, 128, 2, 341, 0.0), sampling_steps=25, guidance_scale=1.0)
FLOW_NANO = PeerConfig(FLOW_SIZES, cosine(5000, 16, 3e-3), MINILM, COORDINATES, precision="auto", ema_decay=0.995)
FLOW_PUBLISHED = Schedule(epochs=500, learning_rate=2e-4)
FLOW_PAPER = PeerConfig(FlowNetworkConfig(), FLOW_PUBLISHED, CLIP, COORDINATES, ema_decay=0.9999, weight_decay=0.01)
FLOW = PeerStage("flow", Flow, FLOW_NANO, FLOW_PAPER)
