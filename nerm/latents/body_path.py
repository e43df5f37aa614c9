"""Poses relative to a smooth path of the body, and back.

A path is (x, z, heading) at each instant: where in the window's frame the body is and which way it faces. A pose
relative to it is what somebody who walks along would see, so that walking and turning cost the pose no numbers. Both
directions act on vectors with one scale for x and z of a joint and with mean zero there
(`nerm.pose_vectors.scaling`), in metres or not; positions of the path are in the same units.
"""

import numpy as np
import torch
from jaxtyping import Float, Float32, Float64

from motionkit.features import field as field_vectors

NUM_PATH_NUMBERS = 3


def turned(
    vectors: Float[torch.Tensor, "*poses numbers"], yaw: Float[torch.Tensor, "*poses"]
) -> Float[torch.Tensor, "*poses numbers"]:
    """`field` vectors turned about the vertical by radians (positive from Z+ towards X+), root position included."""
    cosine, sine = torch.cos(yaw)[..., None], torch.sin(yaw)[..., None]
    x, y, z = vectors.reshape(*vectors.shape[:-1], vectors.shape[-1] // 3, 3).unbind(-1)
    return torch.stack((cosine * x + sine * z, y, cosine * z - sine * x), dim=-1).flatten(-2)


def placed(
    relative: Float[torch.Tensor, "*poses numbers"], path: Float[torch.Tensor, "*poses 3"]
) -> Float[torch.Tensor, "*poses numbers"]:
    """Poses relative to a path → `field` vectors in the window's frame."""
    return _moved(turned(relative, path[..., 2]), path, 1.0)


def relative_to(
    vectors: Float[torch.Tensor, "*poses numbers"], path: Float[torch.Tensor, "*poses 3"]
) -> Float[torch.Tensor, "*poses numbers"]:
    """`field` vectors in the window's frame → poses relative to a path; the inverse of `placed`."""
    return turned(_moved(vectors, path, -1.0), -path[..., 2])


def path_speed(
    slope: Float[torch.Tensor, "*poses 3"], path: Float[torch.Tensor, "*poses 3"]
) -> Float[torch.Tensor, "*poses 3"]:
    """The path's derivative as the body feels it: sideways, forward, turning."""
    cosine, sine = torch.cos(path[..., 2]), torch.sin(path[..., 2])
    x, z, turning = slope.unbind(-1)
    return torch.stack((cosine * x - sine * z, sine * x + cosine * z, turning), dim=-1)


def measured_heading(
    vectors: Float32[torch.Tensor, "windows times numbers"],
) -> Float64[torch.Tensor, "windows times"]:
    """The heading (radians) of `field` vectors in metres and in order of time, without jumps of 2π."""
    heading = field_vectors.heading(field_vectors.decode(vectors.numpy())).astype(np.float64)
    return torch.from_numpy(np.unwrap(heading, axis=1))


def _moved(
    vectors: Float[torch.Tensor, "*poses numbers"], path: Float[torch.Tensor, "*poses 3"], sign: float
) -> Float[torch.Tensor, "*poses numbers"]:
    x, height, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    root = torch.stack((x + sign * path[..., 0], height, z + sign * path[..., 1]), dim=-1)
    return torch.cat((root, vectors[..., 3:]), dim=-1)
