"""Which device to train on."""

import torch

from motionkit.errors import UsageError


def resolve_device(name: str) -> torch.device:
    """The device a user named; "auto" is the first CUDA device, else the CPU.

    Raises `UsageError` for a name torch doesn't know or a device that isn't there.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise UsageError(f"--device {name}: {str(error).splitlines()[0]}") from None
    return device
