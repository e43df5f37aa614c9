"""What the native-rate evaluator sees of a clip: per-frame numbers whose meaning no framerate changes.

Positions relative to root and heading, velocities, accelerations, joint acceleration on a log scale, foot speed and
slip on a log scale; every derivative is per second. Networks that see positions and velocities alone are blind to foot
sliding, and those without accelerations to small jitter (measured on CMU takes at 40, 60 and 120 fps).
"""

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from motionkit.skeleton import SMPL22

NUM_JOINTS = 22
NUM_CHANNELS = 63 + 1 + 66 + 66 + 22 + 4 + 4 + 2
MIN_POSES = 8

SLIP_HALF_SECONDS = 0.05
# Floors under the logarithms: below them lies measurement noise.
ACCELERATION_FLOOR = 0.1
SPEED_FLOOR = 0.005
# Accelerations above this grow logarithmically: a glitch must not swamp the standardisation.
ACCELERATION_SCALE = 4.0

assert SMPL22.feet is not None
FEET = (SMPL22.feet.left_ankle, SMPL22.feet.left_toe, SMPL22.feet.right_ankle, SMPL22.feet.right_toe)


def centre(clips: Float64[np.ndarray, "clips poses 22 3"]) -> Float64[np.ndarray, "clips poses 22 3"]:
    """Clips moved so that the first root lies above the origin: single precision is then enough for accelerations."""
    origin = clips[:, :1, :1] * np.array([1.0, 0.0, 1.0])
    centred: Float64[np.ndarray, "clips poses 22 3"] = clips - origin
    return centred


def rich_input(positions: Float[Tensor, "clips poses 22 3"], fps: float) -> Float[Tensor, "clips poses channels"]:
    """228 numbers per pose, unchanged when the whole clip is moved or turned about the vertical axis.

    Velocity is the forward difference and acceleration the second one; both repeat at the clip's ends.
    """
    velocity = _repeat_ends((positions[:, 1:] - positions[:, :-1]) * fps, positions.shape[1])
    acceleration = _repeat_ends(
        (positions[:, 2:] - 2 * positions[:, 1:-1] + positions[:, :-2]) * (fps * fps), positions.shape[1]
    )
    sideways = _sideways(positions)
    feet = positions[:, :, FEET, ::2]
    slip = _slip(feet, fps)
    ground = positions[:, :, FEET, 1].amin(dim=(1, 2))
    blocks = (
        _in_heading(positions[:, :, 1:] - positions[:, :, :1], sideways).flatten(2),
        (positions[:, :, 0, 1] - ground[:, None])[..., None],
        _in_heading(velocity, sideways).flatten(2),
        torch.asinh(_in_heading(acceleration, sideways).flatten(2) / ACCELERATION_SCALE),
        torch.log(acceleration.norm(dim=-1) + ACCELERATION_FLOOR),
        torch.log(velocity[:, :, FEET, ::2].norm(dim=-1) + SPEED_FLOOR),
        slip,
        # The steadiest joint of the steadier foot, and of the other: what stands should not move.
        torch.stack((slip[..., :2].amin(-1), slip[..., 2:].amin(-1)), -1).sort(dim=-1).values,
    )
    return torch.cat(blocks, dim=-1)


def _repeat_ends(values: Float[Tensor, "clips some 22 3"], num_poses: int) -> Float[Tensor, "clips poses 22 3"]:
    """As many rows as there are poses: one missing row repeats the last, two repeat the first and the last."""
    head = values[:, : (num_poses - values.shape[1]) // 2]
    return torch.cat((head, values, values[:, -1:]), dim=1)


def _sideways(positions: Float[Tensor, "clips poses 22 3"]) -> Float[Tensor, "clips poses 2"]:
    """Unit vector (x, z) from right to left across hips and shoulders; a body without width faces +Z."""
    across = positions[:, :, 1] - positions[:, :, 2] + positions[:, :, 16] - positions[:, :, 17]
    flat = across[..., ::2]
    length = flat.norm(dim=-1, keepdim=True)
    default = torch.zeros_like(flat)
    default[..., 0] = 1.0
    return torch.where(length > 1e-6, flat / length.clamp_min(1e-6), default)


def _in_heading(
    vectors: Float[Tensor, "clips poses joints 3"], sideways: Float[Tensor, "clips poses 2"]
) -> Float[Tensor, "clips poses joints 3"]:
    """Vectors with +x to the body's left and +z ahead."""
    left_x, left_z = sideways[..., None, 0], sideways[..., None, 1]
    x, y, z = vectors.unbind(-1)
    return torch.stack((x * left_x + z * left_z, y, z * left_x - x * left_z), dim=-1)


def _slip(feet: Float[Tensor, "clips poses 4 2"], fps: float) -> Float[Tensor, "clips poses 4"]:
    """Log horizontal displacement over about 0.1 s around every pose, per second; shorter at the clip's ends."""
    num_poses = feet.shape[1]
    half = max(1, round(SLIP_HALF_SECONDS * fps))
    pose = torch.arange(num_poses, device=feet.device)
    before, after = (pose - half).clamp_min(0), (pose + half).clamp_max(num_poses - 1)
    seconds = (after - before).to(feet.dtype) / fps
    displacement = (feet[:, after] - feet[:, before]).norm(dim=-1)
    return torch.log(displacement / seconds[None, :, None] + SPEED_FLOOR)
