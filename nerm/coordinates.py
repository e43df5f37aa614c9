"""Network inputs from times: coordinates t, the framerate, Fourier features, codebook attention (paper §3.1)."""

import math

import torch
from torch import nn

from motionkit.core.shapes import Float, Float32, Float64, Int64

REFERENCE_FPS = 20.0


def framerate_number(fps: Float64[torch.Tensor, "*shape"], scale: float) -> Float32[torch.Tensor, "*shape"]:
    """The framerate s as the network reads it: scale · log₂(s / 20)."""
    return (scale * torch.log2(fps / REFERENCE_FPS)).float()


def frame_numbers(
    coordinates: Float64[torch.Tensor, "batch poses"],
    fps: Float64[torch.Tensor, "batch"],
    max_duration_seconds: float,
) -> Float64[torch.Tensor, "batch poses"]:
    """Normalised coordinates → frame numbers 1 … T at each clip's own framerate: Table 9's alternative."""
    return (coordinates + 1.0) * (0.5 * max_duration_seconds) * fps[:, None] + 1.0


def distinct(
    values: Float64[torch.Tensor, "*shape"],
) -> tuple[Float64[torch.Tensor, "distinct"], Int64[torch.Tensor, "*shape"]]:
    """The distinct values and the index of each value among them, as `torch.unique` with `return_inverse`.

    Values are rounded to 2⁻⁴⁰ first, so that an instant shared by two framerates counts once.
    """
    rounded = torch.round(values * 2.0**40) / 2.0**40
    unique, inverse = torch.unique(rounded, return_inverse=True)
    return unique, inverse


def rounded_up(values: Float64[torch.Tensor, "distinct"]) -> Float64[torch.Tensor, "padded"]:
    """Pad the values with the last one to a length m · 2ⁿ with m ≤ 16: at most an eighth more.

    The number of distinct coordinates differs from step to step, and libraries cache their plans per matrix shape: few
    shapes keep a step's memory the same at all framerates.
    """
    count = len(values)
    step = 1 << max(0, (count - 1).bit_length() - 4)
    return torch.cat((values, values[-1:].expand(-count % step)))


class FourierFeatures(nn.Module):
    """γ(t) = [cos 2πb₁t, sin 2πb₁t, …] with b_r from an isotropic Gaussian (Tancik et al. 2020).

    With `period` (in units of t) the frequencies are whole multiples of 1 / period, so that γ repeats without a seam.
    """

    frequencies: torch.Tensor

    def __init__(self, num_frequencies: int, scale: float, period: float | None = None) -> None:
        super().__init__()
        frequencies = torch.randn(num_frequencies, dtype=torch.float64) * scale
        if period is not None:
            frequencies = torch.clamp(torch.round(frequencies.abs() * period), min=1.0) / period
        self.register_buffer("frequencies", frequencies)

    @property
    def width(self) -> int:
        """Numbers per coordinate: 2·R."""
        return 2 * len(self.frequencies)

    def forward(self, coordinates: Float64[torch.Tensor, "*shape"]) -> Float[torch.Tensor, "*shape width"]:
        """Features of coordinates; angles in float64, features in float32."""
        angles = 2.0 * math.pi * coordinates[..., None] * self.frequencies
        return torch.stack((torch.cos(angles), torch.sin(angles)), dim=-1).flatten(-2).float()


class AttentionBlock(nn.Module):
    """Pre-norm attention to a context, then a feed-forward network with GELU; both residual."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.norm_queries = nn.LayerNorm(width)
        self.norm_context = nn.LayerNorm(width)
        self.norm_hidden = nn.LayerNorm(width)
        self.heads = heads
        self.queries = nn.Linear(width, width)
        self.keys_values = nn.Linear(width, 2 * width)
        self.merge = nn.Linear(width, width)
        self.feed_forward = nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width))

    def forward(
        self, tokens: Float[torch.Tensor, "tokens width"], context: Float[torch.Tensor, "context width"]
    ) -> Float[torch.Tensor, "tokens width"]:
        """The tokens after attention to the context."""
        keys, values = self.keys_values(self.norm_context(context)).chunk(2, dim=-1)
        heads = [
            each.unflatten(-1, (self.heads, -1)).transpose(0, 1).unsqueeze(0)
            for each in (self.queries(self.norm_queries(tokens)), keys, values)
        ]
        attended = nn.functional.scaled_dot_product_attention(*heads).squeeze(0).transpose(0, 1).flatten(-2)
        tokens = tokens + self.merge(attended)
        enriched: torch.Tensor = tokens + self.feed_forward(self.norm_hidden(tokens))
        return enriched


class CodebookCoordinateAttention(nn.Module):
    """γ(t) → γ(t) + attention over the prototypes.

    `codebook` [N, d] is a buffer: it is frozen and travels with the weights. `width` must equal that of γ(t).
    """

    codebook: torch.Tensor

    def __init__(
        self, codebook: Float[torch.Tensor, "codes dimension"], *, width: int, num_queries: int, heads: int, layers: int
    ) -> None:
        super().__init__()
        self.register_buffer("codebook", codebook.clone())
        self.project_codes = nn.Linear(codebook.shape[1], width)
        self.query_embeddings = nn.Parameter(torch.randn(num_queries, width) * width**-0.5)
        self.to_codebook = AttentionBlock(width, heads)
        self.refine = nn.ModuleList(AttentionBlock(width, heads) for _ in range(layers))
        self.to_prototypes = AttentionBlock(width, heads)

    def prototypes(self) -> Float[torch.Tensor, "queries width"]:
        """The queries after cross-attention to the codebook and self-attention."""
        tokens: torch.Tensor = self.to_codebook(self.query_embeddings, self.project_codes(self.codebook))
        for block in self.refine:
            tokens = block(tokens, tokens)
        return tokens

    def forward(self, features: Float[torch.Tensor, "coordinates width"]) -> Float[torch.Tensor, "coordinates width"]:
        """Codebook-enhanced features of (distinct) coordinates."""
        enhanced: torch.Tensor = self.to_prototypes(features, self.prototypes())
        return enhanced
