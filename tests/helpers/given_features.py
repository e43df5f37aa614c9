"""A network for torchmetrics that takes features as they are instead of computing them from images."""

import torch


class GivenFeatures(torch.nn.Module):
    """Hands its input on."""

    def __init__(self, num_features: int) -> None:
        super().__init__()
        self.num_features = num_features

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        return features
