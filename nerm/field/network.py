"""The motion field f_θ(t, z, s) → pose (paper §3.1, Eq. 2; appendix D).

The coordinate branch depends on t alone and is computed once per distinct coordinate. The first layer is split into
parts for z (once per clip), the coordinate (once per distinct t) and the framerate.
"""

from dataclasses import dataclass

import torch
from torch import nn

from motionkit.core.shapes import Bool, Float, Float32, Float64, Int64
from nerm.coordinates import (
    CodebookCoordinateAttention,
    FourierFeatures,
    distinct,
    frame_numbers,
    framerate_number,
    rounded_up,
)
from nerm.latents.knots import placed
from nerm.latents.local import KnotWeights, Reading, local_latents
from nerm.settings import Activation, FieldConfig

ACTIVATIONS: dict[Activation, type[nn.Module]] = {"relu": nn.ReLU, "silu": nn.SiLU, "gelu": nn.GELU}


@dataclass(frozen=True, eq=False)
class EncodedCoordinates:
    """Encoded distinct coordinates, and each pose's index among them.

    `features` [D, C] are inputs of the first layer; `weights` are the knots' weights (local layout only).
    """

    features: Float[torch.Tensor, "distinct width"] | None
    weights: KnotWeights | None
    which: Int64[torch.Tensor, "batch poses"]

    def first(self, poses: int) -> "EncodedCoordinates":
        """The first poses of an encoded increasing row of coordinates."""
        features = None if self.features is None else self.features[:poses]
        weights = None if self.weights is None else self.weights.first(poses)
        return EncodedCoordinates(features, weights, self.which[:, :poses])


class ResidualLayer(nn.Module):
    """h + W·σ(LN(h)): one layer of the decoder, pre-norm."""

    def __init__(self, width: int, activation: Activation) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.activation = ACTIVATIONS[activation]()
        self.linear = nn.Linear(width, width)

    def forward(self, hidden: Float[torch.Tensor, "*shape width"]) -> Float[torch.Tensor, "*shape width"]:
        """One layer."""
        updated: torch.Tensor = hidden + self.linear(self.activation(self.norm(hidden)))
        return updated


class TransformerLayer(nn.Module):
    """Table 7's alternative: pre-norm self-attention over the poses of a clip, masked where `hidden_from` is true."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.layer = nn.TransformerEncoderLayer(
            width, heads, 2 * width, dropout=0.0, activation="gelu", batch_first=True, norm_first=True
        )

    def forward(
        self,
        hidden: Float[torch.Tensor, "batch poses width"],
        hidden_from: Bool[torch.Tensor, "poses poses"] | None = None,
    ) -> Float[torch.Tensor, "batch poses width"]:
        """One layer."""
        updated: torch.Tensor = self.layer(hidden, src_mask=hidden_from)
        return updated


def seen_through(num_context: int, num_poses: int, device: torch.device) -> Bool[torch.Tensor, "poses poses"]:
    """Attention mask: the first poses are a context that attends to itself; any other pose attends to it and to itself.

    So a pose does not depend on which others are decoded with it.
    """
    poses = torch.arange(num_poses, device=device)
    return (poses >= num_context) & (poses[:, None] != poses)


class FieldNetwork(nn.Module):
    """f_θ: latents, coordinates and framerates → standardised `field` vectors.

    `codebook` [N, d] is needed for the time encoding "codebook" and unused otherwise.
    """

    def __init__(
        self, config: FieldConfig, num_features: int, codebook: Float[torch.Tensor, "codes dimension"] | None = None
    ) -> None:
        super().__init__()
        self.config = config
        self.local = local_latents(config)
        self.fourier, self.attention = self._time_encoding(codebook)
        width, hidden = self._feature_width(), config.decoder.width
        self.from_latent = nn.Linear(config.latents.dimension if self.local is None else self.local.num_seen, hidden)
        self.from_coordinate = nn.Linear(width, hidden, bias=False) if width else None
        self.from_framerate = nn.Linear(1, hidden, bias=False)
        layers = [
            ResidualLayer(hidden, config.decoder.activation)
            if config.decoder.kind == "mlp"
            else TransformerLayer(hidden, config.encoder.num_heads)
            for _ in range(config.decoder.num_layers - 1)
        ]
        self.layers = nn.ModuleList(layers)
        self.linear = None
        if config.decoder.linear_path and self.local is not None:
            self.linear = nn.Linear(self.local.num_seen, num_features, bias=False)
        self.finish = nn.Sequential(nn.LayerNorm(hidden), ACTIVATIONS[config.decoder.activation]())
        self.output = nn.Linear(hidden, num_features)

    @torch.no_grad()
    def start_linear_path(
        self, mean: Float32[torch.Tensor, "numbers"], matrix: Float32[torch.Tensor, "components numbers"]
    ) -> None:
        """Initialise as the linear model of the latents' ridge fit; the layers learn the residual."""
        assert self.linear is not None
        self.linear.weight.zero_()
        self.linear.weight[:, : len(matrix)] = matrix.T
        self.output.weight.zero_()
        self.output.bias.copy_(mean)

    def _time_encoding(
        self, codebook: torch.Tensor | None
    ) -> tuple[FourierFeatures | None, CodebookCoordinateAttention | None]:
        config = self.config
        if config.encoder.kind in ("none", "raw"):
            return None, None
        period = None if self.local is None else self.local.phase_period
        fourier = FourierFeatures(config.encoder.num_frequencies, config.encoder.frequency_scale, period)
        if config.encoder.kind == "fourier":
            return fourier, None
        if codebook is None:
            raise ValueError("the time encoding 'codebook' needs a trained codebook")
        attention = CodebookCoordinateAttention(
            codebook,
            width=config.encoder.query_width,
            num_queries=config.encoder.num_queries,
            heads=config.encoder.num_heads,
            layers=config.encoder.num_layers,
        )
        return fourier, attention

    def _feature_width(self) -> int:
        if self.fourier is not None:
            return self.fourier.width
        return 1 if self.config.encoder.kind == "raw" else 0

    def encode_coordinates(
        self, coordinates: Float64[torch.Tensor, "batch poses"], fps: Float64[torch.Tensor, "batch"]
    ) -> EncodedCoordinates:
        """The whole coordinate branch, once per distinct coordinate."""
        read = coordinates
        if self.config.encoder.coordinates == "frames":
            read = frame_numbers(coordinates, fps, self.config.windows.max_duration_seconds)
        values, which = distinct(read)
        values = rounded_up(values)
        weights = None if self.local is None else self.local.weights(values)
        return EncodedCoordinates(self._features(values), weights, which)

    def _features(self, values: Float64[torch.Tensor, "distinct"]) -> Float[torch.Tensor, "distinct width"] | None:
        """γ(t), enhanced by CCA; with local latents of the phase between knots, which has fewer distinct values."""
        if self.fourier is None:
            return values[:, None].float() if self.config.encoder.kind == "raw" else None
        if self.local is None:
            read, which = values, torch.arange(len(values), device=values.device)
        else:
            read, which = distinct(torch.remainder(values + 1.0, self.local.phase_period))
            read = rounded_up(read)
        features: torch.Tensor = self.fourier(read)
        if self.attention is not None:
            features = self.attention(features)
        return features[which]

    @property
    def num_read(self) -> int:
        """Output size of `read`; 0 without knots."""
        return 0 if self.local is None else self.local.num_seen + self._feature_width()

    def read(
        self, latents: Float[torch.Tensor, "batch latent"], encoded: EncodedCoordinates
    ) -> Float[torch.Tensor, "batch poses read"]:
        """The decoder's inputs from z and t at each pose, for latents with knots."""
        assert self.local is not None and encoded.weights is not None
        seen = self.local.read(latents, encoded.weights, encoded.which).seen
        return seen if encoded.features is None else torch.cat((seen, encoded.features[encoded.which]), dim=-1)

    def decode(
        self,
        latents: Float[torch.Tensor, "batch latent"],
        encoded: EncodedCoordinates,
        fps: Float64[torch.Tensor, "batch"],
        num_context: int = 0,
    ) -> Float[torch.Tensor, "batch poses numbers"]:
        """Standardised pose vectors from latents and encoded coordinates.

        In a transformer decoder all poses of a row attend to one another, or with `num_context` to the first ones.
        """
        hidden = self.from_framerate(framerate_number(fps, self.config.encoder.framerate_scale)[:, None])[:, None]
        reading = None
        if self.local is not None and encoded.weights is not None:
            reading = self.local.read(latents, encoded.weights, encoded.which)
        hidden = hidden + self.from_latent(latents[:, None] if reading is None else reading.seen)
        if self.from_coordinate is not None and encoded.features is not None:
            hidden = hidden + self.from_coordinate(encoded.features)[encoded.which]
        hidden_from: tuple[torch.Tensor, ...] = ()
        if num_context and self.config.decoder.kind == "transformer":
            hidden_from = (seen_through(num_context, hidden.shape[1], hidden.device),)
        for layer in self.layers:
            hidden = layer(hidden, *hidden_from)
        vectors: torch.Tensor = self.output(self.finish(hidden))
        if reading is not None:
            return self._assembled(vectors, reading)
        # Without a coordinate (`none` with a global latent) a window is one constant pose.
        return vectors.expand(-1, encoded.which.shape[1], -1)

    def _assembled(
        self, vectors: Float[torch.Tensor, "batch poses numbers"], reading: Reading
    ) -> Float32[torch.Tensor, "batch poses numbers"]:
        """Add the linear model's output and place poses on the body's path; in float32 even under autocast."""
        with torch.autocast(vectors.device.type, enabled=False):
            vectors = vectors.float()
            if self.linear is not None:
                vectors = vectors + self.linear(reading.seen)
            return vectors if reading.path is None else placed(vectors, reading.path)

    def forward(
        self,
        latents: Float32[torch.Tensor, "batch latent"],
        coordinates: Float64[torch.Tensor, "batch poses"],
        fps: Float64[torch.Tensor, "batch"],
    ) -> Float[torch.Tensor, "batch poses numbers"]:
        """f_θ(t_{v,s}, z, s) for a batch of clips."""
        return self.decode(latents, self.encode_coordinates(coordinates, fps), fps)
