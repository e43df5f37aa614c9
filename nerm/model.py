"""NeRM as a generative model: requests → conditions → latents (§3.2) → motion fields (§3.1)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from motionkit.core.errors import UsageError
from motionkit.core.files import sha256_of
from motionkit.core.shapes import Float, Float32, Float64
from motionkit.core.skeleton import Skeleton
from motionkit.fields.assembly import laid
from motionkit.fields.contact.bones import Bones
from motionkit.fields.motion_field import DerivedField, MotionField, Poses, at_fps
from motionkit.generate.constraints import KINDS, ConstraintKind
from motionkit.generate.models import GenerationRequest, SamplingOptions, check_constraints
from motionkit.training.devices import resolve_device
from motionkit.training.networks import Conditions
from motionkit.training.run import RunError, RunFolder
from motionkit.training.text import TextEncoder, load_same_encoder
from nerm.constraints import sample_constrained
from nerm.denoiser import TrainedDenoiser, load_denoiser, unit_rows
from nerm.field import TrainedField, load_field
from nerm.recipes import row_name

BONE_SAMPLES = 200
NO_TEXTS = "this model was trained without texts: ask for an action, or for unconditional motions"


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

    @cached_property
    def text_encoder(self) -> TextEncoder:
        """The encoder it was trained with, loaded on first use.

        Raises `UsageError` if it was trained without texts, `RunError` if the encoder's weights have changed.
        """
        if not self.denoiser.text_fingerprint:
            raise UsageError(NO_TEXTS)
        return load_same_encoder(self.denoiser.text_encoder, self.denoiser.text_fingerprint, "the model")

    def generate(
        self,
        requests: Sequence[GenerationRequest],
        *,
        seed: int,
        sampling: SamplingOptions = SamplingOptions(),
        first: int = 0,
    ) -> list[MotionField]:
        """One field per request, in order; field i depends on (seed, `first` + i) and request i alone.

        Raises `UsageError` for a duration outside (0, l_max], an unknown action, a text without an action if it was
        trained without texts, unsupported sampling options, or constraints that it cannot follow.
        """
        if not requests:
            return []
        for request in requests:
            self.check(request, sampling)
        durations = self._durations(requests, seed, first)
        texts = [request.text if self._uses_text(request) else "" for request in requests]
        actions = ["" if text else request.action for text, request in zip(texts, requests, strict=True)]
        conditions = Conditions.zero_masked(
            text=torch.from_numpy(self._embed(texts)),
            action=torch.tensor([self.denoiser.layout.action_index(action) for action in actions]),
            duration=torch.tensor(durations, dtype=torch.float32) / self.max_duration_seconds,
        )
        if not any(request.constraints for request in requests):
            latents = self.denoiser.sample(conditions, seed=seed, sampling=sampling, first=first)
            return [self.field.as_motion_field(*drawn) for drawn in zip(latents, durations, strict=True)]
        # One by one, so that a motion doesn't depend on the batch.
        motions: list[MotionField] = []
        for row, request in enumerate(requests):
            own = conditions.rows(slice(row, row + 1))
            if not request.constraints:
                latent = self.denoiser.sample(own, seed=seed, sampling=sampling, first=first + row)[0]
                motions.append(self.field.as_motion_field(latent, durations[row]))
                continue
            held = sample_constrained(
                *(self.denoiser, self.field, own, request.constraints),
                seed=seed,
                number=first + row,
                sampling=sampling,
            )
            motion: MotionField = self.field.as_motion_field(held.latent, durations[row])
            if held.bones is not None:
                motion = _with_lengths(motion, held.bones.numpy())
            yaw, x, z = held.place.tolist()
            motions.append(laid(motion, yaw, (x, z)))
        return motions

    @property
    def constraint_kinds(self) -> frozenset[ConstraintKind]:
        """All kinds if the field's joints are a differentiable function of the latent at each instant; else none."""
        return KINDS if self.field.has_joints else frozenset()

    def check(self, request: GenerationRequest, sampling: SamplingOptions = SamplingOptions()) -> None:
        """Raise `UsageError` for a duration outside (0, l_max], an unknown action, a text if it was trained without
        texts, or unsupported sampling options."""
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

    def _durations(self, requests: Sequence[GenerationRequest], seed: int, first: int) -> list[float]:
        """Seconds of each request, drawn from the training windows' if the request has none."""
        drawn = self.denoiser.draw_durations(len(requests), seed=seed, first=first) * self.max_duration_seconds
        return [
            float(own) if request.duration_seconds is None else float(request.duration_seconds)
            for request, own in zip(requests, drawn, strict=True)
        ]

    def _embed(self, texts: Sequence[str]) -> Float32[np.ndarray, "texts dimension"]:
        """Unit-length embeddings, zeros for empty texts; each distinct text is encoded once."""
        rows = np.zeros((len(texts), self.denoiser.layout.text_dimension), dtype=np.float32)
        distinct = list(dict.fromkeys(text for text in texts if text))
        if distinct:
            embedded = dict(zip(distinct, unit_rows(self.text_encoder.encode(distinct)), strict=True))
            for row, text in enumerate(texts):
                if text:
                    rows[row] = embedded[text]
        return rows


def load(run: Path) -> NermModel:
    """Load a run's field and denoiser, onto a GPU if there is one.

    Raises `RunError` if a stage is missing, or if the field was trained again after the denoiser.
    """
    folder = RunFolder(run)
    device = resolve_device("auto")
    denoiser, field = load_denoiser(folder, device), load_field(folder, str(device))
    field_path = folder.stage("field").model_path
    if sha256_of(field_path) != denoiser.field_sha256:
        raise RunError(
            f"{field_path} is not the field whose latents the denoiser of {run} generates: train the denoiser again "
            f"(motionkit train --stage denoiser --run {run.name} --overwrite)"
        )
    return NermModel(field, denoiser, row_name(folder, field.config, denoiser.config))


def _with_lengths(field: MotionField, lengths: Float[np.ndarray, "bones"]) -> MotionField:
    """A motion with these bone lengths, metres, from the second joint on.

    Unchanged if it has rotations: its bones are then its skeleton's.
    """
    poses = field.query(np.linspace(field.start_seconds, field.end_seconds, BONE_SAMPLES))
    if poses.local_rotations is not None:
        return field
    bones = Bones.of(poses.joint_positions, field.skeleton)
    own = np.linalg.norm(bones.offsets[1:], axis=-1, keepdims=True)
    offsets = bones.offsets.copy()
    offsets[1:] *= np.where(own > 0, lengths[:, None] / np.where(own > 0, own, 1.0), 1.0)
    return _on_bones(field, replace(bones, offsets=offsets))


def _on_bones(field: MotionField, bones: Bones) -> DerivedField:
    def on_bones(times: Float64[np.ndarray, "times"]) -> Poses:
        poses = field.query(times)
        return Poses(bones.applied(poses.joint_positions), None, poses.root_translation)

    return DerivedField(field, on_bones, lambda fps: _on_bones(at_fps(field, fps), bones))
