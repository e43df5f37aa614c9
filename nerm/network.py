"""NeRM's networks as the paper orders them: coordinates, CCA, the decoder f_θ (§3.1), the denoiser ε_φ (§3.2)."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Bool, Float, Float32, Float64, Int64
from motionkit.training.networks import Conditions, ConditionSizes, through_long_skips
from nerm.latents import in_use, local_latents, placed
from nerm.recipes import Activation, EncoderConfig, FieldConfig, TransformerConfig

REFERENCE_FPS = 20.0
# Of so many poses a layer's activations stay in a core's cache.
POSES_IN_CACHE = 600
DURATION_FREQUENCIES = 8


def distinct(values: Float64[Tensor, "*shape"]) -> tuple[Float64[Tensor, "padded"], Int64[Tensor, "*shape"]]:
    """The distinct values, padded with the last one, and the index of each value among them.

    Values are rounded to 2⁻⁴⁰ first, so that an instant shared by two framerates counts once. The padded length is
    m · 2ⁿ with m ≤ 16, at most an eighth more: libraries cache their plans per matrix shape, and few shapes keep a
    step's memory the same at all framerates.
    """
    unique, inverse = torch.unique(torch.round(values * 2.0**40) / 2.0**40, return_inverse=True)
    step = 1 << max(0, (len(unique) - 1).bit_length() - 4)
    return torch.cat((unique, unique[-1:].expand(-len(unique) % step))), inverse


ONEDNN = hasattr(torch.ops.mkldnn, "_linear_pointwise") and torch.backends.cpu.get_cpu_capability().startswith("AVX")


# oneDNN's call costs 10 µs more than MKL's.
FEWEST_ONEDNN_ROWS = 16


class Linear(nn.Linear):
    """x·Wᵀ + b, by oneDNN in float32 inference on x86: torch's own MKL uses half of an AMD processor's vector width."""

    def forward(self, x: Float[Tensor, "*shape inputs"]) -> Float[Tensor, "*shape outputs"]:
        """The product; oneDNN's has no gradient, and no rounding of autocast."""
        plain = x.dtype == torch.float32 and x.device.type == "cpu" and not torch.is_autocast_enabled("cpu")
        few = x.numel() < FEWEST_ONEDNN_ROWS * self.in_features
        if not ONEDNN or few or not plain or torch.is_grad_enabled():
            return super().forward(x)
        product: Tensor = torch.ops.mkldnn._linear_pointwise(x, self.weight, self.bias, "none", [], "")
        return product


class FourierFeatures(nn.Module):
    """γ(t) = [cos 2πb₁t, sin 2πb₁t, …] with b_r from an isotropic Gaussian (Tancik et al. 2020).

    With `period` (in units of t) the frequencies are whole multiples of 1 / period, so that γ repeats without a seam.
    """

    frequencies: Tensor

    def __init__(self, num_frequencies: int, scale: float, period: float | None = None) -> None:
        super().__init__()
        frequencies = torch.randn(num_frequencies, dtype=torch.float64) * scale
        if period is not None:
            frequencies = torch.clamp(torch.round(frequencies.abs() * period), min=1.0) / period
        self.register_buffer("frequencies", frequencies)

    def forward(self, coordinates: Float64[Tensor, "*shape"]) -> Float[Tensor, "*shape width"]:
        """Features of coordinates; angles in float64, features in float32."""
        angles = 2.0 * math.pi * coordinates[..., None] * self.frequencies
        return torch.stack((torch.cos(angles), torch.sin(angles)), dim=-1).flatten(-2).float()


class AttentionBlock(nn.Module):
    """Pre-norm attention to a context, then a feed-forward network with GELU; both residual (appendix D)."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.norm_queries = nn.LayerNorm(width)
        self.norm_context = nn.LayerNorm(width)
        self.norm_hidden = nn.LayerNorm(width)
        self.heads = heads
        self.queries = Linear(width, width)
        self.keys_values = Linear(width, 2 * width)
        self.merge = Linear(width, width)
        self.feed_forward = nn.Sequential(Linear(width, 4 * width), nn.GELU(), Linear(4 * width, width))

    def forward(
        self, tokens: Float[Tensor, "tokens width"], context: Float[Tensor, "context width"]
    ) -> Float[Tensor, "tokens width"]:
        """The tokens after attention to the context."""
        keys, values = self.keys_values(self.norm_context(context)).chunk(2, dim=-1)
        heads = [
            each.unflatten(-1, (self.heads, -1)).transpose(0, 1).unsqueeze(0)
            for each in (self.queries(self.norm_queries(tokens)), keys, values)
        ]
        attended = nn.functional.scaled_dot_product_attention(*heads).squeeze(0).transpose(0, 1).flatten(-2)
        tokens = tokens + self.merge(attended)
        enriched: Tensor = tokens + self.feed_forward(self.norm_hidden(tokens))
        return enriched


class CodebookCoordinateAttention(nn.Module):
    """CCA: γ(t) → γ(t) + attention over the prototypes (§3.1, Fig. 6; appendix D).

    `codebook` [N, d] is a buffer: it is frozen and travels with the weights.
    """

    codebook: Tensor

    def __init__(self, codebook: Float[Tensor, "codes dimension"], config: EncoderConfig) -> None:
        super().__init__()
        width, heads = 2 * config.num_frequencies, config.num_heads
        self.register_buffer("codebook", codebook.clone())
        self.project_codes = Linear(codebook.shape[1], width)
        self.query_embeddings = nn.Parameter(torch.randn(config.num_queries, width) * width**-0.5)
        self.to_codebook = AttentionBlock(width, heads)
        self.refine = nn.ModuleList(AttentionBlock(width, heads) for _ in range(config.num_layers))
        self.to_prototypes = AttentionBlock(width, heads)
        self._kept: tuple[list[tuple[int, int]], Tensor] | None = None

    def prototypes(self) -> Float[Tensor, "queries width"]:
        """The queries after attention to the codebook, then to each other; in inference kept while weights stay."""
        if torch.is_grad_enabled() or torch.is_autocast_enabled(self.codebook.device.type):
            return self._prototypes()
        weights = [(each.data_ptr(), each._version) for each in self.state_dict(keep_vars=True).values()]
        if self._kept is None or self._kept[0] != weights:
            self._kept = weights, self._prototypes()
        return self._kept[1]

    def _prototypes(self) -> Float[Tensor, "queries width"]:
        tokens: Tensor = self.to_codebook(self.query_embeddings, self.project_codes(self.codebook))
        for block in self.refine:
            tokens = block(tokens, tokens)
        return tokens

    def forward(self, features: Float[Tensor, "coordinates width"]) -> Float[Tensor, "coordinates width"]:
        """Codebook-enhanced features of (distinct) coordinates."""
        enhanced: Tensor = self.to_prototypes(features, self.prototypes())
        return enhanced


ACTIVATIONS: dict[Activation, type[nn.Module]] = {"relu": nn.ReLU, "silu": nn.SiLU}


@dataclass(frozen=True, eq=False)
class EncodedCoordinates:
    """Encoded distinct coordinates, and each pose's index among them.

    `features` [D, C] are inputs of the first layer; `weights` are those of the banks' knots (empty without banks).
    """

    features: Float[Tensor, "distinct width"] | None
    weights: tuple[Float32[Tensor, "distinct _ _"], ...]
    which: Int64[Tensor, "batch poses"]

    def first(self, poses: int) -> "EncodedCoordinates":
        """The first poses of an encoded increasing row of coordinates."""
        features = None if self.features is None else self.features[:poses]
        return EncodedCoordinates(features, tuple(each[:poses] for each in self.weights), self.which[:, :poses])


class ResidualLayer(nn.Module):
    """h + W·σ(LN(h)): one layer of the decoder, pre-norm (appendix D)."""

    def __init__(self, width: int, activation: Activation) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.activation = ACTIVATIONS[activation]()
        self.linear = Linear(width, width)

    def forward(self, hidden: Float[Tensor, "*shape width"]) -> Float[Tensor, "*shape width"]:
        """One layer."""
        updated: Tensor = hidden + self.linear(self.activation(self.norm(hidden)))
        return updated


class FieldNetwork(nn.Module):
    """f_θ(t, z, s) → standardised pose vectors (§3.1, Eq. 2).

    The coordinate branch depends on t alone and is computed once per distinct coordinate. The first layer is split into
    parts for z (once per clip), the coordinate (once per distinct t) and the framerate. `codebook` [N, d] is needed for
    the time encoding "codebook" and unused otherwise. With local latents the network learns what their linear model
    leaves (`nerm.latents.LinearModel`).
    """

    def __init__(
        self, config: FieldConfig, num_features: int, codebook: Float[Tensor, "codes dimension"] | None = None
    ) -> None:
        super().__init__()
        self.config, encoder, decoder = config, config.encoder, config.decoder
        self.local = local_latents(config)
        self.fourier: FourierFeatures | None = None
        self.attention: CodebookCoordinateAttention | None = None
        width = {"none": 0, "raw": 1}.get(encoder.kind, 2 * encoder.num_frequencies)
        if encoder.kind in ("fourier", "codebook"):
            period = None if self.local is None else self.local.phase_period
            self.fourier = FourierFeatures(encoder.num_frequencies, encoder.frequency_scale, period)
        if encoder.kind == "codebook":
            if codebook is None:
                raise ValueError("the time encoding 'codebook' needs a trained codebook")
            self.attention = CodebookCoordinateAttention(codebook, encoder)
        hidden, num_inputs = decoder.width, config.latents.dimension if self.local is None else self.local.num_inputs
        self.from_latent = Linear(num_inputs, hidden)
        self.from_coordinate = Linear(width, hidden, bias=False) if width else None
        self.from_framerate = Linear(1, hidden, bias=False)
        self.layers = nn.ModuleList(
            ResidualLayer(hidden, decoder.activation)
            if decoder.kind == "mlp"
            # Table 7: pre-norm self-attention over the poses of a clip.
            else nn.TransformerEncoderLayer(
                hidden, encoder.num_heads, 2 * hidden, 0.0, "gelu", batch_first=True, norm_first=True
            )
            for _ in range(decoder.num_layers - 1)
        )
        self.linear = None if self.local is None else Linear(num_inputs, num_features, bias=False)
        self.finish = nn.Sequential(nn.LayerNorm(hidden), ACTIVATIONS[decoder.activation]())
        self.output = Linear(hidden, num_features)

    @torch.no_grad()
    def start_as_linear_model(
        self, mean: Float32[Tensor, "numbers"], matrix: Float32[Tensor, "components numbers"]
    ) -> None:
        """Initialise as the linear model of the latents: its mean, and its map from components to vectors."""
        assert self.linear is not None
        self.linear.weight.zero_()
        self.linear.weight[:, : len(matrix)] = matrix.T
        self.output.weight.zero_()
        self.output.bias.copy_(mean)

    def encode_coordinates(
        self, coordinates: Float64[Tensor, "batch poses"], fps: Float64[Tensor, "batch"]
    ) -> EncodedCoordinates:
        """The whole coordinate branch, once per distinct coordinate."""
        if self.config.encoder.coordinates == "frames":
            # 1 … T at each clip's own framerate (Table 9).
            coordinates = (coordinates + 1.0) * (0.5 * self.config.windows.max_duration_seconds) * fps[:, None] + 1.0
        values, which = distinct(coordinates)
        return EncodedCoordinates(
            self._features(values), () if self.local is None else self.local.weights(values), which
        )

    def _features(self, values: Float64[Tensor, "distinct"]) -> Float[Tensor, "distinct width"] | None:
        """γ(t), enhanced by CCA; with local latents of the phase between knots, which has fewer distinct values."""
        if self.fourier is None:
            return values[:, None].float() if self.config.encoder.kind == "raw" else None
        which = torch.arange(len(values), device=values.device)
        if self.local is not None:
            values, which = distinct(torch.remainder(values + 1.0, self.local.phase_period))
        features: Tensor = self.fourier(values)
        if self.attention is not None:
            features = self.attention(features)
        return features[which]

    def decode(
        self,
        latents: Float[Tensor, "batch latent"],
        encoded: EncodedCoordinates,
        fps: Float64[Tensor, "batch"],
        num_context: int = 0,
    ) -> Float[Tensor, "batch poses numbers"]:
        """Standardised pose vectors from latents and encoded coordinates.

        In a transformer decoder all poses of a row attend to one another, or with `num_context` to the first ones.
        """
        framerate = (self.config.encoder.framerate_scale * torch.log2(fps / REFERENCE_FPS)).float()  # s of Eq. 2
        hidden = self.from_framerate(framerate[:, None])[:, None]
        inputs, path = latents[:, None], None
        if self.local is not None:
            inputs, path = self.local.read(latents, encoded.weights, encoded.which)
        hidden = hidden + self.from_latent(inputs)
        if self.from_coordinate is not None and encoded.features is not None:
            hidden = hidden + self.from_coordinate(encoded.features)[encoded.which]
        options = {}
        if num_context and self.config.decoder.kind == "transformer":
            # Poses attend to the context and to themselves, so that none depends on which others are decoded with it.
            pose = torch.arange(hidden.shape[1], device=hidden.device)
            options["src_mask"] = (pose >= num_context) & (pose[:, None] != pose)
        at_once = hidden.shape[1] if self.config.decoder.kind == "transformer" else POSES_IN_CACHE
        vectors = torch.cat([self._through_layers(poses, **options) for poses in hidden.split(at_once, dim=1)], dim=1)
        if self.linear is None or path is None:
            # Without a coordinate (`none` with a global latent) a window is one constant pose.
            return vectors.expand(-1, encoded.which.shape[1], -1)
        with torch.autocast(vectors.device.type, enabled=False):  # bfloat16 is too coarse for a path
            return placed(vectors.float() + self.linear(inputs), path)

    def _through_layers(
        self, hidden: Float[Tensor, "batch poses width"], **options: Tensor
    ) -> Float[Tensor, "batch poses numbers"]:
        for layer in self.layers:
            hidden = layer(hidden, **options)
        vectors: Tensor = self.output(self.finish(hidden))
        return vectors

    def forward(
        self,
        latents: Float32[Tensor, "batch latent"],
        coordinates: Float64[Tensor, "batch poses"],
        fps: Float64[Tensor, "batch"],
    ) -> Float[Tensor, "batch poses numbers"]:
        """f_θ(t_{v,s}, z, s) for a batch of clips."""
        return self.decode(latents, self.encode_coordinates(coordinates, fps), fps)


def attention(
    queries: Float[Tensor, "batch heads queries size"],
    keys: Float[Tensor, "batch heads keys size"],
    values: Float[Tensor, "batch heads keys size"],
    used: Bool[Tensor, "batch 1 1 keys"] | None,
) -> Float[Tensor, "batch heads queries size"]:
    """softmax(QKᵀ/√size) V over the tokens of the mask `used`."""
    if queries.device.type == "cpu" and queries.dtype == torch.bfloat16:
        # torch's own kernel is as slow as all matrix products of a step together.
        scores = queries @ keys.transpose(-1, -2) * queries.shape[-1] ** -0.5
        if used is not None:
            scores = scores.masked_fill(~used, -torch.inf)
        mixed: Tensor = torch.softmax(scores, dim=-1) @ values
        return mixed
    return nn.functional.scaled_dot_product_attention(queries, keys, values, attn_mask=used)


class SkipLayer(nn.Module):
    """One layer of the denoiser: pre-norm self-attention and feed-forward network (GELU; appendix D)."""

    def __init__(self, config: TransformerConfig) -> None:
        super().__init__()
        self.num_heads = config.num_heads
        self.attention_norm = nn.LayerNorm(config.width)
        self.queries_keys_values = Linear(config.width, 3 * config.width)
        self.attention_out = Linear(config.width, config.width)
        self.ffn_norm = nn.LayerNorm(config.width)
        self.ffn_in = Linear(config.width, config.ffn_width)
        self.ffn_out = Linear(config.ffn_width, config.width)
        self.dropout = nn.Dropout(config.dropout)

    def forward(
        self, tokens: Float[Tensor, "batch tokens width"], used: Bool[Tensor, "batch 1 1 tokens"] | None
    ) -> Float[Tensor, "batch tokens width"]:
        """One layer over all tokens; those not `used` are masked out of the attention."""
        batch, count, width = tokens.shape
        projected = self.queries_keys_values(self.attention_norm(tokens))
        heads = projected.view(batch, count, 3, self.num_heads, width // self.num_heads).permute(2, 0, 3, 1, 4)
        mixed = attention(heads[0], heads[1], heads[2], used)
        tokens = tokens + self.dropout(self.attention_out(mixed.transpose(1, 2).reshape(batch, count, width)))
        hidden = self.dropout(nn.functional.gelu(self.ffn_in(self.ffn_norm(tokens))))
        out: Tensor = tokens + self.dropout(self.ffn_out(hidden))
        return out


def step_features(steps: Int64[Tensor, "batch"], width: int) -> Float[Tensor, "batch width"]:
    """Sinusoidal features of the diffusion step k, wavelengths from 2π to 20,000π (Vaswani et al. 2017)."""
    frequencies = torch.exp(-math.log(10_000.0) * torch.arange(width // 2, device=steps.device) / (width // 2))
    angles = steps[:, None].to(torch.float32) * frequencies
    return torch.cat((angles.cos(), angles.sin()), dim=1)


class ConditionEmbedding(nn.Module):
    """Conditions → three tokens: text, action, duration (§3.2).

    The null condition is a zero mask: the embedding of the text or action is zeros, so that its token is the
    projection's bias. Guidance never drops the duration: the field needs it, so both passes of Eq. 6 see it.
    """

    num_tokens = 3

    def __init__(self, sizes: ConditionSizes, width: int) -> None:
        super().__init__()
        self.text_in = Linear(sizes.text_dimension, width)
        self.actions = nn.Embedding(max(len(sizes.actions), 1), width)
        self.duration_in = nn.Sequential(Linear(2 * DURATION_FREQUENCIES, width), nn.SiLU(), Linear(width, width))
        frequencies = 2.0 ** torch.arange(DURATION_FREQUENCIES) * (torch.pi / 8)
        self.register_buffer("frequencies", frequencies, persistent=False)
        self.frequencies: Tensor

    def forward(self, conditions: Conditions) -> Float[Tensor, "batch 3 width"]:
        """One token each; text embeddings are scaled to a root mean square of 1 before the projection."""
        text = self.text_in(conditions.text * conditions.text.shape[1] ** 0.5)
        known = (conditions.action >= 0)[:, None].to(text.dtype)
        action = self.actions(conditions.action.clamp(min=0)) * known
        angles = conditions.duration[:, None] * self.frequencies
        duration = self.duration_in(torch.cat((angles.cos(), angles.sin()), dim=1))
        return torch.stack((text, action, duration), dim=1)


@dataclass(frozen=True, eq=False)
class EmbeddedConditions:
    """What all steps of a sampling share: conditions as tokens, the numbers of z in use, the mask of tokens in use."""

    tokens: Float[Tensor, "batch 3 width"]
    used: Bool[Tensor, "batch latent"]
    mask: Bool[Tensor, "batch 1 1 tokens"] | None


class Denoiser(nn.Module):
    """ε_φ(z_k, k, c): a transformer over [z…, k, text, action, duration] tokens (§3.2, Eq. 5; appendix D).

    Long skip connections as in U-ViT (Bao et al. 2023): layer i of the first half feeds layer n − 1 − i, which joins
    both by concatenation and a linear map.

    Numbers of z that a motion of the given duration does not use are zero in input and output, and tokens of only such
    numbers are masked out of the attention.
    """

    def __init__(
        self, config: TransformerConfig, first_read: Float32[Tensor, "latent"], layout: ConditionSizes
    ) -> None:
        """`first_read` is the earliest instant at which the field reads each number of z."""
        super().__init__()
        if len(first_read) % config.latent_tokens:
            raise ValueError(f"a latent of {len(first_read)} numbers cannot be cut into {config.latent_tokens} tokens")
        self.config = config
        self.register_buffer("first_read", first_read)
        self.first_read: Tensor
        self.always_whole = bool((first_read < 0).all())
        per_token = len(first_read) // config.latent_tokens
        half = config.num_layers // 2
        self.latent_in = Linear(per_token, config.width)
        self.step_in = nn.Sequential(Linear(config.width, config.width), nn.SiLU(), Linear(config.width, config.width))
        self.conditions_in = ConditionEmbedding(layout, config.width)
        self.positions = nn.Parameter(
            torch.randn(config.latent_tokens + 1 + ConditionEmbedding.num_tokens, config.width) * 0.02
        )
        self.layers = nn.ModuleList(SkipLayer(config) for _ in range(config.num_layers))
        self.skips = nn.ModuleList(Linear(2 * config.width, config.width) for _ in range(half))
        self.out_norm = nn.LayerNorm(config.width)
        self.noise_out = Linear(config.width, per_token)

    def embed(self, conditions: Conditions) -> EmbeddedConditions:
        """The conditions as `forward` needs them at every step."""
        used, mask = in_use(self.first_read, conditions.duration), None
        if not self.always_whole:
            is_used = used.view(len(used), self.config.latent_tokens, -1).any(dim=2)
            mask = nn.functional.pad(is_used, (0, 1 + ConditionEmbedding.num_tokens), value=True)[:, None, None]
        return EmbeddedConditions(self.conditions_in(conditions), used, mask)

    def forward(
        self,
        latents: Float[Tensor, "batch latent"],
        steps: Int64[Tensor, "batch"],
        conditions: Conditions | EmbeddedConditions,
    ) -> Float[Tensor, "batch latent"]:
        """The prediction that `DiffusionConfig.prediction` names."""
        given = self.embed(conditions) if isinstance(conditions, Conditions) else conditions
        num_tokens = self.config.latent_tokens
        z = self.latent_in((latents * given.used).view(len(latents), num_tokens, -1))
        time = self.step_in(step_features(steps, self.config.width))[:, None]
        tokens = torch.cat((z, time, given.tokens), dim=1) + self.positions
        tokens = through_long_skips(tokens, self.layers, self.skips, lambda layer, tokens: layer(tokens, given.mask))
        out: Tensor = self.noise_out(self.out_norm(tokens[:, :num_tokens]))
        return out.flatten(1) * given.used
