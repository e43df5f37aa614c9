"""EDSR-baseline with convolutions over time: the encoder that LIIF, Meta-SR, A-LIIF and LMF share."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

KERNEL = 3


class EdsrEncoder(nn.Module):
    """One feature vector a frame: head, `blocks` residual blocks, tail, and the head's output added (EDSR, Lim 2017).

    As in EDSR-baseline there is no normalisation and no scaling of residuals. Ends are padded by replication, since a
    pose of zeros is no pose; images are padded with zeros.
    """

    def __init__(self, numbers: int, features: int, blocks: int) -> None:
        super().__init__()
        self.head = _convolution(numbers, features)
        self.blocks = nn.ModuleList(ResidualBlock(features) for _ in range(blocks))
        self.tail = _convolution(features, features)

    def forward(self, frames: Float[Tensor, "batch frames numbers"]) -> Float[Tensor, "batch frames features"]:
        """Features at the observed frames."""
        head = hidden = self.head(frames.transpose(1, 2))
        for block in self.blocks:
            hidden = block(hidden)
        features: Tensor = self.tail(hidden) + head
        return features.transpose(1, 2)


class ResidualBlock(nn.Module):
    """Convolution, ReLU, convolution, and the input added."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.first, self.second = _convolution(features, features), _convolution(features, features)

    def forward(self, hidden: Float[Tensor, "batch features frames"]) -> Float[Tensor, "batch features frames"]:
        """The block's output, channels before frames."""
        changed: Tensor = self.second(torch.relu(self.first(hidden)))
        return hidden + changed


def unfolded(features: Float[Tensor, "batch frames features"]) -> Float[Tensor, "batch frames three_features"]:
    """Each frame's features beside those of both neighbours (LIIF §3, feature unfolding), the ends replicated."""
    before = torch.cat((features[:, :1], features[:, :-1]), dim=1)
    after = torch.cat((features[:, 1:], features[:, -1:]), dim=1)
    return torch.cat((before, features, after), dim=-1)


def _convolution(inputs: int, outputs: int) -> nn.Conv1d:
    return nn.Conv1d(inputs, outputs, KERNEL, padding=KERNEL // 2, padding_mode="replicate")
