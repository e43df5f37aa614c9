"""Codebook-coordinate attention, CCA (paper §3.1 and appendix D, after CoCo-NeRF).

M learnable queries attend to the frozen codebook, are refined by self-attention into motion-relevant prototypes, and
the coordinates' Fourier features attend to those. All of it depends on t and θ alone, never on a latent: it is computed
once per distinct coordinate and gathered.
"""

import torch
from jaxtyping import Float
from torch import nn


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
        """The tokens, enriched by the context."""
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
    """γ(t) → γ(t) + what it finds among the prototypes.

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
        """The queries after attending to the codebook and to one another."""
        tokens: torch.Tensor = self.to_codebook(self.query_embeddings, self.project_codes(self.codebook))
        for block in self.refine:
            tokens = block(tokens, tokens)
        return tokens

    def forward(self, features: Float[torch.Tensor, "coordinates width"]) -> Float[torch.Tensor, "coordinates width"]:
        """Codebook-enhanced features of (distinct) coordinates."""
        enhanced: torch.Tensor = self.to_prototypes(features, self.prototypes())
        return enhanced
