"""Joint positions as a differentiable function of pose vectors, for conventions that allow it."""

import torch
from torch import Tensor

from motionkit.core.shapes import Float
from motionkit.data.pose_vectors.convention import PoseVectors
from motionkit.data.pose_vectors.native import NativeVectors
from motionkit.data.pose_vectors.rotations import RotationVectors


def has_joints(vectors: PoseVectors) -> bool:
    """Whether a pose's joints follow from its own vector alone, without integrating a path."""
    return not isinstance(vectors, NativeVectors)


def joints_of(numbers: Float[Tensor, "poses numbers"], vectors: PoseVectors) -> Float[Tensor, "poses joints 3"]:
    """Joint positions in the window's frame, metres, of vectors in their own units."""
    if not isinstance(vectors, RotationVectors):
        joints = numbers.reshape(len(numbers), -1, 3)
        return torch.cat((joints[:, :1], joints[:, 1:] + joints[:, :1]), dim=1)
    pairs = numbers[:, 3:].reshape(len(numbers), -1, 2, 3)
    first = torch.nn.functional.normalize(pairs[..., 0, :], dim=-1)
    second = pairs[..., 1, :]
    second = torch.nn.functional.normalize(second - (first * second).sum(-1, keepdim=True) * first, dim=-1)
    local = torch.stack((first, second, torch.linalg.cross(first, second)), dim=-1)
    offsets = torch.as_tensor(vectors.skeleton.offsets, device=numbers.device)
    turns, places = [local[:, 0]], [numbers[:, :3] + offsets[0]]
    for joint, parent in enumerate(vectors.skeleton.parents):
        if parent >= 0:
            turns.append(turns[parent] @ local[:, joint])
            places.append(places[parent] + turns[parent] @ offsets[joint])
    return torch.stack(places, dim=1)
