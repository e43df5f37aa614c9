"""The native-rate evaluator's network: Guo et al.'s movement and motion encoders, smaller, for clips.

Two convolutions of kernel 4 and stride 2, a bidirectional GRU, one embedding; on it linear heads that regress the
strength of every kind of damage, and a projection into a space shared with sentences. Architecture after text-to-motion
(networks/modules.py), on inputs per second.
"""

import math

import numpy as np
import torch
from torch import Tensor, nn

from eval.native_evaluator.settings import NativeNetworkConfig
from motionkit.core.shapes import Float, Float32, Float64
from motionkit.core.skeleton import SMPL22

NUM_JOINTS = 22
NUM_CHANNELS = 63 + 1 + 66 + 66 + 22 + 4 + 4 + 2 + 1
MIN_POSES = 8
CUTOFF_HZ = 25.0
"""The smoothing's half-amplitude frequency; at framerates below twice as much it has little effect."""
MOST_DEVIATIONS = 5.0
REFERENCE_FPS = 60.0

SLIP_HALF_SECONDS = 0.05
# Floors of the logarithms, at the level of measurement noise.
ACCELERATION_FLOOR = 0.1
SPEED_FLOOR = 0.005
# Accelerations above this are compressed logarithmically, so that a glitch does not dominate the standardisation.
ACCELERATION_SCALE = 4.0

assert SMPL22.feet is not None
FEET = (SMPL22.feet.left_ankle, SMPL22.feet.left_toe, SMPL22.feet.right_ankle, SMPL22.feet.right_toe)


def prepare(clips: Float[np.ndarray, "clips poses 22 3"], fps: float) -> Float32[np.ndarray, "clips poses 22 3"]:
    """Clips as `rich_input` expects them: smoothed, and translated so that the first root is above the origin.

    Near the origin single precision suffices for accelerations.
    """
    exact = clips.astype(np.float64)
    return smooth(exact - exact[:, :1, :1] * np.array([1.0, 0.0, 1.0]), fps).astype(np.float32)


def smooth(clips: Float64[np.ndarray, "clips poses 22 3"], fps: float) -> Float64[np.ndarray, "clips poses 22 3"]:
    """Smoothing splines of the poses, half amplitude at 25 Hz.

    They minimise Σ‖x − y‖² + λ·Σ‖second difference of x‖², λ = (fps / (2π·25 Hz))⁴ (Whittaker 1923; Eilers 2003, "A
    perfect smoother"): zero phase, gain 1 / (1 + λ·(2 sin(πf/fps))⁴), which is 1 / (1 + (f / 25 Hz)⁴) far below the
    framerate. A clip's ends need no padding, and constant velocity is unchanged.
    """
    from scipy.linalg import solveh_banded

    num_poses = clips.shape[1]
    weight = (fps / (2 * math.pi * CUTOFF_HZ)) ** 4
    # The upper bands of 1 + λ·DᵀD, D the second difference of at least 4 poses.
    bands = np.empty((3, num_poses))
    bands[0], bands[1], bands[2] = weight, -4 * weight, 1 + 6 * weight
    bands[1, [1, -1]] = -2 * weight
    bands[2, [0, -1]], bands[2, [1, -2]] = 1 + weight, 1 + 5 * weight
    flat = np.moveaxis(clips, 1, 0).reshape(num_poses, -1)
    curves = solveh_banded(bands, flat).reshape(num_poses, len(clips), *clips.shape[2:])
    return np.ascontiguousarray(np.moveaxis(curves, 0, 1))


def rich_input(positions: Float[Tensor, "clips poses 22 3"], fps: float) -> Float[Tensor, "clips poses channels"]:
    """229 numbers per pose of prepared clips, invariant to translation and to rotation about the vertical axis.

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
        # The slowest joint of the slower foot, and of the other: a foot that stands should not move.
        torch.stack((slip[..., :2].amin(-1), slip[..., 2:].amin(-1)), -1).sort(dim=-1).values,
        torch.full_like(positions[:, :, :1, 0], math.log(fps / REFERENCE_FPS)),
    )
    return torch.cat(blocks, dim=-1)


def standardised(
    raw: Float[Tensor, "clips poses channels"], mean: Float[Tensor, "channels"], scale: Float[Tensor, "channels"]
) -> Float[Tensor, "clips poses channels"]:
    """Standardised inputs, clipped to 5 standard deviations.

    A few frames of a capture are glitches of hundreds of deviations; unclipped, they would dominate the distribution of
    embeddings and every Fréchet distance.
    """
    return ((raw - mean) * scale).clamp(-MOST_DEVIATIONS, MOST_DEVIATIONS)


def _repeat_ends(values: Float[Tensor, "clips some 22 3"], num_poses: int) -> Float[Tensor, "clips poses 22 3"]:
    """Pad to the number of poses: one missing row repeats the last, two repeat the first and the last."""
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


TARGETS = ("upsampling", "foot-sliding", "jitter", "low-pass")
"""Targets of the heads: log strengths of damage."""


class NativeNetwork(nn.Module):
    """Clips' standardised rich inputs [B, m, 229] → embeddings [B, D]."""

    def __init__(self, config: NativeNetworkConfig) -> None:
        super().__init__()
        self.convolutions = nn.Sequential(
            nn.Conv1d(NUM_CHANNELS, config.convolution, kernel_size=4, stride=2, padding=1),
            nn.LeakyReLU(0.2),
            nn.Conv1d(config.convolution, config.convolution, kernel_size=4, stride=2, padding=1),
            nn.LeakyReLU(0.2),
        )
        self.recurrent = nn.GRU(config.convolution, config.recurrent, batch_first=True, bidirectional=True)
        self.embedding = nn.Linear(2 * config.recurrent + config.convolution, config.embedding)
        self.strengths = nn.Linear(config.embedding, len(TARGETS))
        self.shared = nn.Linear(config.embedding, config.shared)

    def forward(self, inputs: Float[Tensor, "clips poses channels"]) -> Float[Tensor, "clips features"]:
        """One embedding per clip; all clips of a batch have the same number of poses, at least 8."""
        movements = self.convolutions(inputs.transpose(1, 2)).transpose(1, 2)
        _, last = self.recurrent(movements)
        # The mean over time besides the last states: strengths are averages, and a GRU forgets a long clip's beginning.
        summary = torch.cat((last[0], last[1], movements.mean(dim=1)), dim=-1)
        embeddings: Tensor = self.embedding(summary)
        return embeddings


class TextProjection(nn.Module):
    """Sentence embeddings → the space shared with motions."""

    def __init__(self, text_dimension: int, config: NativeNetworkConfig) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(text_dimension, config.text_hidden),
            nn.LeakyReLU(0.2),
            nn.Linear(config.text_hidden, config.shared),
        )

    def forward(self, sentences: Float[Tensor, "texts text"]) -> Float[Tensor, "texts shared"]:
        """One row per sentence."""
        projected: Tensor = self.layers(sentences)
        return projected
