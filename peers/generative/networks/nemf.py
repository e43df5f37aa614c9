"""NeMF (He et al. 2022; c-he/NeMF, src/nemf): a motion as a field of time under two latents, and the path it makes."""

from collections.abc import Callable, Mapping
from itertools import pairwise

import roma
import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn
from torch.nn.functional import avg_pool1d, binary_cross_entropy_with_logits, l1_loss, pad

from motionkit.core.errors import UsageError
from motionkit.features.layout import VectorLayout, vector_layout
from motionkit.training.diffusion.settings import DiffusionConfig
from peers.generative.batches import ConditionSizes, MotionBatch, PoseSpace, Wanted, frames_within
from peers.generative.networks.layers import drawn, kl_of
from peers.generative.settings import NemfNetworkConfig, NemfPathNetworkConfig

PATH = "nemf-path"
ORIENTATION = 6  # numbers: two columns of a rotation matrix


class Residual(nn.Module):
    """A share of a convolution, and of a plain map of what came in the rest; even kernels halve the frames."""

    def __init__(self, inputs: int, outputs: int, kernel: int, share: float, activation: nn.Module) -> None:
        super().__init__()
        self.stride, self.share, self.activation = 2 - kernel % 2, share, activation
        self.changed = nn.Conv1d(inputs, outputs, kernel, self.stride, (kernel - 1) // 2)
        self.kept = nn.Conv1d(inputs, outputs, 1)

    def forward(self, values: Float[Tensor, "batch inputs frames"]) -> Float[Tensor, "batch outputs frames_out"]:
        """The next layer's values."""
        changed = self.activation(self.changed(values))
        kept: Tensor = self.kept(avg_pool1d(values, self.stride) if self.stride > 1 else values)
        made: Tensor = self.share * changed + (1 - self.share) * kept
        return made


def residuals(widths: tuple[int, ...], kernel: int, activation: Callable[[], nn.Module]) -> list[Residual]:
    """Layers of which the k-th, from 1, takes 1 / (k + 1) from its convolution."""
    return [
        Residual(inputs, outputs, kernel, 1 / (number + 1), activation())
        for number, (inputs, outputs) in enumerate(pairwise(widths), start=1)
    ]


def native_layout(space: PoseSpace) -> VectorLayout:
    """Where a pose's numbers lie; raises `UsageError` for vectors of another convention than `native`."""
    part = vector_layout(space.vectors.skeleton.num_joints)
    if space.num_numbers != part.size:
        raise UsageError("NeMF learns native vectors: motions.pose_vectors=native")
    return part


def with_changes(
    poses: Float[Tensor, "batch frames numbers"], lengths: Int64[Tensor, "batch"], fps: float
) -> Float[Tensor, "batch frames twice"]:
    """Poses and what they change by in a quarter of a second, about as large; zeros at a motion's end."""
    changes = pad(poses.diff(dim=1), (0, 0, 0, 1)) * frames_within(lengths - 1, poses.shape[1])[..., None]
    return torch.cat((poses, 0.25 * fps * changes), dim=-1)


class NemfPath(nn.Module):
    """Root velocity, height and contacts of how a body moves about its root: NeMF's global motion predictor."""

    def __init__(
        self, config: NemfPathNetworkConfig, space: PoseSpace, sizes: ConditionSizes, earlier: Mapping[str, nn.Module]
    ) -> None:
        super().__init__()
        self.config, self.space, self.part = config, space, native_layout(space)
        part = self.part
        self.sizes = [3, part.contacts.stop - part.contacts.start]
        poses = part.joint_rotations.stop - part.joint_positions.start
        layers = residuals((2 * poses + 1, *config.widths, sum(self.sizes)), config.kernel, nn.PReLU)
        layers[-1].activation = nn.Identity()
        self.layers = nn.Sequential(*layers)

    def forward(
        self, rows: Float[Tensor, "batch frames numbers"], lengths: Int64[Tensor, "batch"]
    ) -> tuple[Float[Tensor, "batch frames 3"], Float[Tensor, "batch frames 4"]]:
        """Velocity in x and z and height, in their own units, and logits of contacts, of standardised rows.

        Of a row its yaw velocity, joints and rotations are looked at.
        """
        part = self.part
        poses = rows[..., part.joint_positions.start : part.joint_rotations.stop]
        told = torch.cat((with_changes(poses, lengths, float(self.space.fps)), rows[..., part.root_yaw_velocity]), -1)
        seen = frames_within(lengths, rows.shape[1])[:, None]
        values = told.transpose(1, 2) * seen
        for layer in self.layers:
            values = layer(values) * seen
        root, contacts = torch.split(values.transpose(1, 2), self.sizes, dim=-1)
        return root, contacts

    def losses(self, batch: MotionBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """L1 of velocity, height and the path that follows, and contacts' cross-entropy, of the frames there are."""
        part, seen = self.part, batch.seen
        numbers = batch.rows * self.space.scale + self.space.mean
        root, contacts = self(batch.rows, batch.lengths)
        angle = self.space.heading(numbers)
        truth = torch.cat((numbers[..., part.root_velocity], numbers[..., part.root_height]), dim=-1)
        velocity, height = l1_loss(root[seen][:, :2], truth[seen][:, :2]), l1_loss(root[seen][:, 2], truth[seen][:, 2])
        path = l1_loss(self.space.path(root[..., :2], angle)[seen], self.space.path(truth[..., :2], angle)[seen])
        told = numbers[..., part.contacts][seen].clamp(0, 1)
        touch = binary_cross_entropy_with_logits(contacts[seen], told)
        loss = velocity + height + path + self.config.contact_weight * touch
        return {"loss": loss, "velocity": velocity, "height": height, "path": path, "contacts": touch}


class ClipEncoder(nn.Module):
    """A clip → N(μ, σ²) of one latent: four convolutions, each of half the frames."""

    def __init__(self, inputs: int, widths: tuple[int, ...], kernel: int, frames: int, latent: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(*residuals((inputs, *widths), kernel, nn.Tanh))
        flat = widths[-1] * (frames >> len(widths))
        self.mean, self.log_variance = nn.Linear(flat, latent), nn.Linear(flat, latent)

    def forward(self, clips: Float[Tensor, "batch frames inputs"]) -> tuple[Tensor, Tensor]:
        """μ and log σ²."""
        flat = self.layers(clips.transpose(1, 2)).flatten(1)
        return self.mean(flat), self.log_variance(flat)


class Nemf(nn.Module):
    """Poses at any time of a latent of the body; where it turns to, of another one as well."""

    diffusion: DiffusionConfig | None = None

    def __init__(
        self, config: NemfNetworkConfig, space: PoseSpace, sizes: ConditionSizes, earlier: Mapping[str, nn.Module]
    ) -> None:
        super().__init__()
        path = earlier[PATH]
        assert isinstance(path, NemfPath)
        self._path = (path,)  # frozen, and saved with its own stage
        self.config, self.space, self.part = config, space, native_layout(space)
        part = self.part
        self.sizes = [part.joint_positions.stop - part.joint_positions.start]
        self.sizes.append(part.joint_rotations.stop - part.joint_rotations.start)
        poses, local, turns = sum(self.sizes), config.local_latent, config.turn_latent
        self.local_encoder = ClipEncoder(2 * poses, config.widths, config.kernel, config.frames, local)
        self.turn_encoder = ClipEncoder(ORIENTATION, config.widths, config.kernel, config.frames, turns)
        told = 2 * config.frequencies + local
        skipped = [0] + [config.width] * (config.local_layers - 1)
        self.local_layers = nn.ModuleList(_field_layer(own + told, config.width) for own in skipped)
        self.turn_layers = nn.ModuleList(
            _field_layer(config.width + told + turns, config.width) for _ in range(config.turn_layers)
        )
        self.pose_out, self.turn_out = nn.Linear(config.width, poses), nn.Linear(config.width, ORIENTATION)
        self._progress = 1.0

    def forward(
        self, count: int, local: Float[Tensor, "batch local"], turns: Float[Tensor, "batch turns"]
    ) -> tuple[Float[Tensor, "batch frames positions"], Float[Tensor, "batch frames rotations"], Tensor]:
        """Standardised joints, rotations as two columns of their matrices, and the root's orientation alike."""
        times = 2 * torch.arange(count, device=local.device) / self.config.frames - 1
        angles = times[:, None] * 2.0 ** torch.arange(self.config.frequencies, device=local.device)
        waves = torch.stack((angles.sin(), angles.cos()), dim=-1).flatten(1)
        told = torch.cat((waves.expand(len(local), -1, -1), local[:, None].expand(-1, count, -1)), dim=-1)
        hidden = self.local_layers[0](told)
        for layer in list(self.local_layers)[1:]:
            hidden = layer(torch.cat((hidden, told), dim=-1))
        positions, rotations = self.pose_out(hidden).split(self.sizes, dim=-1)
        told = torch.cat((told, turns[:, None].expand(-1, count, -1)), dim=-1)
        for layer in self.turn_layers:
            hidden = layer(torch.cat((hidden, told), dim=-1))
        return positions, rotations, self.turn_out(hidden)

    def encode(
        self, rows: Float[Tensor, "batch frames numbers"], lengths: Int64[Tensor, "batch"]
    ) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
        """μ and log σ² of both latents; what lies behind a motion's end is zeros."""
        if rows.shape[1] > self.config.frames:
            raise UsageError(f"a motion of {rows.shape[1]} frames: network.frames={self.config.frames} are fewer")
        rows = pad(rows, (0, 0, 0, self.config.frames - rows.shape[1]))
        seen = frames_within(lengths, rows.shape[1])[..., None]
        part = self.part
        poses = rows[..., part.joint_positions.start : part.joint_rotations.stop]
        turns = self._orientation(rows).transpose(-1, -2)[..., :2, :].flatten(-2) * seen
        return self.local_encoder(with_changes(poses, lengths, float(self.space.fps))), self.turn_encoder(turns)

    def begin_step(self, step: int, steps: int) -> None:
        """KL's weight grows in the first half of every cycle."""
        self._progress = step / steps

    def losses(self, batch: MotionBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Angles of orientations and rotations, ten times L1 of joints in metres, and KL of both latents."""
        part, seen = self.part, batch.seen
        latents = self.encode(batch.rows, batch.lengths)
        made, rotations, turns = self(batch.rows.shape[1], *(drawn(*each, generator) for each in latents))
        scale = self.space.scale[part.joint_positions]
        joints = l1_loss(made[seen] * scale, batch.rows[..., part.joint_positions][seen] * scale)
        true = (batch.rows * self.space.scale + self.space.mean)[..., part.joint_rotations]
        bones = _angles(_matrices(rotations[seen]), _matrices(true[seen])).mean()
        root = _angles(_matrices(turns[seen])[:, 0], self._orientation(batch.rows)[seen]).mean()
        kl = torch.stack([kl_of(*each).sum(dim=1).mean() for each in latents]).sum()
        weight = self.config.kl_weight * min(1.0, 0.01 + 2 * (self._progress * self.config.kl_cycles % 1))
        loss = root + bones + self.config.joint_weight * joints + weight * kl
        return {"loss": loss, "root": root, "bones": bones, "joints": joints, "kl": kl}

    def rows(
        self, local: Float[Tensor, "batch local"], turns: Float[Tensor, "batch turns"], lengths: Int64[Tensor, "batch"]
    ) -> Float[Tensor, "batch frames numbers"]:
        """Standardised rows of latents, the path predicted; velocities of joints, which follow, are the mean."""
        part, space = self.part, self.space
        count = int(lengths.max())
        # And one frame more, to which the last one turns.
        positions, rotations, orientation = self(count + 1, local, turns)
        rows: Tensor = positions.new_zeros((len(positions), count, space.num_numbers))

        def put(block: slice, numbers: Tensor) -> None:
            rows[..., block] = (numbers - space.mean[block]) / space.scale[block]

        rows[..., part.joint_positions] = positions[:, :-1]
        put(part.joint_rotations, _matrices(rotations[:, :-1]).transpose(-1, -2)[..., :2, :].flatten(-3))
        matrix = _matrices(orientation)[:, :, 0]
        # Turns about Y between neighbours, each frame's velocity the mean of both.
        turned = matrix[:, 1:] @ matrix[:, :-1].transpose(-1, -2)
        steps = torch.atan2(turned[..., 0, 2] - turned[..., 2, 0], turned[..., 0, 0] + turned[..., 2, 2])
        before = torch.cat((steps[:, :1], steps[:, :-1]), dim=1)
        put(part.root_yaw_velocity, (before + steps)[..., None] * (0.5 * float(space.fps)))
        root, contacts = self._path[0](rows, lengths)
        put(part.root_velocity, root[..., :2])
        put(part.root_height, root[..., 2:])
        put(part.contacts, contacts.sigmoid())
        return rows

    def sample(self, wanted: Wanted, diffusion: DiffusionConfig) -> Float[Tensor, "batch frames numbers"]:
        """Standardised rows of latents ~ N(0, I); conditions are not known."""
        sizes = [self.config.local_latent, self.config.turn_latent]
        latents = wanted.noise(sum(sizes)).to(wanted.device, torch.float32)
        local, turns = torch.split(latents, sizes, dim=1)
        return self.rows(local, turns, wanted.lengths.to(wanted.device))

    def _orientation(self, rows: Float[Tensor, "batch frames numbers"]) -> Float[Tensor, "batch frames 3 3"]:
        """The root's, turned about Y as far as since the first frame."""
        angle = self.space.heading(rows * self.space.scale + self.space.mean)[..., 0]
        axis = torch.stack((torch.zeros_like(angle), angle, torch.zeros_like(angle)), dim=-1)
        made: Tensor = roma.rotvec_to_rotmat(axis)
        return made


def _field_layer(inputs: int, width: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, width), nn.LayerNorm(width), nn.ReLU())


def _matrices(columns: Float[Tensor, "*poses numbers"]) -> Float[Tensor, "*poses joints 3 3"]:
    """Rotations of pairs of columns."""
    made: Tensor = roma.special_gramschmidt(columns.reshape(*columns.shape[:-1], -1, 2, 3).transpose(-1, -2).float())
    return made


def _angles(found: Float[Tensor, "*some 3 3"], true: Float[Tensor, "*some 3 3"]) -> Float[Tensor, "*some"]:
    """Radians between rotations."""
    cosine = ((found * true).sum(dim=(-1, -2)) - 1) / 2
    return cosine.clamp(-1 + 1e-6, 1 - 1e-6).acos()
