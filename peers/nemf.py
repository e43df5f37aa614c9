"""NeMF (He et al. 2022; c-he/NeMF, src/nemf): a neural field over time with two latents, and a root path predictor."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

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

ROOT, CONTACTS = 3, 4  # numbers: velocity in x and z, height; feet
ORIENTATION = 6  # numbers: two columns of a rotation matrix
CONTACT_WEIGHT, JOINT_WEIGHT = 0.5, 10.0
Latents = Float[Tensor, "batch _"]
Gaussian = tuple[Latents, Latents]  # μ and log σ²


@dataclass(frozen=True)
class NemfPathNetworkConfig:
    """NeMF's predictor of the root's motion: widths and kernel size of its convolutions."""

    widths: tuple[int, ...] = (512, 512, 512, 512, 256, 128)
    kernel: int = 15


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
    kl_weight: float = 1e-5
    kl_cycles: int = 20


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
    """NeMF, stage 1: root velocity, height and contacts from the motion relative to the root."""

    def __init__(self, config: NemfPathNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        self.space, layout = inputs.space, inputs.space.layout
        poses = layout.joint_rotations.stop - layout.joint_positions.start
        layers = residuals((2 * poses + 1, *config.widths, ROOT + CONTACTS), config.kernel, nn.PReLU)
        layers[-1].activation = nn.Identity()
        self.layers = nn.Sequential(*layers)

    def forward(self, rows: Rows, lengths: Lengths) -> tuple[Tensor, Tensor]:
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
        loss = velocity + height + path + CONTACT_WEIGHT * touch
        return {"loss": loss, "velocity": velocity, "height": height, "path": path, "contacts": touch}


class ClipEncoder(nn.Module):
    """A clip → N(μ, σ²) of one latent: four convolutions, each halving the frames."""

    def __init__(self, inputs: int, widths: tuple[int, ...], kernel: int, frames: int, latent: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(*residuals((inputs, *widths), kernel, nn.Tanh))
        flat = widths[-1] * (frames >> len(widths))
        self.mean, self.log_variance = nn.Linear(flat, latent), nn.Linear(flat, latent)

    def forward(self, clips: Float[Tensor, "batch frames inputs"]) -> Gaussian:
        """μ and log σ²."""
        flat = self.layers(clips.transpose(1, 2)).flatten(1)
        return self.mean(flat), self.log_variance(flat)


class Nemf(PeerNetwork):
    """NeMF, stage 2: poses at any time from a local latent, the root's turns from a second one; no condition."""

    def __init__(self, config: NemfNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        path = inputs.earlier
        assert isinstance(path, NemfPath)
        self.path = (path,)  # in a tuple: frozen, and saved with its own stage
        self.config, self.space, layout = config, inputs.space, inputs.space.layout
        self.num_positions = layout.joint_positions.stop - layout.joint_positions.start
        poses = layout.joint_rotations.stop - layout.joint_positions.start
        local, turns = config.local_latent, config.turn_latent
        self.local_encoder = ClipEncoder(2 * poses, config.widths, config.kernel, config.frames, local)
        self.turn_encoder = ClipEncoder(ORIENTATION, config.widths, config.kernel, config.frames, turns)
        size = 2 * config.frequencies + local
        width = config.width

        def field_layers(*inputs: int) -> nn.ModuleList:
            each = (nn.Sequential(nn.Linear(size, width), nn.LayerNorm(width), nn.ReLU()) for size in inputs)
            return nn.ModuleList(each)

        self.local_layers = field_layers(size, *[width + size] * (config.local_layers - 1))
        self.turn_layers = field_layers(*[width + size + turns] * config.turn_layers)
        self.pose_out, self.turn_out = nn.Linear(width, poses), nn.Linear(width, ORIENTATION)

    def forward(self, count: int, local: Latents, turns: Latents) -> tuple[Tensor, Tensor, Tensor]:
        """Of so many frames: standardised joints, 6D joint rotations, and the 6D orientation of the root."""
        times = 2 * torch.arange(count, device=local.device) / self.config.frames - 1
        angles = times[:, None] * 2.0 ** torch.arange(self.config.frequencies, device=local.device)
        waves = torch.stack((angles.sin(), angles.cos()), dim=-1).flatten(1)
        inputs = torch.cat((waves.expand(len(local), -1, -1), local[:, None].expand(-1, count, -1)), dim=-1)
        hidden = inputs[..., :0]
        for layer in self.local_layers:
            hidden = layer(torch.cat((hidden, inputs), dim=-1))
        positions, rotations = self.pose_out(hidden).tensor_split([self.num_positions], dim=-1)
        inputs = torch.cat((inputs, turns[:, None].expand(-1, count, -1)), dim=-1)
        for layer in self.turn_layers:
            hidden = layer(torch.cat((hidden, inputs), dim=-1))
        return positions, rotations, self.turn_out(hidden)

    def encode(self, rows: Rows, lengths: Lengths) -> tuple[Gaussian, Gaussian]:
        """μ and log σ² of both latents; frames after a motion's end are zeros."""
        if rows.shape[1] > self.config.frames:
            raise UsageError(f"a motion of {rows.shape[1]} frames is longer than network.frames={self.config.frames}")
        rows = pad(rows, (0, 0, 0, self.config.frames - rows.shape[1]))
        mask = frames_within(lengths, rows.shape[1])[..., None]
        poses = with_velocities(rows, lengths, self.space)
        return self.local_encoder(poses), self.turn_encoder(_columns(self._orientation(rows)) * mask)

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Geodesic errors of orientations and rotations, L1 of joints in metres, and KL of both latents, annealed."""
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
        loss = root + bones + JOINT_WEIGHT * joints + weight * kl
        return {"loss": loss, "root": root, "bones": bones, "joints": joints, "kl": kl}

    def rows(self, local: Latents, turns: Latents, lengths: Lengths) -> Rows:
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
PUBLISHED, SMALL_PATH = Schedule(epochs=1000, batch_size=16), NemfPathNetworkConfig(widths=(64, 64, 64))
NANO_PATH = PeerConfig(SMALL_PATH, cosine(2200, 16, 1e-3), UNCONDITIONAL, LONG, precision="auto")
PAPER_PATH = PeerConfig(NemfPathNetworkConfig(), PUBLISHED, UNCONDITIONAL, CLIPS, weight_decay=1e-4)
NEMF_PATH = PeerStage("nemf-path", NemfPath, NANO_PATH, PAPER_PATH, share=0.2)
SMALL = NemfNetworkConfig(304, (64, 96, 128, 128), local_latent=128, turn_latent=32, width=192, kl_cycles=4)
NANO = PeerConfig(SMALL, cosine(2400, 32, 1e-3), UNCONDITIONAL, LONG, precision="auto")
PAPER = PeerConfig(NemfNetworkConfig(), PUBLISHED, UNCONDITIONAL, CLIPS, weight_decay=1e-4)
NEMF = PeerStage("nemf", Nemf, NANO, PAPER, builds_on=NEMF_PATH, share=0.8)
