"""NeMF (He et al. 2022; c-he/NeMF, src/nemf): a neural field over time with two latents, and a root path predictor."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import roma
import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool1d, binary_cross_entropy_with_logits, l1_loss, pad

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float
from motionkit.training.config import Schedule
from motionkit.training.networks import kl_divergence, reparameterized
from peers.generating import UNCONDITIONAL, PeerConfig, PeerStage, cosine
from peers.layers import NetworkInputs, PeerNetwork
from peers.motions import Lengths, MotionBatch, MotionsConfig, PoseSpace, Rows, SampleBatch, frames_within

PATH = "nemf-path"
ROOT, CONTACTS = 3, 4  # numbers: velocity in x and z, height; feet
ORIENTATION = 6  # numbers: two columns of a rotation matrix


@dataclass(frozen=True)
class NemfPathNetworkConfig:
    """NeMF's predictor of the root's motion: widths and kernel size of its convolutions."""

    widths: tuple[int, ...] = (512, 512, 512, 512, 256, 128)
    kernel: int = 15
    contact_weight: float = 0.5


@dataclass(frozen=True)
class NemfNetworkConfig:
    """NeMF: a field over `frames` frames with two latents, and their encoders; `frequencies` encode time.

    KL's weight is annealed in `kl_cycles` cycles: it grows from a hundredth in the first half of each.
    """

    frames: int = 128
    widths: tuple[int, ...] = (128, 256, 512, 512)
    kernel: int = 4
    local_latent: int = 1024
    turn_latent: int = 256
    frequencies: int = 7
    width: int = 1024
    local_layers: int = 8
    turn_layers: int = 3
    joint_weight: float = 10.0
    kl_weight: float = 1e-5
    kl_cycles: int = 20

    def __post_init__(self) -> None:
        if self.frames % 2 ** len(self.widths):
            raise ValueError(f"frames must be a multiple of {2 ** len(self.widths)}, not {self.frames}")


class Residual(nn.Module):
    """A weighted sum of a convolution and a 1×1 convolution of the input; even kernels halve the frames."""

    def __init__(self, inputs: int, outputs: int, kernel: int, share: float, activation: nn.Module) -> None:
        super().__init__()
        self.stride, self.share, self.activation = 2 - kernel % 2, share, activation
        self.changed = nn.Conv1d(inputs, outputs, kernel, self.stride, (kernel - 1) // 2)
        self.kept = nn.Conv1d(inputs, outputs, 1)

    def forward(self, values: Float[Tensor, "batch inputs frames"]) -> Float[Tensor, "batch outputs frames_out"]:
        """The next layer's values."""
        changed = self.activation(self.changed(values))
        kept: Tensor = self.kept(avg_pool1d(values, self.stride) if self.stride > 1 else values)
        outputs: Tensor = self.share * changed + (1 - self.share) * kept
        return outputs


def residuals(widths: tuple[int, ...], kernel: int, activation: Callable[[], nn.Module]) -> list[Residual]:
    """Layers of which the k-th, from 1, weights its convolution by 1 / (k + 1)."""
    return [
        Residual(inputs, outputs, kernel, 1 / (number + 1), activation())
        for number, (inputs, outputs) in enumerate(pairwise(widths), start=1)
    ]


def with_velocities(rows: Rows, lengths: Lengths, space: PoseSpace) -> Float[Tensor, "batch frames inputs"]:
    """Joint positions and rotations, and their changes per quarter second (of similar scale), 0 at a motion's end."""
    poses = rows[..., space.layout.joint_positions.start : space.layout.joint_rotations.stop]
    changes = pad(poses.diff(dim=1), (0, 0, 0, 1)) * frames_within(lengths - 1, poses.shape[1])[..., None]
    return torch.cat((poses, 0.25 * float(space.fps) * changes), dim=-1)


class NemfPath(PeerNetwork):
    """NeMF's global motion predictor: root velocity, height and contacts from the motion relative to the root."""

    def __init__(self, config: NemfPathNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        self.config, self.space, layout = config, inputs.space, inputs.space.layout
        poses = layout.joint_rotations.stop - layout.joint_positions.start
        layers = residuals((2 * poses + 1, *config.widths, ROOT + CONTACTS), config.kernel, nn.PReLU)
        layers[-1].activation = nn.Identity()
        self.layers = nn.Sequential(*layers)

    def forward(
        self, rows: Rows, lengths: Lengths
    ) -> tuple[Float[Tensor, "batch frames 3"], Float[Tensor, "batch frames 4"]]:
        """Velocity in x and z and height, in their own units, and contact logits, from standardised rows.

        Only yaw velocity, joints and rotations of a row are used.
        """
        inputs = with_velocities(rows, lengths, self.space)
        inputs = torch.cat((inputs, rows[..., self.space.layout.root_yaw_velocity]), dim=-1)
        mask = frames_within(lengths, rows.shape[1])[:, None]
        values = inputs.transpose(1, 2) * mask
        for layer in self.layers:
            values = layer(values) * mask
        root, contacts = torch.split(values.transpose(1, 2), [ROOT, CONTACTS], dim=-1)
        return root, contacts

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """L1 of velocity, height and the integrated path, and cross-entropy of contacts, over valid frames."""
        space, layout, mask = self.space, self.space.layout, batch.mask
        numbers = space.scaling.invert(batch.rows)
        root, contacts = self(batch.rows, batch.lengths)
        angle = space.heading(numbers)
        truth = torch.cat((numbers[..., layout.root_velocity], numbers[..., layout.root_height]), dim=-1)
        velocity, height = l1_loss(root[mask][:, :2], truth[mask][:, :2]), l1_loss(root[mask][:, 2], truth[mask][:, 2])
        path = l1_loss(space.path(root[..., :2], angle)[mask], space.path(truth[..., :2], angle)[mask])
        true_contacts = numbers[..., layout.contacts][mask].clamp(0, 1)
        touch = binary_cross_entropy_with_logits(contacts[mask], true_contacts)
        loss = velocity + height + path + self.config.contact_weight * touch
        return {"loss": loss, "velocity": velocity, "height": height, "path": path, "contacts": touch}


class ClipEncoder(nn.Module):
    """A clip → N(μ, σ²) of one latent: four convolutions, each halving the frames."""

    def __init__(self, inputs: int, widths: tuple[int, ...], kernel: int, frames: int, latent: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(*residuals((inputs, *widths), kernel, nn.Tanh))
        flat = widths[-1] * (frames >> len(widths))
        self.mean, self.log_variance = nn.Linear(flat, latent), nn.Linear(flat, latent)

    def forward(self, clips: Float[Tensor, "batch frames inputs"]) -> tuple[Tensor, Tensor]:
        """μ and log σ²."""
        flat = self.layers(clips.transpose(1, 2)).flatten(1)
        return self.mean(flat), self.log_variance(flat)


class Nemf(PeerNetwork):
    """Poses at any time from a local latent; the root's orientation from a second latent as well."""

    def __init__(self, config: NemfNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        path = inputs.earlier[PATH]
        assert isinstance(path, NemfPath)
        self.path = (path,)  # in a tuple: frozen, and saved with its own stage
        self.config, self.space, layout = config, inputs.space, inputs.space.layout
        self.num_positions = layout.joint_positions.stop - layout.joint_positions.start
        poses = layout.joint_rotations.stop - layout.joint_positions.start
        local, turns = config.local_latent, config.turn_latent
        self.local_encoder = ClipEncoder(2 * poses, config.widths, config.kernel, config.frames, local)
        self.turn_encoder = ClipEncoder(ORIENTATION, config.widths, config.kernel, config.frames, turns)
        size = 2 * config.frequencies + local
        skipped = [0] + [config.width] * (config.local_layers - 1)
        self.local_layers = nn.ModuleList(_field_layer(own + size, config.width) for own in skipped)
        self.turn_layers = nn.ModuleList(
            _field_layer(config.width + size + turns, config.width) for _ in range(config.turn_layers)
        )
        self.pose_out, self.turn_out = nn.Linear(config.width, poses), nn.Linear(config.width, ORIENTATION)

    def forward(
        self, count: int, local: Float[Tensor, "batch local"], turns: Float[Tensor, "batch turns"]
    ) -> tuple[Float[Tensor, "batch frames positions"], Float[Tensor, "batch frames rotations"], Tensor]:
        """Standardised joints, 6D joint rotations, and the 6D orientation of the root."""
        times = 2 * torch.arange(count, device=local.device) / self.config.frames - 1
        angles = times[:, None] * 2.0 ** torch.arange(self.config.frequencies, device=local.device)
        waves = torch.stack((angles.sin(), angles.cos()), dim=-1).flatten(1)
        inputs = torch.cat((waves.expand(len(local), -1, -1), local[:, None].expand(-1, count, -1)), dim=-1)
        hidden = inputs[..., :0]
        for layer in self.local_layers:
            hidden = layer(torch.cat((hidden, inputs), dim=-1))
        pose = self.pose_out(hidden)
        inputs = torch.cat((inputs, turns[:, None].expand(-1, count, -1)), dim=-1)
        for layer in self.turn_layers:
            hidden = layer(torch.cat((hidden, inputs), dim=-1))
        return pose[..., : self.num_positions], pose[..., self.num_positions :], self.turn_out(hidden)

    def encode(self, rows: Rows, lengths: Lengths) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
        """μ and log σ² of both latents; frames after a motion's end are zeros."""
        if rows.shape[1] > self.config.frames:
            raise UsageError(f"a motion of {rows.shape[1]} frames is longer than network.frames={self.config.frames}")
        rows = pad(rows, (0, 0, 0, self.config.frames - rows.shape[1]))
        mask = frames_within(lengths, rows.shape[1])[..., None]
        poses = with_velocities(rows, lengths, self.space)
        return self.local_encoder(poses), self.turn_encoder(_columns(self._orientation(rows)) * mask)

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Geodesic errors of orientations and rotations, weighted L1 of joints in metres, and KL of both latents.

        KL is annealed in cycles: its weight grows in the first half of each.
        """
        config, layout, mask, scaling = self.config, self.space.layout, batch.mask, self.space.scaling
        latents = self.encode(batch.rows, batch.lengths)
        drawn = (reparameterized(*each, batch.generator) for each in latents)
        positions, rotations, turns = self(batch.rows.shape[1], *drawn)
        scale = scaling.scale[layout.joint_positions]
        joints = l1_loss(positions[mask] * scale, batch.rows[..., layout.joint_positions][mask] * scale)
        true = scaling.invert(batch.rows)[..., layout.joint_rotations]
        bones = _angles(_matrices(rotations[mask]), _matrices(true[mask])).mean()
        root = _angles(_matrices(turns[mask])[:, 0], self._orientation(batch.rows)[mask]).mean()
        kl = torch.stack([kl_divergence(*each).sum(dim=1).mean() for each in latents]).sum()
        weight = config.kl_weight * min(1.0, 0.01 + 2 * (batch.progress * config.kl_cycles % 1))
        loss = root + bones + config.joint_weight * joints + weight * kl
        return {"loss": loss, "root": root, "bones": bones, "joints": joints, "kl": kl}

    def rows(self, local: Float[Tensor, "batch local"], turns: Float[Tensor, "batch turns"], lengths: Lengths) -> Rows:
        """Standardised rows from latents, with a predicted path; joint velocities are set to the mean."""
        layout, scaling, fps = self.space.layout, self.space.scaling, float(self.space.fps)
        count = int(lengths.max())
        # One extra frame, for the last frame's yaw velocity.
        positions, rotations, orientation = self(count + 1, local, turns)
        rows: Tensor = positions.new_zeros((len(positions), count, self.space.num_features))

        def put(block: slice, numbers: Tensor) -> None:
            rows[..., block] = (numbers - scaling.mean[block]) / scaling.scale[block]

        rows[..., layout.joint_positions] = positions[:, :-1]
        put(layout.joint_rotations, _columns(_matrices(rotations[:, :-1])).flatten(-2))
        matrix = _matrices(orientation)[:, :, 0]
        # Yaw between neighbouring frames; a frame's yaw velocity is the mean of the two beside it.
        turned = matrix[:, 1:] @ matrix[:, :-1].transpose(-1, -2)
        steps = torch.atan2(turned[..., 0, 2] - turned[..., 2, 0], turned[..., 0, 0] + turned[..., 2, 2])
        before = torch.cat((steps[:, :1], steps[:, :-1]), dim=1)
        put(layout.root_yaw_velocity, (before + steps)[..., None] * (0.5 * fps))
        root, contacts = self.path[0](rows, lengths)
        put(layout.root_velocity, root[..., :2])
        put(layout.root_height, root[..., 2:])
        put(layout.contacts, contacts.sigmoid())
        return rows

    def sample(self, batch: SampleBatch) -> Rows:
        """Standardised rows from latents ~ N(0, I); conditions are ignored."""
        sizes = [self.config.local_latent, self.config.turn_latent]
        local, turns = torch.split(batch.noise(sum(sizes)).float(), sizes, dim=1)
        return self.rows(local, turns, batch.lengths.to(batch.device))

    def _orientation(self, rows: Rows) -> Float[Tensor, "batch frames 3 3"]:
        """The root's orientation: yaw since the first frame, about Y."""
        angle = self.space.heading(self.space.scaling.invert(rows))
        matrices: Tensor = roma.rotvec_to_rotmat(pad(angle, (1, 1)))
        return matrices


def _field_layer(inputs: int, width: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, width), nn.LayerNorm(width), nn.ReLU())


def _matrices(columns: Float[Tensor, "*poses numbers"]) -> Float[Tensor, "*poses joints 3 3"]:
    """Rotation matrices from the 6D representation."""
    matrices: Tensor = roma.special_gramschmidt(
        columns.reshape(*columns.shape[:-1], -1, 2, 3).transpose(-1, -2).float()
    )
    return matrices


def _columns(matrices: Float[Tensor, "*some 3 3"]) -> Float[Tensor, "*some 6"]:
    """The 6D representation of rotation matrices."""
    return matrices[..., :2].transpose(-1, -2).flatten(-2)


def _angles(predicted: Float[Tensor, "*some 3 3"], true: Float[Tensor, "*some 3 3"]) -> Float[Tensor, "*some"]:
    """Radians between rotations."""
    cosine = ((predicted * true).sum(dim=(-1, -2)) - 1) / 2
    return cosine.clamp(-1 + 1e-6, 1 - 1e-6).acos()


CLIPS = MotionsConfig(fps=30.0, max_frames=128, min_seconds=128 / 30)
LONG = MotionsConfig(fps=30.0, max_frames=294)
PUBLISHED: dict[str, Any] = {
    "motions": CLIPS,
    "conditions": UNCONDITIONAL,
    "schedule": Schedule(epochs=1000, batch_size=16),
    "weight_decay": 1e-4,
}
NEMF_PATH = PeerStage(
    PATH,
    "NeMF, stage 1: the root's path from the body's motion",
    NemfPath,
    nano=PeerConfig(
        NemfPathNetworkConfig(widths=(64, 64, 64)), LONG, UNCONDITIONAL, cosine(2200, 16, 1e-3), precision="auto"
    ),
    paper=PeerConfig(NemfPathNetworkConfig(), **PUBLISHED),
    share=0.2,
)
NEMF = PeerStage(
    "nemf",
    "NeMF, stage 2: a neural field over time, and a VAE of its latents",
    Nemf,
    nano=PeerConfig(
        NemfNetworkConfig(304, (64, 96, 128, 128), local_latent=128, turn_latent=32, width=192, kl_cycles=4),
        LONG,
        UNCONDITIONAL,
        cosine(2400, 32, 1e-3),
        precision="auto",
    ),
    paper=PeerConfig(NemfNetworkConfig(), **PUBLISHED),
    builds_on=(NEMF_PATH,),
    share=0.8,
    conditional=False,
)
