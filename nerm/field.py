"""A trained motion field f_θ(t, z, s) → pose: the result of stage 1 (paper §3.1), for generation and encoding.

Local latents start from a linear model of the poses, fitted to a window by ridge regression: the path bank is fitted to
the root's path and heading, then the pose banks to the principal components of the poses relative to the fitted path.
The network starts as the same linear model.

Contact is an output of the field too (ours): a small network on the decoder's input gives the probabilities that ankle
and toe of both feet are on the ground, at any t. Feet of generated motions slide from residual noise, so their paths
say little about contacts; z still does (docs/results/trials.md).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from motionkit.core.shapes import Bool, Float, Float32, Float64, Int64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.data.windows import PoseBatch, WindowPoses, Windows, chunks, normalise_seconds
from motionkit.features import field
from motionkit.features.convention import PoseVectors
from motionkit.features.field import FIELD_VECTORS
from motionkit.features.native import NativeVectors
from motionkit.fields.motion_field import Poses, check_times
from motionkit.training.config import from_plain, to_plain
from motionkit.training.loop import load_tensors, prefixed, rebuilding, resolve_device, save_tensors, unprefixed
from motionkit.training.networks import VectorScaling, vector_tensors, vectors_of
from motionkit.training.run import RunFolder, StageFolder
from nerm.latents import Bank, LocalLatents, local_latents, relative_to
from nerm.network import EncodedCoordinates, FieldNetwork
from nerm.recipes import FieldConfig, LatentScale

ROOT_PATH = (0, 2)
TIMES_PER_WINDOW = 128
HELD_TIMES = 128
WINDOWS_AT_ONCE = 256


@dataclass(frozen=True, eq=False)
class PoseTensors:
    """`motionkit.data.windows.PoseBatch` as tensors."""

    window: Int64[Tensor, "batch"]
    coordinates: Float64[Tensor, "batch poses"]
    fps: Float64[Tensor, "batch"]
    vectors: Float32[Tensor, "batch poses features"]

    @classmethod
    def of(cls, batch: PoseBatch) -> "PoseTensors":
        """The tensors of a batch, without copying."""
        arrays = (batch.window, batch.coordinates, batch.fps, batch.vectors)
        return cls(*(torch.from_numpy(array) for array in arrays))

    def to(self, device: torch.device) -> "PoseTensors":
        """Move to a device."""
        return PoseTensors(*(each.to(device) for each in (self.window, self.coordinates, self.fps, self.vectors)))


def ridge_knots(
    targets: Float[Tensor, "windows times width"],
    coordinates: Float64[Tensor, "windows times"],
    counts: Float[Tensor, "windows times"],
    bank: Bank,
    ridge: float,
) -> Float32[Tensor, "windows knots width"]:
    """Fit knots to targets at given coordinates by ridge regression.

    `counts` weights the instants; the ridge is in units of one instant.
    """
    weights = bank.interpolant(coordinates.reshape(-1)).reshape(*coordinates.shape, bank.num_knots)
    counted = (weights * counts[..., None]).transpose(1, 2)
    gram = counted @ weights + ridge * torch.eye(bank.num_knots, dtype=torch.float64)
    knots: Tensor = torch.linalg.solve(gram, counted @ targets.double())
    return knots.float()


@dataclass(frozen=True, eq=False)
class PoseComponents:
    """Principal components of standardised poses, scaled to unit variance."""

    mean: Float32[Tensor, "numbers"]
    directions: Float32[Tensor, "numbers components"]

    def scores(self, standardised: Float[Tensor, "*poses numbers"]) -> Float[Tensor, "*poses components"]:
        """Standardised vectors → component scores of unit variance."""
        return (standardised - self.mean) @ self.directions

    def inverse(self) -> Float32[Tensor, "components numbers"]:
        """Maps scores back to centred vectors (a pseudo-inverse)."""
        matrix: Tensor = torch.linalg.pinv(self.directions)
        return matrix


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Banks, scales and components of the linear model; `ridge` in units of one pose per knot."""

    banks: LocalLatents
    scaling: VectorScaling
    components: PoseComponents
    ridge: float

    def fit(self, batch: PoseTensors) -> Float32[Tensor, "batch latent"]:
        """Latents of windows from poses in order of time; the last pose is held beyond a window's end."""
        batch, counts = held(batch)
        path_knots, relative = _without_path(batch, counts, self.banks, self.scaling, self.ridge)
        scores = self.components.scores(relative)
        of_bank = torch.split(scores, [bank.numbers for bank in self.banks.pose], dim=-1)
        pose_knots = [
            ridge_knots(targets, batch.coordinates, counts, bank, self.ridge)
            for targets, bank in zip(of_bank, self.banks.pose, strict=True)
        ]
        return self.banks.join([*pose_knots, *path_knots])


def linear_model(poses: WindowPoses, scaling: VectorScaling, config: FieldConfig) -> LinearModel | None:
    """The linear model of the windows' poses; None for the global layout."""
    banks, ridge = local_latents(config), config.latents.ridge
    if banks is None:
        return None
    return LinearModel(banks, scaling, measure_components(poses, banks, scaling, ridge), ridge)


def measure_components(poses: WindowPoses, banks: LocalLatents, scaling: VectorScaling, ridge: float) -> PoseComponents:
    """Principal components of the windows' poses relative to their fitted paths; one pass, constant memory."""
    size = len(scaling.mean)
    count, total, outer = 0, torch.zeros(size).double(), torch.zeros(size, size).double()
    for rows in chunks(len(poses.windows), WINDOWS_AT_ONCE):
        batch = PoseTensors.of(poses.evenly(rows, TIMES_PER_WINDOW))
        counts = torch.ones_like(batch.coordinates)
        vectors = _without_path(batch, counts, banks, scaling, ridge)[1].double().flatten(0, 1)
        count += len(vectors)
        total, outer = total + vectors.sum(0), outer + vectors.T @ vectors
    mean = total / count
    values, axes = torch.linalg.eigh(outer / count - torch.outer(mean, mean))
    largest = torch.argsort(values, descending=True)[: banks.num_components]
    directions = axes[:, largest] / values[largest].clamp(min=1e-12).sqrt()
    return PoseComponents(mean.float(), directions.float())


def fit_windows(
    poses: WindowPoses, model: LinearModel, windows: Int64[np.ndarray, "chosen"]
) -> Float32[Tensor, "chosen latent"]:
    """Fit the latents of these windows."""
    return torch.cat(
        [
            model.fit(PoseTensors.of(poses.evenly(windows[rows], TIMES_PER_WINDOW)))
            for rows in chunks(len(windows), WINDOWS_AT_ONCE)
        ]
    )


def held(batch: PoseTensors) -> tuple[PoseTensors, Float64[Tensor, "batch times"]]:
    """Hold each window's last pose from its end to t = 1; returns the batch and the weight of each instant.

    Knots beyond a window's end then describe a body that stands still instead of being undetermined.
    """
    grid = torch.linspace(-1.0, 1.0, HELD_TIMES, dtype=torch.float64).expand(len(batch.window), -1)
    last = batch.vectors[:, -1:].expand(-1, HELD_TIMES, -1)
    counts = torch.cat((torch.ones_like(batch.coordinates), (grid > batch.coordinates[:, -1:]).double()), dim=1)
    coordinates = torch.cat((batch.coordinates, grid), dim=1)
    return PoseTensors(batch.window, coordinates, batch.fps, torch.cat((batch.vectors, last), dim=1)), counts


def _without_path(
    batch: PoseTensors,
    counts: Float64[Tensor, "batch times"],
    banks: LocalLatents,
    scaling: VectorScaling,
    ridge: float,
) -> tuple[list[Float32[Tensor, "batch knots 3"]], Float32[Tensor, "batch times numbers"]]:
    """The path bank's knots (empty without such a bank) and standardised poses relative to the path."""
    standardised = scaling.apply(batch.vectors)
    if banks.path is None:
        return [], standardised
    x, z = (standardised[..., number].double() for number in ROOT_PATH)
    heading = field.heading(field.decode(batch.vectors.numpy())).astype(np.float64)
    measured = torch.stack((x, z, torch.from_numpy(np.unwrap(heading, axis=1))), dim=-1)
    units = banks.path_units().double()
    knots = ridge_knots(measured / units, batch.coordinates, counts, banks.path, ridge)
    weights = banks.path.interpolant(batch.coordinates.reshape(-1)).reshape(*batch.coordinates.shape, -1)
    path = (weights @ knots.double()) * units
    return [knots], relative_to(standardised, path.float())


SMALLEST_DEVIATION = 1e-6


@dataclass(frozen=True, eq=False)
class LatentSpace:
    """The map between latents of the field and standardised numbers of the same size.

    `banks` is the layout of z (None: global); `mean` and `deviation` are those of latents with their path as steps.
    """

    banks: LocalLatents | None
    mean: Float32[Tensor, "latent"]
    deviation: Float32[Tensor, "latent"]

    def standardise(self, latents: Float32[Tensor, "batch latent"]) -> Float32[Tensor, "batch latent"]:
        """Latents of the field → numbers of the diffusion."""
        return (with_steps(latents, self.banks) - self.mean) / self.deviation

    def restore(self, numbers: Float32[Tensor, "batch latent"]) -> Float32[Tensor, "batch latent"]:
        """The inverse of `standardise`."""
        latents = numbers * self.deviation + self.mean
        if self.banks is None or self.banks.path is None:
            return latents
        *poses, steps = self.banks.split(latents)
        return self.banks.join([*poses, places_of(steps)])


def with_steps(latents: Float32[Tensor, "batch latent"], banks: LocalLatents | None) -> Float32[Tensor, "batch latent"]:
    """Latents with their path, if any, as steps between knots.

    As positions, a path spreads over metres while its steps are centimetres, so the denoiser's residual noise would be
    metres per second of sliding. As steps in the body's frame, a path is as stationary as the poses.
    """
    if banks is None or banks.path is None:
        return latents
    *poses, places = banks.split(latents)
    return banks.join([*poses, steps_of(places)])


def steps_of(places: Float[Tensor, "batch knots 3"]) -> Float[Tensor, "batch knots 3"]:
    """(x, z, heading) of each knot → (sideways, forward, turn) since the knot before; the first knot is unchanged.

    A step is expressed in the heading half-way through it, so that an arc is a sequence of equal steps.
    """
    change = places[:, 1:] - places[:, :-1]
    half_way = 0.5 * (places[:, 1:, 2] + places[:, :-1, 2])
    x, z, turn = change.unbind(-1)
    cosine, sine = torch.cos(half_way), torch.sin(half_way)
    steps = torch.stack((cosine * x - sine * z, sine * x + cosine * z, turn), dim=-1)
    return torch.cat((places[:, :1], steps), dim=1)


def places_of(steps: Float[Tensor, "batch knots 3"]) -> Float[Tensor, "batch knots 3"]:
    """The inverse of `steps_of`."""
    heading = steps[..., 2].cumsum(dim=1)
    half_way = heading[:, 1:] - 0.5 * steps[:, 1:, 2]
    cosine, sine = torch.cos(half_way), torch.sin(half_way)
    sideways, forward, _ = steps[:, 1:].unbind(-1)
    change = torch.stack((cosine * sideways + sine * forward, cosine * forward - sine * sideways), dim=-1)
    path = torch.cat((steps[:, :1, :2], change), dim=1).cumsum(dim=1)
    return torch.cat((path, heading[..., None]), dim=-1)


def kinds_of_numbers(dimension: int, banks: LocalLatents | None, scale: LatentScale) -> Int64[Tensor, "latent"]:
    """Groups of numbers of z that share a mean and a deviation, as an index per number.

    With `scale` "component" a group is one component of a bank at all its knots (except the first position of a path,
    which is no step); otherwise, and without banks, each number is its own group.
    """
    if banks is None or scale == "number":
        return torch.arange(dimension)
    numbers = banks.describe()
    is_start = (numbers.bank == len(banks.pose)) & (banks.path is not None) & (numbers.knot == 0)
    names = torch.stack((numbers.bank, numbers.component, is_start.to(torch.int64)))
    kinds: Tensor = torch.unique(names, dim=1, return_inverse=True)[1]
    return kinds


def measured_space(
    latents: Float32[Tensor, "draws latent"],
    used: Bool[Tensor, "draws latent"],
    banks: LocalLatents | None,
    scale: LatentScale,
) -> LatentSpace:
    """The space in which samples of latents have mean 0 and deviation 1, over the motions that use each number.

    A number that no motion uses gets mean 0 and deviation 1.
    """
    numbers, share = with_steps(latents, banks).to(torch.float64), used.to(torch.float64)
    kinds = kinds_of_numbers(latents.shape[1], banks, scale)

    def over_kinds(sums: Float64[Tensor, "latent"]) -> Float64[Tensor, "latent"]:
        return torch.zeros(int(kinds.max()) + 1, dtype=torch.float64).index_add(0, kinds, sums)[kinds]

    counts = over_kinds(share.sum(dim=0))
    mean = over_kinds((numbers * share).sum(dim=0)) / counts.clamp(min=1)
    variance = over_kinds(((numbers - mean).square() * share).sum(dim=0)) / counts.clamp(min=1)
    deviation = torch.where(counts > 0, variance.sqrt().clamp(min=SMALLEST_DEVIATION), torch.ones_like(variance))
    return LatentSpace(banks, mean.to(torch.float32), deviation.to(torch.float32))


NUM_LOGITS, CONTACT_WIDTH = 4, 128


class ContactHead(nn.Module):
    """Logits of contact of left ankle, left toe, right ankle and right toe, from the output of `FieldNetwork.read`."""

    def __init__(self, num_read: int) -> None:
        super().__init__()
        width = CONTACT_WIDTH
        self.layers = nn.Sequential(
            nn.Linear(num_read, width), nn.SiLU(), nn.Linear(width, width), nn.SiLU(), nn.Linear(width, NUM_LOGITS)
        )

    def forward(self, read: Float[Tensor, "batch poses read"]) -> Float[Tensor, "batch poses 4"]:
        """Logits."""
        logits: Tensor = self.layers(read)
        return logits


GRIDS_KEPT = 16
POSES_AT_ONCE = 8_192
# Context poses of a transformer decoder (docs/deviations.md).
CONTEXT_INSTANTS = 64
POSES_IN_CONTEXT_AT_ONCE = 1_024


@dataclass(frozen=True, eq=False)
class TrainedField:
    """f_θ with its scales and the posteriors N(μ_i, Σ_i) of all training windows.

    `network` is in evaluation mode without gradients; `components` are the pose components of the linear model that
    initialises local latents (None for the global layout); `vectors` is the pose vector convention; `contacts` is the
    contact head (None: not trained).
    """

    network: FieldNetwork
    scaling: VectorScaling
    components: PoseComponents | None
    posterior_mean: Float32[Tensor, "windows latent"]
    posterior_log_variance: Float32[Tensor, "windows latent"]
    windows: Windows
    store_fingerprint: str
    vectors: PoseVectors = FIELD_VECTORS
    contacts: ContactHead | None = None

    @property
    def config(self) -> FieldConfig:
        """The training settings."""
        return self.network.config

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton of decoded poses; its first 22 joints are the 22-joint layout's."""
        return self.vectors.skeleton

    @property
    def linear_model(self) -> LinearModel | None:
        """The linear model of local latents, on the CPU; None for the global layout."""
        banks = self.network.local
        if banks is None or self.components is None:
            return None
        return LinearModel(banks, self.scaling.to(torch.device("cpu")), self.components, self.config.latents.ridge)

    @property
    def max_duration_seconds(self) -> float:
        """l_max: the span of [−1, 1]."""
        return self.config.windows.max_duration_seconds

    @property
    def max_training_fps(self) -> Fraction:
        """Highest framerate in training: the fastest window's, or that of fixed-framerate training."""
        if self.config.clips.fixed_framerate is not None:
            return self.config.clips.fixed_framerate
        fastest = int(np.argmax(self.windows.fps))
        return self.windows.exact_fps(fastest)

    @property
    def has_joints(self) -> bool:
        """Whether a pose's joints are a differentiable function of the latent alone, without integrating a path."""
        return not isinstance(self.vectors, NativeVectors) and self.config.decoder.kind != "transformer"

    @property
    def device(self) -> torch.device:
        """The network's device."""
        return self.scaling.mean.device

    def encode_times(self, times_seconds: Float64[np.ndarray, "batch times"], fps: Fraction) -> EncodedCoordinates:
        """The coordinate branch at these times; recent grids are cached.

        Motions of any duration share the grid of a whole window at `fps`, or at the rate of contact detection.
        """
        from motionkit.fields.contact.planted import GRID_FPS  # deferred: training needs no planting

        rows, count = times_seconds.shape
        for rate in (float(fps), GRID_FPS):
            whole = np.arange(int(self.max_duration_seconds * rate + 1e-6) + 1) / rate
            if rows == 1 and count <= len(whole) and np.abs(times_seconds[0] - whole[:count]).max(initial=0.0) < 1e-9:
                return self._kept_grids((1, len(whole)), whole.tobytes(), fps).first(count)
        return self._kept_grids(times_seconds.shape, np.ascontiguousarray(times_seconds).tobytes(), fps)

    @cached_property
    def _kept_grids(self) -> Callable[[tuple[int, ...], bytes, Fraction], EncodedCoordinates]:
        network, longest, device = self.network, self.max_duration_seconds, self.device

        @lru_cache(GRIDS_KEPT)
        @torch.no_grad()
        def encoded(shape: tuple[int, ...], content: bytes, fps: Fraction) -> EncodedCoordinates:
            times = np.frombuffer(content).reshape(shape)
            rates = torch.full((len(times),), float(fps), dtype=torch.float64, device=device)
            return network.encode_coordinates(torch.from_numpy(normalise_seconds(times, longest)).to(device), rates)

        return encoded

    def decode(
        self, latents: Float[Tensor, "batch latent"], times_seconds: Float64[np.ndarray, "times"], fps: Fraction
    ) -> Float32[np.ndarray, "batch times 22 3"]:
        """Joint positions in metres of the 22-joint layout, in the windows' own frames, for each latent.

        Times are seconds from the window's start; `fps` is the framerate s. At most `POSES_AT_ONCE` poses are decoded
        at once, to bound memory.
        """
        joints = slice(0, SMPL22.num_joints)
        return np.stack([poses.joint_positions[:, joints] for poses in self.poses(latents, times_seconds, fps)])

    def poses(
        self,
        latents: Float[Tensor, "batch latent"],
        times_seconds: Float64[np.ndarray, "times"],
        fps: Fraction,
        context_seconds: Float64[np.ndarray, "context"] | None = None,
    ) -> list[Poses]:
        """As `decode`, with rotations if the field has learnt them.

        A transformer decoder's poses depend on the others decoded with them; with `context_seconds`, only on those at
        these instants.
        """
        instants = self.vectors.instants(times_seconds)
        context = np.zeros(0) if context_seconds is None else context_seconds
        at_once = POSES_IN_CONTEXT_AT_ONCE if len(context) else POSES_AT_ONCE
        vectors = np.empty((len(latents), len(instants), self.vectors.num_features), dtype=np.float32)
        per_call = max(1, POSES_AT_ONCE // max(1, len(instants)))
        for start in range(0, len(latents), per_call):
            some = latents[start : start + per_call].float().to(self.device)
            for first in range(0, len(instants), at_once):
                times = slice(first, first + at_once)
                encoded = self.encode_times(np.concatenate((context, instants[times]))[None], fps)
                decoded = self.decode_vectors(some, encoded, fps, len(context))
                vectors[start : start + per_call, times] = decoded[:, len(context) :].cpu().numpy()
        return [self.vectors.decode(each, instants, times_seconds) for each in vectors]

    @torch.no_grad()
    def decode_vectors(
        self,
        latents: Float32[Tensor, "batch latent"],
        encoded: EncodedCoordinates,
        fps: Fraction,
        num_context: int = 0,
    ) -> Float32[Tensor, "batch times numbers"]:
        """Unstandardised pose vectors at encoded times (one row of times for each latent, or one for all).

        The first `num_context` are the context of a transformer decoder.
        """
        which = encoded.which.expand(len(latents), -1)
        rates = torch.full((len(latents),), float(fps), dtype=torch.float64, device=self.device)
        standardised = self.network.decode(latents, replace(encoded, which=which), rates, num_context)
        vectors: Tensor = self.scaling.invert(standardised.float())
        return vectors

    def contact_probabilities(
        self, latent: Float[Tensor, "latent"], times_seconds: Float64[np.ndarray, "times"], fps: Fraction
    ) -> Float32[np.ndarray, "times 2 2"] | None:
        """Contact probabilities of ankle and toe of left and right foot; None without a contact head."""
        if self.contacts is None:
            return None
        encoded = self.encode_times(times_seconds[None], fps)
        with torch.no_grad():
            logits = self.contacts(self.network.read(latent[None].float().to(self.device), encoded))
        return np.asarray(torch.sigmoid(logits)[0].cpu().numpy().reshape(-1, 2, 2))

    def as_motion_field(
        self, latent: Float[Tensor, "latent"], duration_seconds: float, fps: Fraction | None = None
    ) -> "LatentMotionField":
        """One latent's motion on [0, duration], at the framerate s = `fps` (default: the highest in training)."""
        return LatentMotionField(self, latent, duration_seconds, fps or self.max_training_fps)


@dataclass(frozen=True, eq=False)
class LatentMotionField:
    """A `motionkit.fields.motion_field.MotionField`: f_θ for one fixed z and s."""

    field: TrainedField
    latent: Float[Tensor, "latent"]
    end_seconds: float
    fps: Fraction
    start_seconds: float = 0.0

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton of the poses: the 22-joint layout, or the rig of learnt rotations."""
        return self.field.skeleton

    def at_fps(self, fps: Fraction) -> "LatentMotionField":
        """The same motion (the same z) at another framerate s."""
        return replace(self, fps=fps)

    def query(self, times_seconds: Float64[np.ndarray, "times"]) -> Poses:
        """Poses at any times in [0, end_seconds], each independent of the others; raises `ValueError` outside it."""
        check_times(self, times_seconds)
        context = None
        if self.field.config.decoder.kind == "transformer":
            context = np.linspace(0.0, self.end_seconds, CONTEXT_INSTANTS)
        return self.field.poses(self.latent[None], times_seconds, self.fps, context)[0]

    def contacts(self, times_seconds: Float64[np.ndarray, "times"]) -> Float32[np.ndarray, "times 2 2"] | None:
        """Contact probabilities of ankle and toe of left and right foot; None without a contact head."""
        check_times(self, times_seconds)
        return self.field.contact_probabilities(self.latent, times_seconds, self.fps)


STAGE_NAME = "field"


def save_field(folder: StageFolder, trained: TrainedField) -> None:
    """Write model.safetensors: network, scales, posteriors and the window table, with the settings in its header."""
    tensors = (
        prefixed("network", trained.network.state_dict())
        | prefixed("scaling", {"mean": trained.scaling.mean, "scale": trained.scaling.scale})
        | prefixed("posterior", {"mean": trained.posterior_mean, "log_variance": trained.posterior_log_variance})
        | vector_tensors(trained.vectors)
        | prefixed("windows", {name: torch.from_numpy(array) for name, array in trained.windows.arrays().items()})
    )
    if trained.contacts is not None:
        tensors |= prefixed("contacts", trained.contacts.state_dict())
    if trained.components is not None:
        tensors["components.mean"] = trained.components.mean
        tensors["components.directions"] = trained.components.directions
    description: dict[str, Any] = {
        "config": to_plain(trained.config),
        "store_fingerprint": trained.store_fingerprint,
    }
    save_tensors(folder.model_path, tensors, description)


def load_field(run: RunFolder | Path, device: str = "cpu") -> TrainedField:
    """Load a run's trained field; raises `CheckpointError` if it is missing or another model's."""
    folder = (run if isinstance(run, RunFolder) else RunFolder(run)).stage(STAGE_NAME)
    if not folder.model_path.is_file():
        folder.read_summary()
    tensors, description = load_tensors(folder.model_path)
    where = resolve_device(device)
    with rebuilding(folder.model_path, STAGE_NAME):
        return _rebuild(tensors, description, where)


def _rebuild(tensors: Mapping[str, Tensor], description: Mapping[str, Any], where: torch.device) -> TrainedField:
    config = from_plain(FieldConfig, description["config"])
    scaling = VectorScaling(tensors["scaling.mean"], tensors["scaling.scale"])
    network = FieldNetwork(config, len(scaling.mean), tensors.get("network.attention.codebook"))
    network.load_state_dict(unprefixed("network", tensors))
    contacts = None
    if of_contacts := unprefixed("contacts", tensors):
        contacts = ContactHead(network.num_read)
        contacts.load_state_dict(of_contacts)
        contacts = contacts.to(where).eval().requires_grad_(False)
    arrays = {name: tensor.numpy() for name, tensor in unprefixed("windows", tensors).items()}
    components = None
    if config.latents.layout == "local":
        components = PoseComponents(tensors["components.mean"], tensors["components.directions"])
    return TrainedField(
        network=network.to(where).eval().requires_grad_(False),
        scaling=scaling.to(where),
        components=components,
        posterior_mean=tensors["posterior.mean"],
        posterior_log_variance=tensors["posterior.log_variance"],
        windows=Windows(config.windows.max_duration_seconds, **arrays),
        store_fingerprint=str(description["store_fingerprint"]),
        vectors=vectors_of(config.pose_vectors, tensors),
        contacts=contacts,
    )
