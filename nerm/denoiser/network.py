"""The latent denoiser ε_φ: a transformer with long skip connections over [z, time, conditions] tokens (NeRM §3.2, D).

Skips as in U-ViT (Bao et al. 2023): layer i of the first half feeds layer n − 1 − i, which joins both by concatenation
and a linear map.
"""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from motionkit.core.shapes import Bool, Float, Float32, Int64, Shaped
from nerm.conditions import ConditionEmbedding, ConditionLayout, Conditions
from nerm.latents.posterior import in_use
from nerm.settings import TransformerConfig


def attention(
    queries: Float[Tensor, "batch heads asking size"],
    keys: Float[Tensor, "batch heads asked size"],
    values: Float[Tensor, "batch heads asked size"],
    seen: Bool[Tensor, "batch 1 1 asked"] | None,
) -> Float[Tensor, "batch heads asking size"]:
    """softmax(QKᵀ/√size) V over the tokens of the mask `seen`."""
    if queries.device.type == "cpu" and queries.dtype == torch.bfloat16:
        # torch's own kernel takes as long as all matrix products of a step together.
        scores = queries @ keys.transpose(-1, -2) * queries.shape[-1] ** -0.5
        if seen is not None:
            scores = scores.masked_fill(~seen, -torch.inf)
        mixed: Tensor = torch.softmax(scores, dim=-1) @ values
        return mixed
    return functional.scaled_dot_product_attention(queries, keys, values, attn_mask=seen)


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

    def forward(
        self, tokens: Float[Tensor, "batch tokens width"], seen: Bool[Tensor, "batch 1 1 tokens"] | None
    ) -> Float[Tensor, "batch tokens width"]:
        """One layer over all tokens; those not `seen` are masked out of the attention."""
        return self._feed_forward(self._attend(tokens, seen))

    def _attend(self, tokens: Tensor, seen: Tensor | None) -> Tensor:
        batch, count, width = tokens.shape
        projected = self.queries_keys_values(self.attention_norm(tokens))
        heads = projected.view(batch, count, 3, self.num_heads, width // self.num_heads).permute(2, 0, 3, 1, 4)
        mixed = attention(heads[0], heads[1], heads[2], seen)
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
    """ε_φ(z_k, k, c): a transformer over [z…, k, text, action, duration] tokens.

    Numbers of z that a motion of the given duration does not use are zero in input and output, and tokens of only such
    numbers are masked out of the attention.
    """

    def __init__(
        self, config: TransformerConfig, first_read: Float32[Tensor, "latent"], layout: ConditionLayout
    ) -> None:
        """`first_read` is the earliest instant at which the field reads each number of z (`nerm.latents.posterior`)."""
        super().__init__()
        if len(first_read) % config.latent_tokens:
            raise ValueError(f"a latent of {len(first_read)} numbers cannot be cut into {config.latent_tokens} tokens")
        self.config = config
        self.register_buffer("first_read", first_read)
        self.first_read: Tensor
        self.always_whole = bool((first_read < 0).all())
        per_token = len(first_read) // config.latent_tokens
        half = config.num_layers // 2
        self.latent_in = nn.Linear(per_token, config.width)
        self.step_in = nn.Sequential(
            nn.Linear(config.width, config.width), nn.SiLU(), nn.Linear(config.width, config.width)
        )
        self.conditions_in = ConditionEmbedding(layout, config.width)
        self.positions = nn.Parameter(
            torch.randn(config.latent_tokens + 1 + ConditionEmbedding.num_tokens, config.width) * 0.02
        )
        self.layers = nn.ModuleList(TransformerLayer(config) for _ in range(config.num_layers))
        self.skips = nn.ModuleList(nn.Linear(2 * config.width, config.width) for _ in range(half))
        self.out_norm = nn.LayerNorm(config.width)
        self.noise_out = nn.Linear(config.width, per_token)

    def forward(
        self, latents: Float[Tensor, "batch latent"], steps: Int64[Tensor, "batch"], conditions: Conditions
    ) -> Float[Tensor, "batch latent"]:
        """The prediction that `DiffusionConfig.prediction` names."""
        used = in_use(self.first_read, conditions.duration)
        z = self.latent_in(self._tokens(latents * used))
        time = self.step_in(step_features(steps, self.config.width))[:, None]
        tokens = torch.cat((z, time, self.conditions_in(conditions)), dim=1) + self.positions
        tokens = self._transform(tokens, self._seen(used))[:, : self.config.latent_tokens]
        out: Tensor = self.noise_out(self.out_norm(tokens))
        return out.flatten(1) * used

    def _tokens(self, numbers: Shaped[Tensor, "batch latent"]) -> Shaped[Tensor, "batch tokens per_token"]:
        return numbers.view(len(numbers), self.config.latent_tokens, -1)

    def _seen(self, used: Bool[Tensor, "batch latent"]) -> Bool[Tensor, "batch 1 1 tokens"] | None:
        """The attention mask over tokens; None if all are used."""
        if self.always_whole:
            return None
        of_latent = self._tokens(used).any(dim=2)
        return functional.pad(of_latent, (0, len(self.positions) - of_latent.shape[1]), value=True)[:, None, None]

    def _transform(self, tokens: Tensor, seen: Tensor | None) -> Tensor:
        half = self.config.num_layers // 2
        kept: list[Tensor] = []
        for layer in self.layers[:half]:
            tokens = layer(tokens, seen)
            kept.append(tokens)
        tokens = self.layers[half](tokens, seen)
        for layer, skip in zip(self.layers[half + 1 :], self.skips, strict=True):
            tokens = layer(skip(torch.cat((tokens, kept.pop()), dim=-1)), seen)
        return tokens
