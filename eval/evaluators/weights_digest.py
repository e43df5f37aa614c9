"""The fingerprint of a network: what it is, and every number in it."""

import hashlib
from collections.abc import Mapping

import numpy as np
import torch


def weights_digest(terms: str, tensors: Mapping[str, torch.Tensor]) -> str:
    """First 16 hex digits of the sha256 over settings and weights, whatever order the weights come in."""
    digest = hashlib.sha256(terms.encode())
    for name in sorted(tensors):
        digest.update(name.encode() + np.ascontiguousarray(tensors[name].numpy(), dtype="<f4").tobytes())
    return digest.hexdigest()[:16]
