"""The latent denoiser ε_φ: a transformer with long skip connections over [z, time, conditions] tokens (NeRM §3.2, D).

The layout of the skips is U-ViT's (Bao et al. 2023): layer i of the first half feeds layer n − 1 − i, which joins both
by concatenation and a linear map.
"""

import math

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn
from torch.nn import functional

from nerm.conditions import ConditionEmbedding, ConditionLayout, Conditions
from nerm.denoiser_config import TransformerConfig


class TransformerLayer(nn.Module):
    """Pre-norm self-attention and feed-forward network (GELU)."""

    def __init__(self, config: TransformerConfig) -> None:
        super().__init__()
        self.num_heads = config.num_heads
        self.attention_norm = nn.LayerNorm(config.width)
        self.queries_keys_values = nn.Linear(config.width, 3 * config.width)
        self.attention_out = nn.Linear(config.width, config.width)
        self.ffn_norm = nn.LayerNorm(config.width)
        self.ffn_in = nn.Linear(config.width, config.ffn_width)
        self.ffn_out = nn.Linear(config.ffn_width, config.width)
        self.dropout = nn.Dropout(config.dropout)

    def forward(self, tokens: Float[Tensor, "batch tokens width"]) -> Float[Tensor, "batch tokens width"]:
        """One layer over all tokens."""
        return self._feed_forward(self._attend(tokens))

    def _attend(self, tokens: Tensor) -> Tensor:
        batch, count, width = tokens.shape
        projected = self.queries_keys_values(self.attention_norm(tokens))
        heads = projected.view(batch, count, 3, self.num_heads, width // self.num_heads).permute(2, 0, 3, 1, 4)
        mixed = functional.scaled_dot_product_attention(heads[0], heads[1], heads[2])
        out: Tensor = self.dropout(self.attention_out(mixed.transpose(1, 2).reshape(batch, count, width)))
        return tokens + out

    def _feed_forward(self, tokens: Tensor) -> Tensor:
        hidden = self.dropout(functional.gelu(self.ffn_in(self.ffn_norm(tokens))))
        out: Tensor = self.dropout(self.ffn_out(hidden))
        return tokens + out


def step_features(steps: Int64[Tensor, "batch"], width: int) -> Float[Tensor, "batch width"]:
    """Sinusoidal features of the diffusion step k, wavelengths from 2π to 20,000π (Vaswani et al. 2017)."""
    frequencies = torch.exp(-math.log(10_000.0) * torch.arange(width // 2, device=steps.device) / (width // 2))
    angles = steps[:, None].to(torch.float32) * frequencies
    return torch.cat((angles.cos(), angles.sin()), dim=1)


class Denoiser(nn.Module):
    """ε_φ(z_k, k, c): the noise in z_k, from [z…, k, text, action, duration] tokens."""

    def __init__(self, config: TransformerConfig, latent_dimension: int, layout: ConditionLayout) -> None:
        super().__init__()
        if latent_dimension % config.latent_tokens:
            raise ValueError(f"a latent of {latent_dimension} numbers cannot be cut into {config.latent_tokens} tokens")
        self.config = config
        per_token = latent_dimension // config.latent_tokens
        half = config.num_layers // 2
        self.latent_in = nn.Linear(per_token, config.width)
        self.step_in = nn.Sequential(
            nn.Linear(config.width, config.width), nn.SiLU(), nn.Linear(config.width, config.width)
        )
        self.conditions_in = ConditionEmbedding(layout, config.width)
        num_tokens = config.latent_tokens + 1 + ConditionEmbedding.num_tokens
        self.positions = nn.Parameter(torch.randn(num_tokens, config.width) * 0.02)
        self.layers = nn.ModuleList(TransformerLayer(config) for _ in range(config.num_layers))
        self.skips = nn.ModuleList(nn.Linear(2 * config.width, config.width) for _ in range(half))
        self.out_norm = nn.LayerNorm(config.width)
        self.noise_out = nn.Linear(config.width, per_token)

    def forward(
        self, latents: Float[Tensor, "batch latent"], steps: Int64[Tensor, "batch"], conditions: Conditions
    ) -> Float[Tensor, "batch latent"]:
        """The predicted noise of z_k."""
        batch = len(latents)
        z = self.latent_in(latents.view(batch, self.config.latent_tokens, -1))
        time = self.step_in(step_features(steps, self.config.width))[:, None]
        tokens = torch.cat((z, time, self.conditions_in(conditions)), dim=1) + self.positions
        tokens = self._transform(tokens)[:, : self.config.latent_tokens]
        noise: Tensor = self.noise_out(self.out_norm(tokens))
        return noise.reshape(batch, -1)

    def _transform(self, tokens: Tensor) -> Tensor:
        half = self.config.num_layers // 2
        kept: list[Tensor] = []
        for layer in self.layers[:half]:
            tokens = layer(tokens)
            kept.append(tokens)
        tokens = self.layers[half](tokens)
        for layer, skip in zip(self.layers[half + 1 :], self.skips, strict=True):
            tokens = layer(skip(torch.cat((tokens, kept.pop()), dim=-1)))
        return tokens
