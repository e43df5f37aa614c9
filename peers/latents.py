"""ACTOR, INR-MLP and NeMF: motions decoded as a whole from latents.

ACTOR (Petrovich et al. 2021; Mathux/ACTOR, src/models/architectures/transformer.py): a conditional VAE.
INR-MLP (Cervantes et al. 2022; PACerv/ImplicitMotion, models): an MLP of time and a per-motion latent code.
NeMF (He et al. 2022; c-he/NeMF, src/nemf): a neural field over time with two latents, and a root path predictor.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import roma
import torch
from scipy.spatial.distance import cdist
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture
from torch import Tensor, nn
from torch.nn.functional import avg_pool1d, binary_cross_entropy_with_logits, l1_loss, mse_loss, pad

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float, Float64, Int64
from motionkit.training.config import Schedule
from motionkit.training.networks import NO_ACTION, Conditions, kl_divergence, reparameterized
from peers import layers
from peers.generating import GIVEN_ACTION, GIVEN_MINILM, SMALL, UNCONDITIONAL, PeerConfig, PeerStage, cosine
from peers.layers import ConditionVector, Latents, NetworkInputs, PeerNetwork, TransformerSizes
from peers.motions import Lengths, Mask, MotionBatch, MotionsConfig, PoseSpace, Rows, SampleBatch, frames_within

INITIAL_LOG_VARIANCE = 1.0
ROOT = slice(0, 3)  # the root's position in `field` vectors
ROOT_NUMBERS, CONTACTS = 3, 4  # numbers: velocity in x and z, height; feet
ORIENTATION = 6  # numbers: two columns of a rotation matrix
CONTACT_WEIGHT, JOINT_WEIGHT = 0.5, 10.0
Latent = Float[Tensor, "batch _"]  # NeMF's two differ in width
Gaussian = tuple[Latent, Latent]  # μ and log σ²


@dataclass(frozen=True)
class ActorNetworkConfig:
    """ACTOR: transformers of these sizes to one latent of their width and back."""

    transformer: TransformerSizes = TransformerSizes(8, 256, 4, 1024)
    kl_weight: float = 1e-5


class Actor(PeerNetwork):
    """ACTOR: a conditional transformer VAE with one latent per motion."""

    def __init__(self, config: ActorNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        sizes, width = config.transformer, config.transformer.width
        self.config, self.space, self.width = config, inputs.space, width
        self.frame_in = nn.Linear(inputs.space.num_features, width)
        self.mean_token, self.variance_token, self.bias = (ConditionVector(inputs.conditions, width) for _ in range(3))
        self.dropout = nn.Dropout(sizes.dropout)
        self.encoder = layers.encoder(sizes)
        self.decoder = nn.TransformerDecoder(layers.attention(nn.TransformerDecoderLayer, sizes), sizes.layers)
        self.frame_out = nn.Linear(width, inputs.space.num_features)

    def encode(self, rows: Rows, mask: Mask, conditions: Conditions) -> tuple[Latents, Latents]:
        """μ and log σ²: the outputs of two condition tokens."""
        first = torch.stack((self.mean_token(conditions), self.variance_token(conditions)), dim=1)
        tokens = torch.cat((first, self.frame_in(rows)), dim=1)
        tokens = self.encoder(self.dropout(tokens + layers.positions(tokens)), src_key_padding_mask=pad(~mask, (2, 0)))
        return tokens[:, 0], tokens[:, 1]

    def decode(self, latents: Latents, mask: Mask, conditions: Conditions) -> Rows:
        """Standardised rows, zeros outside the mask: queries attend to the latent, shifted by the condition."""
        memory = (latents + self.bias(conditions))[:, None]
        queries = torch.zeros((*mask.shape, self.width), device=latents.device)
        queries = self.dropout(queries + layers.positions(queries))
        rows: Tensor = self.frame_out(self.decoder(queries, memory, tgt_key_padding_mask=~mask)) * mask[..., None]
        return rows

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Mean squared errors of pose vectors and joints over valid frames, and KL summed over the batch."""
        mask, joints_of = batch.mask, self.space.joints
        mean, log_variance = self.encode(batch.rows, mask, batch.conditions)
        predicted = self.decode(reparameterized(mean, log_variance, batch.generator), mask, batch.conditions)
        features = mse_loss(predicted[mask], batch.rows[mask])
        joints = mse_loss(joints_of(predicted)[mask], joints_of(batch.rows)[mask])
        kl = kl_divergence(mean, log_variance).sum()
        loss = features + joints + self.config.kl_weight * kl
        return {"loss": loss, "features": features, "joints": joints, "kl": kl}

    def sample(self, batch: SampleBatch) -> Rows:
        """Standardised rows decoded from z ~ N(0, I)."""
        return self.decode(batch.noise(self.width).float(), batch.mask, batch.conditions)


@dataclass(frozen=True)
class InrMlpNetworkConfig:
    """INR-MLP: size of the codes and widths of the MLP; `reseeds` is how often a mixture that copies training motions
    is fitted again."""

    code: int = 128
    time_features: int = 256
    hidden: tuple[int, ...] = (1000, 500, 500, 200, 100)
    kl_weight: float = 1e-5
    reseeds: int = 10


class InrMlp(PeerNetwork):
    """INR-MLP: a pose at a frame index, from a motion code and a condition code, each N(μ, σ²).

    An auto-decoder: the codes of training motions are optimised alternately with the network.
    """

    def __init__(self, config: InrMlpNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        self.config = config
        self.mean = nn.Parameter(torch.zeros(inputs.num_windows, config.code))
        self.log_variance = nn.Parameter(torch.full((inputs.num_windows, config.code), INITIAL_LOG_VARIANCE))
        self.condition_mean = ConditionVector(inputs.conditions, config.code)
        self.condition_log_variance = ConditionVector(inputs.conditions, config.code)
        for vector, start in ((self.condition_mean, 0.0), (self.condition_log_variance, INITIAL_LOG_VARIANCE)):
            if vector.actions is not None:
                nn.init.constant_(vector.actions.weight, start)
        widths = (2 * config.code + config.time_features, *config.hidden)
        each = [layer for pair in pairwise(widths) for layer in (nn.Linear(*pair), nn.ELU())]
        self.layers = nn.Sequential(*each, nn.Linear(widths[-1], inputs.space.num_features))
        # Length and action of the motion that each code stands for.
        self.register_buffer("frames_of", torch.zeros(inputs.num_windows, dtype=torch.int64))
        self.register_buffer("action_of", torch.full((inputs.num_windows,), NO_ACTION))
        self.frames_of: Tensor
        self.action_of: Tensor
        self._mixtures: dict[tuple[int, int], CodeMixture] = {}

    def forward(self, frames: Int64[Tensor, "batch frames"], code: Latents, condition_code: Latents) -> Rows:
        """Standardised poses at these frame indices."""
        time = layers.sinusoids(frames.flatten(), self.config.time_features).view(*frames.shape, -1)
        codes = torch.cat((code, condition_code), dim=1)[:, None].expand(-1, frames.shape[1], -1)
        rows: Tensor = self.layers(torch.cat((codes, time), dim=-1))
        return rows

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Squared errors of poses and of the root, and KL of both codes; every other step trains the codes alone."""
        conditions, trains_codes = batch.conditions, batch.step % 2 == 0
        self.frames_of.scatter_reduce_(0, batch.window, batch.frames.amax(dim=1) + 1, "amax")
        self.action_of[batch.window] = torch.where(conditions.given, conditions.action, self.action_of[batch.window])
        pairs = [
            (self.mean[batch.window], self.log_variance[batch.window]),
            (self.condition_mean(conditions), self.condition_log_variance(conditions)),
        ]
        if not trains_codes:
            pairs = [(mean.detach(), log_variance.detach()) for mean, log_variance in pairs]
        self.layers.requires_grad_(not trains_codes)
        predicted = self(batch.frames, *(reparameterized(*pair, batch.generator) for pair in pairs))
        self.layers.requires_grad_(True)
        errors = (predicted - batch.rows).square()[batch.mask]
        pose, root = errors.mean(), errors[:, ROOT].mean()
        kl = torch.stack([kl_divergence(*pair).sum(dim=1).mean() for pair in pairs]).sum()
        return {"loss": pose + root + self.config.kl_weight * kl, "pose": pose, "root": root, "kl": kl}

    def sample(self, batch: SampleBatch) -> Rows:
        """Standardised rows from codes of the mixture for the action and the length."""
        mean, log_variance = self.condition_mean(batch.conditions), self.condition_log_variance(batch.conditions)
        each = zip(batch.conditions.action.tolist(), batch.lengths.tolist(), batch.generators, strict=True)
        codes = [self.mixture(action, length).draw(generator) for action, length, generator in each]
        noise = [torch.randn(self.config.code, generator=generator) for generator in batch.generators]
        own = torch.stack(codes).to(batch.device, torch.float32)
        condition = mean + (0.5 * log_variance).exp() * torch.stack(noise).to(batch.device)
        frames = torch.arange(batch.frames, device=batch.device).expand(len(own), -1)
        poses: Tensor = self(frames, own, condition)
        return poses

    def mixture(self, action: int, length: int) -> "CodeMixture":
        """The mixture over codes of motions with this action (`NO_ACTION`: any) and lengths nearest to this one."""
        known = (self.frames_of > 0) & ((self.action_of == action) | (action == NO_ACTION))
        windows = np.flatnonzero((known if known.any() else self.frames_of > 0).cpu().numpy())
        lengths = self.frames_of.cpu().numpy()[windows]
        intervals = length_intervals(lengths)
        nearest = int(np.argmin([abs(lengths[rows].mean() - length) for rows in intervals]))
        if (action, nearest) not in self._mixtures:
            rows = torch.from_numpy(windows[intervals[nearest]])
            mean, log_variance = (each.detach().cpu()[rows].double().numpy() for each in (self.mean, self.log_variance))
            self._mixtures[action, nearest] = fit_mixture(mean, np.exp(0.5 * log_variance), self.config.reseeds)
        return self._mixtures[action, nearest]


LEAST_CODES, LEAST_FRAMES = 50, 10


def length_intervals(lengths: Int64[np.ndarray, "motions"]) -> list[Int64[np.ndarray, "some"]]:
    """Bin motions by length; each bin has at least `LEAST_CODES` motions and spans `LEAST_FRAMES` frames."""
    order = np.argsort(lengths, kind="stable")
    cuts, first = [], 0
    for place in range(1, len(order)):
        shortest, before, here = (lengths[order[each]] for each in (first, place - 1, place))
        enough = min(place - first, len(order) - place) >= LEAST_CODES
        if enough and here > before and here - shortest >= LEAST_FRAMES:
            cuts.append(place)
            first = place
    return np.split(order, cuts)


@dataclass(frozen=True, eq=False)
class CodeMixture:
    """A Gaussian mixture over codes; `factors` are the Cholesky factors of its covariances."""

    weights: Float64[np.ndarray, "parts"]
    means: Float64[np.ndarray, "parts code"]
    factors: Float64[np.ndarray, "parts code code"]

    def draw(self, generator: torch.Generator) -> Float[Tensor, "code"]:
        """A code, float64."""
        u = float(torch.rand((), generator=generator, dtype=torch.float64))
        component = min(int(np.searchsorted(np.cumsum(self.weights), u)), len(self.weights) - 1)
        noise = torch.randn(self.means.shape[1], generator=generator, dtype=torch.float64).numpy()
        return torch.from_numpy(self.means[component] + self.factors[component] @ noise)


COMPONENTS, DRAWS, MOST_DRAWS = 15, 50, 10_000
# A component whose mean is nearer to a training code than this share of the codes' mean norm copies that motion.
COPY_SHARE = 0.1


def fit_mixture(
    mean: Float64[np.ndarray, "codes code"], deviation: Float64[np.ndarray, "codes code"], reseeds: int
) -> CodeMixture:
    """Fit a mixture to samples of every code; refit if a component copies a training code, at last drop such."""
    count = int(np.clip(MOST_DRAWS // len(mean), 2, DRAWS))
    rng = np.random.default_rng(0)
    draws = (mean + deviation * rng.standard_normal((count, *mean.shape))).reshape(-1, mean.shape[1])
    least = COPY_SHARE * np.linalg.norm(mean, axis=1).mean()
    for seed in range(reseeds + 1):
        fitted = GaussianMixture(min(COMPONENTS, len(mean)), covariance_type="full", random_state=seed)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            fitted.fit(draws)
        away = cdist(fitted.means_, mean).min(axis=1) >= least
        if away.all():
            break
    kept = away if away.any() else np.ones_like(away)
    weights = fitted.weights_[kept] / fitted.weights_[kept].sum()
    return CodeMixture(weights, fitted.means_[kept], np.linalg.cholesky(fitted.covariances_[kept]))


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
        each = residuals((2 * poses + 1, *config.widths, ROOT_NUMBERS + CONTACTS), config.kernel, nn.PReLU)
        each[-1].activation = nn.Identity()
        self.layers = nn.Sequential(*each)

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
        root, contacts = torch.split(values.transpose(1, 2), [ROOT_NUMBERS, CONTACTS], dim=-1)
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

    def forward(self, count: int, local: Latent, turns: Latent) -> tuple[Tensor, Tensor, Tensor]:
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

    def rows(self, local: Latent, turns: Latent, lengths: Lengths) -> Rows:
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


ACTOR_NANO = PeerConfig(ActorNetworkConfig(SMALL), cosine(2900, 16, 5e-4), GIVEN_MINILM, precision="auto")
ACTOR_PUBLISHED, SHORT = Schedule(epochs=5000, batch_size=20), MotionsConfig(max_frames=60)
ACTOR_PAPER = PeerConfig(ActorNetworkConfig(), ACTOR_PUBLISHED, GIVEN_ACTION, SHORT, weight_decay=0.01)
ACTOR = PeerStage("actor", Actor, ACTOR_NANO, ACTOR_PAPER)

# Whole windows, of which a step sees five frames.
WHOLE_IN_5 = MotionsConfig(pose_vectors="field", crops="scattered", sampled_frames=5)
INR_SIZES, INR_PUBLISHED = InrMlpNetworkConfig(reseeds=2), Schedule(epochs=10_000, batch_size=512, learning_rate=1e-3)
INR_NANO = PeerConfig(INR_SIZES, cosine(12_000, 256, 1e-3), GIVEN_MINILM, WHOLE_IN_5, precision="auto", clip_norm=2.0)
INR_PAPER = PeerConfig(InrMlpNetworkConfig(), INR_PUBLISHED, GIVEN_ACTION, WHOLE_IN_5, clip_norm=2.0)
INR_MLP = PeerStage("inr-mlp", InrMlp, INR_NANO, INR_PAPER)

CLIPS = MotionsConfig(fps=30.0, max_frames=128, min_seconds=128 / 30)
LONG = MotionsConfig(fps=30.0, max_frames=294)
NEMF_PUBLISHED, SMALL_PATH = Schedule(epochs=1000, batch_size=16), NemfPathNetworkConfig(widths=(64, 64, 64))
NANO_PATH = PeerConfig(SMALL_PATH, cosine(2200, 16, 1e-3), UNCONDITIONAL, LONG, precision="auto")
PAPER_PATH = PeerConfig(NemfPathNetworkConfig(), NEMF_PUBLISHED, UNCONDITIONAL, CLIPS, weight_decay=1e-4)
NEMF_PATH = PeerStage("nemf-path", NemfPath, NANO_PATH, PAPER_PATH, share=0.2)
NEMF_SIZES = NemfNetworkConfig(304, (64, 96, 128, 128), local_latent=128, turn_latent=32, width=192, kl_cycles=4)
NEMF_NANO = PeerConfig(NEMF_SIZES, cosine(2400, 32, 1e-3), UNCONDITIONAL, LONG, precision="auto")
NEMF_PAPER = PeerConfig(NemfNetworkConfig(), NEMF_PUBLISHED, UNCONDITIONAL, CLIPS, weight_decay=1e-4)
NEMF = PeerStage("nemf", Nemf, NEMF_NANO, NEMF_PAPER, builds_on=NEMF_PATH, share=0.8)
