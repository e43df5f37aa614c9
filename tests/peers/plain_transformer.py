"""Transformer layers written out in numbers, for what the networks of peers are compared with."""

import torch
from torch import Tensor
from torch.nn import functional

Weights = dict[str, Tensor]


def part(weights: Weights, prefix: str) -> Weights:
    """The weights below a name."""
    return {name.removeprefix(prefix): tensor for name, tensor in weights.items() if name.startswith(prefix)}


def linear(weights: Weights, name: str, inputs: Tensor) -> Tensor:
    return inputs @ weights[f"{name}.weight"].T + weights[f"{name}.bias"]


def norm(weights: Weights, name: str, inputs: Tensor) -> Tensor:
    centred = inputs - inputs.mean(-1, keepdim=True)
    scaled = centred / torch.sqrt(centred.square().mean(-1, keepdim=True) + 1e-5)
    return scaled * weights[f"{name}.weight"] + weights[f"{name}.bias"]


def attention(weights: Weights, asking: Tensor, asked: Tensor, heads: int) -> Tensor:
    """Of tokens [tokens, width] of one motion."""
    width = asking.shape[-1]
    matrices, biases = weights["in_proj_weight"].split(width), weights["in_proj_bias"].split(width)
    q, k, v = (
        (tokens @ matrix.T + bias).view(len(tokens), heads, width // heads)
        for tokens, matrix, bias in zip((asking, asked, asked), matrices, biases, strict=True)
    )
    mixed = torch.empty_like(q)
    for head in range(heads):
        scores = q[:, head] @ k[:, head].T / (width // heads) ** 0.5
        mixed[:, head] = torch.exp(scores) / torch.exp(scores).sum(1, keepdim=True) @ v[:, head]
    return linear(weights, "out_proj", mixed.flatten(1))


def layer(weights: Weights, tokens: Tensor, heads: int, memory: Tensor | None = None) -> Tensor:
    """Post-norm: self-attention, attention to `memory` where there is one, feed-forward with the exact GELU."""
    tokens = norm(weights, "norm1", tokens + attention(part(weights, "self_attn."), tokens, tokens, heads))
    if memory is not None:
        asked = attention(part(weights, "multihead_attn."), tokens, memory, heads)
        tokens = norm(weights, "norm2", tokens + asked)
    hidden = functional.gelu(linear(weights, "linear1", tokens))
    return norm(weights, "norm2" if memory is None else "norm3", tokens + linear(weights, "linear2", hidden))


def long_skips(weights: Weights, tokens: Tensor, heads: int, count: int, memory: Tensor | None = None) -> Tensor:
    """Layers 0 … count − 1, of which i feeds count − 1 − i."""
    kept = []
    for number in range(count):
        if number > count // 2:
            joined = torch.cat((tokens, kept[count - 1 - number]), dim=-1)
            tokens = linear(weights, f"joins.{number - count // 2 - 1}", joined)
        tokens = layer(part(weights, f"layers.{number}."), tokens, heads, memory)
        kept.append(tokens)
    return norm(weights, "norm", tokens)
