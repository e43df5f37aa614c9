"""The loss of all temporal networks, as squares and as absolute values."""

import pytest
import torch

from pahires.temporal.settings import Distance
from pahires.temporal.training import losses


@pytest.mark.parametrize(
    ("distance", "rows", "steps"), [("squared", [3.5, 4.0], [1.0, 0.0]), ("absolute", [1.5, 2.0], [1.0, 0.0])]
)
def test_losses_are_means_of_each_window(distance: Distance, rows: list[float], steps: list[float]) -> None:
    # Off by 0, 1, 2, 3, and always by −2.
    off = torch.stack((torch.arange(4.0), torch.full((4,), -2.0)))[..., None].expand(2, 4, 5)
    targets = torch.randn(2, 4, 5, generator=torch.Generator().manual_seed(0))
    found = losses(targets + off, targets, distance)
    torch.testing.assert_close(found[0], torch.tensor(rows))
    torch.testing.assert_close(found[1], torch.tensor(steps), atol=1e-6, rtol=1e-5)
