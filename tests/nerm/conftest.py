"""Tiny tensors are slower on several threads, and much slower on a busy machine."""

import pytest
import torch

from nerm.model import TrainedField
from tests.nerm.small_fields import BANKED, SMALL, finished, losses_of, small_training


@pytest.fixture(scope="session", autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="session", params=[SMALL, BANKED], ids=["one bank", "banks and path"])
def small_field(request: pytest.FixtureRequest) -> TrainedField:
    """A field of four motions, trained to millimetres."""
    training = small_training(request.param)
    losses_of(training, training.steps)
    return finished(training)
