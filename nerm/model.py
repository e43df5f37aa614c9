"""Trained NeRM: the motion field f_θ(t, z, s) → pose (§3.1), the sampler of latents (§3.2), and both as one model."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from motionkit.core.errors import MissingExtraError, UsageError
from motionkit.core.files import sha256_of
from motionkit.core.shapes import Float, Float32, Float64
from motionkit.core.skeleton import Skeleton
from motionkit.core.timegrid import normalise_seconds
from motionkit.data.windows import Windows
from motionkit.features.convention import PoseVectors
from motionkit.features.field import FIELD_VECTORS
from motionkit.fields.assembly import laid
from motionkit.fields.contact.bones import Bones
from motionkit.fields.motion_field import DerivedField, MotionField, Poses, at_fps, check_times
from motionkit.generate.constraints import KINDS, ConstraintKind
from motionkit.generate.models import GenerationRequest, SamplingOptions, check_constraints
from motionkit.training.config import from_plain, to_plain
from motionkit.training.loop import (
    load_tensors,
    prefixed,
    rebuilding,
    save_tensors,
    seeded_initialisation,
    step_generator,
    unprefixed,
)
from motionkit.training.networks import (
    Adjust,
    Conditions,
    ConditionSizes,
    VectorScaling,
    cumulative_alphas,
    guided,
    predicted_noise,
    resolve_device,
    sample,
    sampling_steps,
    vector_tensors,
    vectors_of,
)
from motionkit.training.run import RunError, RunFolder, StageFolder
from motionkit.training.text import TextEncoder, load_same_encoder
from nerm.constraints import JointsOf, sample_constrained
from nerm.latents import LatentSpace, LinearModel, LocalLatents, in_use
from nerm.network import Denoiser, EncodedCoordinates, FieldNetwork
from nerm.recipes import DenoiserConfig, FieldConfig, row_name

GRIDS_KEPT = 16
POSES_AT_ONCE = 8_192
# Context poses of a transformer decoder (docs/deviations.md).
CONTEXT_INSTANTS = 64
POSES_IN_CONTEXT_AT_ONCE = 1_024
SAMPLES_PER_BATCH = 256
BONE_SAMPLES = 200
NO_TEXTS = "this model was trained without texts: ask for an action, or for unconditional motions"


@dataclass(frozen=True, eq=False)
class TrainedField:
    """f_θ with its scales and the posteriors N(μ_i, Σ_i) of all training windows.

    `network` is in evaluation mode without gradients; `linear_model` is the one that initialises local latents (None
    for the global layout); `vectors` is the pose vector convention.
    """

    network: FieldNetwork
    scaling: VectorScaling
    linear_model: LinearModel | None
    posterior_mean: Float32[Tensor, "windows latent"]
    posterior_log_variance: Float32[Tensor, "windows latent"]
    windows: Windows
    store_fingerprint: str
    vectors: PoseVectors = FIELD_VECTORS

    @property
    def config(self) -> FieldConfig:
        """The training settings."""
        return self.network.config

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton of decoded poses; its first 22 joints are the 22-joint layout's."""
        return self.vectors.skeleton

    @property
    def max_duration_seconds(self) -> float:
        """l_max: the span of [−1, 1]."""
        return self.config.windows.max_duration_seconds

    @property
    def max_training_fps(self) -> Fraction:
        """Highest framerate in training: the fastest window's, or that of fixed-framerate training."""
        fixed = self.config.clips.fixed_framerate
        rates = zip(self.windows.fps_numerator.tolist(), self.windows.fps_denominator.tolist(), strict=True)
        return max(Fraction(*rate) for rate in rates) if fixed is None else fixed

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

    def decode_vectors(
        self,
        latents: Float32[Tensor, "batch latent"],
        encoded: EncodedCoordinates,
        fps: Fraction,
        num_context: int = 0,
    ) -> Float32[Tensor, "batch times numbers"]:
        """Pose vectors in their own units at encoded times (one row of times for each latent, or one for all).

        The first `num_context` are the context of a transformer decoder.
        """
        which = encoded.which.expand(len(latents), -1)
        rates = torch.full((len(latents),), float(fps), dtype=torch.float64, device=self.device)
        standardised = self.network.decode(latents, replace(encoded, which=which), rates, num_context)
        vectors: Tensor = self.scaling.invert(standardised.float())
        return vectors

    @torch.no_grad()
    def poses(
        self,
        latent: Float[Tensor, "latent"],
        times_seconds: Float64[np.ndarray, "times"],
        fps: Fraction,
        context_seconds: Float64[np.ndarray, "context"] | None = None,
    ) -> Poses:
        """A latent's poses in its window's frame, metres, with rotations if the field has learnt them.

        Times are seconds from the window's start; `fps` is the framerate s. At most `POSES_AT_ONCE` poses are decoded
        at once, to bound memory. A transformer decoder's poses depend on the others decoded with them; with
        `context_seconds`, only on those at these instants.
        """
        instants, latents = self.vectors.instants(times_seconds), latent[None].float().to(self.device)
        context = np.zeros(0) if context_seconds is None else context_seconds
        at_once = POSES_IN_CONTEXT_AT_ONCE if len(context) else POSES_AT_ONCE
        vectors = np.empty((len(instants), self.vectors.num_features), dtype=np.float32)
        for first in range(0, len(instants), at_once):
            times = slice(first, first + at_once)
            encoded = self.encode_times(np.concatenate((context, instants[times]))[None], fps)
            vectors[times] = self.decode_vectors(latents, encoded, fps, len(context))[0, len(context) :].cpu().numpy()
        return self.vectors.decode(vectors, instants, times_seconds)

    def joints_at(self, times_seconds: Float64[np.ndarray, "times"]) -> JointsOf:
        """Latent → joints at these times, a differentiable function; for a field of `field` vectors."""
        encoded = self.encode_times(times_seconds[None], self.max_training_fps)

        def joints(latent: Float32[Tensor, "latent"]) -> Float32[Tensor, "times joints 3"]:
            vectors = self.decode_vectors(latent[None].to(self.device), encoded, self.max_training_fps)[0]
            offsets = vectors.reshape(len(vectors), -1, 3)
            return torch.cat((offsets[:, :1], offsets[:, 1:] + offsets[:, :1]), dim=1).to("cpu")

        return joints

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
        return self.field.poses(self.latent, times_seconds, self.fps, context)


def save_field(folder: StageFolder, trained: TrainedField) -> None:
    """Write model.safetensors: network, scales, posteriors and the window table, with the settings in its header."""
    tensors = (
        prefixed("network", trained.network.state_dict())
        | prefixed("scaling", {"mean": trained.scaling.mean, "scale": trained.scaling.scale})
        | prefixed("posterior", {"mean": trained.posterior_mean, "log_variance": trained.posterior_log_variance})
        | vector_tensors(trained.vectors)
        | prefixed("windows", {name: torch.from_numpy(array) for name, array in trained.windows.arrays().items()})
    )
    if (linear := trained.linear_model) is not None:
        tensors |= prefixed("components", {"mean": linear.mean, "directions": linear.directions})
    description = {"config": to_plain(trained.config), "store_fingerprint": trained.store_fingerprint}
    save_tensors(folder.model_path, tensors, description)


def without_training_windows(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """A saved field's tensors with a single training window: the fastest, whose framerate generation needs."""
    fastest = int((tensors["windows.fps_numerator"] / tensors["windows.fps_denominator"]).argmax())
    of_windows = ("windows.", "posterior.")
    return {name: t[fastest : fastest + 1] if name.startswith(of_windows) else t for name, t in tensors.items()}


def load_field(run: RunFolder | Path, device: str | torch.device = "cpu") -> TrainedField:
    """Load a run's trained field; raises `CheckpointError` if it is missing or another model's."""
    folder = (run if isinstance(run, RunFolder) else RunFolder(run)).stage("field")
    if not folder.model_path.is_file():
        folder.read_summary()
    tensors, description = load_tensors(folder.model_path)
    where = resolve_device(str(device))
    with rebuilding(folder.model_path, "field"):
        config = from_plain(FieldConfig, description["config"])
        scaling = VectorScaling(tensors["scaling.mean"], tensors["scaling.scale"])
        network = FieldNetwork(config, len(scaling.mean), tensors.get("network.attention.codebook"))
        network.load_state_dict(unprefixed("network", tensors))
        linear = None
        if network.local is not None:
            components = tensors["components.mean"], tensors["components.directions"]
            linear = LinearModel(network.local, scaling, *components)
        arrays = {name: tensor.numpy() for name, tensor in unprefixed("windows", tensors).items()}
        return TrainedField(
            network=network.to(where).eval().requires_grad_(False),
            scaling=scaling.to(where),
            linear_model=linear,
            posterior_mean=tensors["posterior.mean"],
            posterior_log_variance=tensors["posterior.log_variance"],
            windows=Windows(config.windows.max_duration_seconds, **arrays),
            store_fingerprint=str(description["store_fingerprint"]),
            vectors=vectors_of(config.pose_vectors, tensors),
        )


@dataclass(frozen=True, eq=False)
class TrainedDenoiser:
    """ε_φ with everything needed to sample latents.

    `denoiser` holds the averaged weights; `space` is its latent space; `durations` are those of the training windows in
    units of l_max; `text_encoder` and `text_fingerprint` identify the encoder it was trained with (empty without
    texts), and `field_sha256` the field whose latents it generates.
    """

    config: DenoiserConfig
    denoiser: Denoiser
    space: LatentSpace
    layout: ConditionSizes
    durations: Float32[Tensor, "windows"]
    text_encoder: str
    text_fingerprint: str
    field_sha256: str

    def sample(
        self,
        conditions: Conditions,
        *,
        seed: int,
        sampling: SamplingOptions = SamplingOptions(),
        first: int = 0,
        adjust: Adjust | None = None,
    ) -> Float32[Tensor, "batch latent"]:
        """One latent of the field per row of `conditions`; `adjust` may change each step's prediction.

        Row i depends on (seed, `first` + i) alone, not on the other rows (up to rounding of batched sums). Numbers that
        a motion of the row's duration does not use are the training mean.
        """
        config = self.with_sampling(sampling)
        generators = [step_generator(seed, "generate", first + row) for row in range(len(conditions.action))]
        batches = [slice(start, start + SAMPLES_PER_BATCH) for start in range(0, len(generators), SAMPLES_PER_BATCH)]
        latents = torch.cat(
            [self._sample_batch(config, conditions.rows(rows), generators[rows], adjust) for rows in batches]
        )
        if not torch.isfinite(latents).all():
            scale = config.diffusion.guidance_scale
            raise UsageError(f"sampling diverged: a guidance scale of {scale:g} is too large")
        return latents

    def with_sampling(self, sampling: SamplingOptions) -> DenoiserConfig:
        """The configuration with these sampling options; raises `UsageError` for unsupported ones."""
        diffusion = self.config.diffusion.adjusted(sampling.sampler, sampling.steps, sampling.guidance_scale)
        return replace(self.config, diffusion=diffusion)

    @torch.no_grad()
    def _sample_batch(
        self,
        config: DenoiserConfig,
        conditions: Conditions,
        generators: Sequence[torch.Generator],
        adjust: Adjust | None,
    ) -> Float32[Tensor, "batch latent"]:
        def draw_noise() -> Float64[Tensor, "batch latent"]:
            drawn = [torch.randn(len(self.space.mean), generator=g, dtype=torch.float64) for g in generators]
            return torch.stack(drawn)

        device = self.denoiser.positions.device
        diffusion = config.diffusion
        scale = conditions.guidance(diffusion.guidance_scale)
        embedded = self.denoiser.embed(conditions.paired(conditions.unconditional(), scale).to(device))
        alphas, steps = cumulative_alphas(diffusion), sampling_steps(diffusion)

        def predict_noise(latents: Tensor, steps: Tensor) -> Tensor:
            noisy = latents.to(device, torch.float32)
            output = guided(self.denoiser, noisy, steps.to(device), embedded, scale)
            alpha = float(alphas[int(steps[0])])
            return predicted_noise(diffusion.prediction, output.to("cpu", torch.float64), latents, alpha)

        fresh = draw_noise if diffusion.sampler == "ddpm" else None
        latents = sample(predict_noise, draw_noise(), alphas, steps, draw_noise=fresh, adjust=adjust)
        return self.space.restore(latents.to(torch.float32) * self.used(conditions))

    def used(self, conditions: Conditions) -> Tensor:
        """Mask [batch, latent] of the numbers that motions of these durations use."""
        return in_use(self.denoiser.first_read.to("cpu"), conditions.duration)

    def draw_durations(self, count: int, *, seed: int, first: int = 0) -> Float32[Tensor, "count"]:
        """Sample durations of training windows, in units of l_max; number i depends on (seed, first + i) alone."""
        generators = [step_generator(seed, "duration", first + i) for i in range(count)]
        rows = [torch.randint(len(self.durations), (), generator=generator) for generator in generators]
        return self.durations[torch.stack(rows)] if rows else self.durations[:0]


def save_denoiser(folder: StageFolder, trained: TrainedDenoiser) -> None:
    """Write RUN/denoiser/model.safetensors."""
    tensors = prefixed("denoiser", trained.denoiser.state_dict()) | {
        "latent_mean": trained.space.mean,
        "latent_deviation": trained.space.deviation,
        "durations": trained.durations,
    }
    description: dict[str, Any] = {
        "config": to_plain(trained.config),
        "banks": None if trained.space.banks is None else to_plain(trained.space.banks),
        "text_dimension": trained.layout.text_dimension,
        "actions": list(trained.layout.actions),
        "text_encoder": trained.text_encoder,
        "text_fingerprint": trained.text_fingerprint,
        "field_sha256": trained.field_sha256,
    }
    save_tensors(folder.model_path, tensors, description)


def load_denoiser(run: RunFolder, device: str | torch.device = "cpu") -> TrainedDenoiser:
    """Read RUN/denoiser/model.safetensors; the network goes to `device`.

    Raises `RunError` if the stage was not trained to its end, `CheckpointError` for a damaged file.
    """
    folder = run.stage("denoiser")
    folder.read_summary()
    tensors, description = load_tensors(folder.model_path)
    with rebuilding(folder.model_path, "denoiser"):
        config = from_plain(DenoiserConfig, description["config"])
        layout = ConditionSizes(int(description["text_dimension"]), tuple(description["actions"]))
        banks = None if description["banks"] is None else from_plain(LocalLatents, description["banks"])
        with seeded_initialisation(0, "denoiser"):
            denoiser = Denoiser(config.network, tensors["denoiser.first_read"], layout)
        denoiser.load_state_dict(unprefixed("denoiser", tensors))
        return TrainedDenoiser(
            config=config,
            denoiser=denoiser.to(device).eval().requires_grad_(False),
            space=LatentSpace(banks, tensors["latent_mean"], tensors["latent_deviation"]),
            layout=layout,
            durations=tensors["durations"],
            text_encoder=str(description["text_encoder"]),
            text_fingerprint=str(description["text_fingerprint"]),
            field_sha256=str(description["field_sha256"]),
        )


@dataclass(frozen=True, eq=False)
class NermModel:
    """A `motionkit.generate.models.GenerativeModel`: a trained field and a denoiser; `name` is its row in tables."""

    field: TrainedField
    denoiser: TrainedDenoiser
    name: str = "NeRM"

    @property
    def skeleton(self) -> Skeleton:
        """The field's skeleton: the 22-joint layout, or SMPL's joints if it has learnt rotations."""
        return self.field.skeleton

    @property
    def max_training_fps(self) -> Fraction:
        """Highest framerate in its training data; detail above it is invented."""
        return self.field.max_training_fps

    @property
    def max_duration_seconds(self) -> float:
        """l_max: the longest motion that one latent describes."""
        return self.field.max_duration_seconds

    @property
    def constraint_kinds(self) -> frozenset[ConstraintKind]:
        """All kinds if joints are a differentiable function of z at each instant (`field` vectors, MLP); else none."""
        config = self.field.config
        return KINDS if config.pose_vectors == "field" and config.decoder.kind == "mlp" else frozenset()

    def text_encoder(self) -> TextEncoder | None:
        """The encoder it was trained with, loaded on first use; None if it was trained without texts.

        Raises `UsageError` if the encoder is not installed, and `RunError` if its weights have changed.
        """
        return self._text_encoder if self.denoiser.text_fingerprint else None

    @cached_property
    def _text_encoder(self) -> TextEncoder:
        try:
            return load_same_encoder(self.denoiser.text_encoder, self.denoiser.text_fingerprint, "the model")
        except MissingExtraError as error:
            actions = self.denoiser.layout.actions
            instead = (
                f"an action, such as {'walk' if 'walk' in actions else actions[0]}," if actions else "no condition"
            )
            raise UsageError(f"a text is read by an encoder: {error}; {instead} needs none") from None

    def generate(
        self,
        requests: Sequence[GenerationRequest],
        *,
        seed: int,
        sampling: SamplingOptions = SamplingOptions(),
        first: int = 0,
    ) -> list[MotionField]:
        """One field per request, in order; field i depends on (seed, `first` + i) and request i alone.

        Raises `UsageError` for what `check` refuses.
        """
        if not requests:
            return []
        for request in requests:
            self.check(request, sampling)
        drawn = self.denoiser.draw_durations(len(requests), seed=seed, first=first) * self.max_duration_seconds
        durations = [
            float(own if request.duration_seconds is None else request.duration_seconds)
            for request, own in zip(requests, drawn, strict=True)
        ]
        texts = [request.text if self._uses_text(request) else "" for request in requests]
        actions = ["" if text else request.action for text, request in zip(texts, requests, strict=True)]
        conditions = Conditions.zero_masked(
            text=torch.from_numpy(self._embed(texts)),
            action=torch.tensor([self.denoiser.layout.action_index(action) for action in actions]),
            duration=torch.tensor(durations, dtype=torch.float32) / self.max_duration_seconds,
        )
        if not any(request.constraints for request in requests):
            latents = self.denoiser.sample(conditions, seed=seed, sampling=sampling, first=first)
            return [self.field.as_motion_field(*each) for each in zip(latents, durations, strict=True)]
        # One by one, so that a motion doesn't depend on the batch.
        motions: list[MotionField] = []
        for row, request in enumerate(requests):
            own = conditions.rows(slice(row, row + 1))
            draw = partial(self.denoiser.sample, own, seed=seed, sampling=sampling, first=first + row)
            if not request.constraints:
                motions.append(self.field.as_motion_field(draw()[0], durations[row]))
                continue
            latent, place, bones = sample_constrained(
                request.constraints,
                float(own.duration[0]) * self.max_duration_seconds,
                sample=draw,
                num_steps=self.denoiser.with_sampling(sampling).diffusion.sampling_steps,
                space=self.denoiser.space,
                used=self.denoiser.used(own)[0],
                joints_at=self.field.joints_at,
            )
            motion: MotionField = self.field.as_motion_field(latent, durations[row])
            if bones is not None:
                motion = _with_lengths(motion, bones.numpy())
            yaw, x, z = place.tolist()
            motions.append(laid(motion, yaw, (x, z)))
        return motions

    def check(self, request: GenerationRequest, sampling: SamplingOptions = SamplingOptions()) -> None:
        """Raise `UsageError` for a duration outside (0, l_max], an unknown action, a text (without an action) if it
        was trained without texts, constraints that it cannot follow, or unsupported sampling options."""
        self.denoiser.with_sampling(sampling)
        check_constraints(self, request)
        seconds = request.duration_seconds
        if seconds is not None and not 0 < seconds <= self.max_duration_seconds + 1e-9:
            raise UsageError(
                f"this model generates more than 0 and up to {self.max_duration_seconds:g} s (its longest training "
                f"window), not {seconds:g} s"
            )
        if not self._uses_text(request):
            self.denoiser.layout.action_index(request.action)
        elif not self.denoiser.text_fingerprint:
            raise UsageError(NO_TEXTS)

    def _uses_text(self, request: GenerationRequest) -> bool:
        return bool(request.text) and (bool(self.denoiser.text_fingerprint) or not request.action)

    def _embed(self, texts: Sequence[str]) -> Float32[np.ndarray, "texts dimension"]:
        """Unit-length embeddings, zeros for empty texts; each distinct text is encoded once."""
        embedded = {"": np.zeros(self.denoiser.layout.text_dimension, dtype=np.float32)}
        if distinct := list(dict.fromkeys(text for text in texts if text)):
            embedded |= zip(distinct, unit_rows(self._text_encoder.encode(distinct)), strict=True)
        return np.stack([embedded[text] for text in texts])


def unit_rows(embeddings: Float32[np.ndarray, "texts dimension"]) -> Float32[np.ndarray, "texts dimension"]:
    """Embeddings scaled to length 1; rows of zeros stay zeros."""
    lengths = np.linalg.norm(embeddings, axis=1, keepdims=True)
    return np.asarray(embeddings / np.where(lengths > 0, lengths, 1.0), dtype=np.float32)


def load(run: Path) -> NermModel:
    """Load a run's field and denoiser, onto a GPU if there is one.

    Raises `RunError` if a stage is missing, or if the field was trained again after the denoiser.
    """
    folder, device = RunFolder(run), resolve_device("auto")
    denoiser, field = load_denoiser(folder, device), load_field(folder, device)
    field_path = folder.stage("field").model_path
    if sha256_of(field_path) != denoiser.field_sha256:
        raise RunError(
            f"{field_path} is not the field whose latents the denoiser of {run} generates: train the denoiser again "
            f"(motionkit train --stage denoiser --run {run.name} --overwrite)"
        )
    return NermModel(field, denoiser, row_name(folder, field.config, denoiser.config))


def _with_lengths(motion: MotionField, lengths: Float[np.ndarray, "bones"]) -> DerivedField:
    """A motion with these bone lengths, metres, from the second joint on."""
    poses = motion.query(np.linspace(motion.start_seconds, motion.end_seconds, BONE_SAMPLES))
    bones = Bones.of(poses.joint_positions, motion.skeleton)
    own = np.linalg.norm(bones.offsets[1:], axis=-1, keepdims=True)
    bones.offsets[1:] *= np.where(own > 0, lengths[:, None] / np.where(own > 0, own, 1.0), 1.0)
    return _on_bones(motion, bones)


def _on_bones(motion: MotionField, bones: Bones) -> DerivedField:
    def on_bones(times: Float64[np.ndarray, "times"]) -> Poses:
        poses = motion.query(times)
        return Poses(bones.applied(poses.joint_positions), None, poses.root_translation)

    return DerivedField(motion, on_bones, lambda fps: _on_bones(at_fps(motion, fps), bones))
