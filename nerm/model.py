"""NeRM as a generative model: requests → conditions → latents (§3.2) → motion fields (§3.1), also under constraints.

Constraints (docs/generation.md) are met by guided diffusion steps, then optimisation of the latent. At some steps the
predicted clean latent is optimised to meet them, with a normal prior around the prediction whose deviation is the
step's remaining noise (Song et al. 2024, hard data consistency). The steps that follow make it a plausible motion. At
the end the sampled latent is optimised for longer, with a cost for sliding feet, so that footsteps carry the body to
its targets. Costs are differentiable functions of the latent and of the motion's place in the world: yaw about +Y
(radians), then a translation on the floor (x, z).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from motionkit.core.errors import UsageError
from motionkit.core.files import sha256_of
from motionkit.core.shapes import Float, Float32, Float64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError
from motionkit.features.convention import PoseVectors
from motionkit.features.layout import SMPL22_LAYOUT
from motionkit.features.rotations import RotationVectors
from motionkit.fields.assembly import laid
from motionkit.fields.contact.bones import Bones, Legs, legs_of
from motionkit.fields.contact.detection import find_contacts, ground_of
from motionkit.fields.motion_field import DerivedField, MotionField, Poses, at_fps
from motionkit.generate.constraints import KINDS, Constraint, ConstraintKind
from motionkit.generate.models import GenerationRequest, SamplingOptions, check_constraints
from motionkit.training.loop import resolve_device
from motionkit.training.networks import Conditions
from motionkit.training.run import RunError, RunFolder
from motionkit.training.text import TextEncoder, load_same_encoder
from nerm.denoiser import TrainedDenoiser, load_denoiser, unit_rows
from nerm.field import TrainedField, load_field
from nerm.latents import in_use
from nerm.network import EncodedCoordinates
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


# Metres of position error that cost as much as a radian of heading error.
TURN_METRES = 0.3
INSTANTS_PER_SECOND = 60.0
# Speed of a foot in contact, m/s, and independent samples per second; deviation of bone lengths, m.
FEET_DEVIATION, SAMPLES_PER_SECOND = 0.1, 3.0
BONE_DEVIATION, MEDIAN_SAMPLES = 0.003, 100


JointsOf = Callable[[Float32[Tensor, "latent"]], Float32[Tensor, "instants joints 3"]]
"""Latent → joints of its motion at fixed instants, metres, in the window's frame."""


@dataclass(frozen=True, eq=False)
class JointsAt:
    """The joints of a latent's motion at fixed instants, in the window's frame."""

    field: TrainedField
    seconds: Float64[np.ndarray, "instants"]

    @cached_property
    def _encoded(self) -> EncodedCoordinates:
        return self.field.encode_times(self.seconds[None], self.field.max_training_fps)

    def __call__(self, latent: Float32[Tensor, "latent"]) -> Float32[Tensor, "instants joints 3"]:
        """Metres, on the CPU."""
        trained = self.field
        fps = torch.full((1,), float(trained.max_training_fps), dtype=torch.float64, device=trained.device)
        standardised = trained.network.decode(latent[None].to(trained.device), self._encoded, fps)[0]
        return joints_of(trained.scaling.invert(standardised.float()), trained.vectors).to("cpu")


@dataclass(frozen=True, eq=False)
class ConstraintCost:
    """The cost of constraints: squared position and heading errors in units of their deviations."""

    joints: JointsOf
    constraints: tuple[Constraint, ...]

    @property
    def places_motion(self) -> bool:
        """Whether the constraints determine the motion's place in the world; else it stays in its window's frame."""
        return any(each.places_motion for each in self.constraints)

    def cost(
        self,
        latent: Float32[Tensor, "latent"],
        place: Float32[Tensor, "3"],
        bones: Float32[Tensor, "bones"] | None = None,
    ) -> Float32[Tensor, ""]:
        """The sum over constraints, instants and joints; with `bones` also of the poses' bone-length errors."""
        total = latent.new_zeros(())
        for joints, target in zip(self._each(self.joints(latent)), self._targets, strict=True):
            ahead = _facing(joints)
            if target.constraint.frame == "world":
                here = _turned(joints, torch.cos(place[0]), torch.sin(place[0]))
                here = here + torch.stack((place[1], torch.zeros_like(place[1]), place[2]))
            else:
                under_root = joints[:, :1] * joints.new_tensor([1.0, 0.0, 1.0])
                here = _turned(joints - under_root, ahead[:, 1:], -ahead[:, :1])
            if bones is not None and target.constraint.kind != "path":
                total = total + 0.5 * (_bones(joints) - bones).square().sum() / BONE_DEVIATION**2
            apart = torch.where(target.known, here[:, target.constraint.joint_indices] - target.positions, 0.0)
            # The chord of the angle is continuous at half a turn, unlike the angle.
            yaw = torch.atan2(ahead[:, 0], ahead[:, 1]) + place[0] - target.heading
            turned = torch.where(target.faces, 2.0 * torch.sin(0.5 * yaw), 0.0)
            squares = apart.square().sum() + TURN_METRES**2 * turned.square().sum()
            total = total + 0.5 * squares / target.constraint.deviation**2
        return total

    @torch.no_grad()
    def place(self, latent: Float32[Tensor, "latent"]) -> Float32[Tensor, "3"]:
        """The place in the world that best meets the constraints (least squares, ignoring headings)."""
        if not self.places_motion:
            return torch.zeros(3)
        mine, given = [], []
        for joints, target in zip(self._each(self.joints(latent)), self._targets, strict=True):
            if target.constraint.places_motion:
                horizontal = target.known[..., 0] & target.known[..., 2]
                mine.append(joints[:, target.constraint.joint_indices][horizontal][:, [0, 2]])
                given.append(target.positions[horizontal][:, [0, 2]])
        a, b = torch.cat(mine), torch.cat(given)
        a_mean, b_mean = a.mean(dim=0), b.mean(dim=0)
        (ax, az), (bx, bz) = (a - a_mean).T, (b - b_mean).T
        yaw = torch.atan2((bx * az - bz * ax).sum(), (bx * ax + bz * az).sum())
        cosine, sine = torch.cos(yaw), torch.sin(yaw)
        turned = torch.stack((cosine * a_mean[0] + sine * a_mean[1], cosine * a_mean[1] - sine * a_mean[0]))
        return torch.cat((yaw[None], b_mean - turned))

    @cached_property
    def bones(self) -> Float32[Tensor, "bones"] | None:
        """Mean bone lengths of the full-pose constraints; None without any."""
        whole = [each.positions for each in self._targets if each.constraint.joints == SMPL22.joint_names]
        return _bones(torch.cat(whole)).mean(dim=0) if whole else None

    def _each(self, joints: Float32[Tensor, "instants joints 3"]) -> Sequence[Float32[Tensor, "own joints 3"]]:
        return torch.split(joints[:, : SMPL22.num_joints], [len(each.seconds) for each in self.constraints])

    @cached_property
    def _targets(self) -> list["_Target"]:
        return [_Target.of(each) for each in self.constraints]


@dataclass(frozen=True, eq=False)
class _Target:
    """A constraint as tensors, zeros where it is free."""

    constraint: Constraint
    positions: Float32[Tensor, "instants joints 3"]
    known: Tensor
    heading: Float32[Tensor, "instants"]
    faces: Tensor

    @classmethod
    def of(cls, constraint: Constraint) -> "_Target":
        positions, heading = (torch.from_numpy(each).float() for each in (constraint.positions, constraint.heading))
        known, faces = ~positions.isnan(), ~heading.isnan()
        return cls(constraint, positions.nan_to_num(0.0), known, heading.nan_to_num(0.0), faces)


@dataclass(frozen=True, eq=False)
class FootSliding:
    """The cost of feet that slide while in contact.

    Contacts are detected in one motion (`with_contacts_of`) and assumed for those near it. This makes the gait agree
    with a given path.
    """

    joints: JointsOf
    legs: Legs
    contact: Float32[Tensor, "steps feet 1"]

    @torch.no_grad()
    def with_contacts_of(self, latent: Float32[Tensor, "latent"]) -> "FootSliding":
        """The same, with the contacts of a latent's motion."""
        paths = self.legs.foot_paths(self.joints(latent).numpy()).astype(np.float64)
        contacts = find_contacts(paths, INSTANTS_PER_SECOND, ground_of(paths, INSTANTS_PER_SECOND))
        hold = np.minimum(contacts.hold[1:], contacts.hold[:-1])[..., None]
        return replace(self, contact=torch.from_numpy(hold).float())

    def cost(self, latent: Float32[Tensor, "latent"]) -> Float32[Tensor, ""]:
        """Squared horizontal speeds of ankles and toes in contact, in units of `FEET_DEVIATION`."""
        joints = self.joints(latent)
        paths = joints[:, list(self.legs.feet)].reshape(len(joints), 2, 2, 3)
        velocity = (paths[1:] - paths[:-1]) * INSTANTS_PER_SECOND
        squares = self.contact * (velocity[..., 0].square() + velocity[..., 2].square())
        total: Tensor = 0.5 * SAMPLES_PER_SECOND / INSTANTS_PER_SECOND * squares.sum() / FEET_DEVIATION**2
        return total


def foot_sliding(trained: TrainedField, duration_seconds: float) -> FootSliding | None:
    """The cost for motions of this duration; None for a skeleton without known legs, or a single frame."""
    count = int(duration_seconds * INSTANTS_PER_SECOND) + 1
    try:
        legs = legs_of(trained.skeleton)
    except SkeletonMapError:
        return None
    joints = JointsAt(trained, np.arange(count) / INSTANTS_PER_SECOND)
    return FootSliding(joints, legs, torch.zeros(0, 2, 1)) if count > 2 else None


@torch.no_grad()
def median_bones(trained: TrainedField, latent: Float32[Tensor, "latent"], seconds: float) -> Float32[Tensor, "bones"]:
    """Median bone lengths over a motion."""
    joints = JointsAt(trained, np.linspace(0.0, seconds, MEDIAN_SAMPLES))(latent)
    return _bones(joints[:, : SMPL22.num_joints]).median(dim=0).values


def _bones(joints: Float32[Tensor, "instants joints 3"]) -> Float32[Tensor, "instants bones"]:
    lengths: Tensor = torch.linalg.vector_norm(joints[:, 1:] - joints[:, list(SMPL22.parents[1:])], dim=-1)
    return lengths


def _facing(joints: Float[Tensor, "poses joints 3"]) -> Float[Tensor, "poses 2"]:
    """Facing directions as unit vectors (x, z), as in `motionkit.features.field.heading`."""
    names = SMPL22_LAYOUT.facing
    across = joints[:, names.right_hip] - joints[:, names.left_hip]
    across = across + joints[:, names.right_shoulder] - joints[:, names.left_shoulder]
    return torch.nn.functional.normalize(torch.stack((across[:, 2], -across[:, 0]), dim=-1), dim=-1)


def _turned(
    joints: Float[Tensor, "poses joints 3"], cosine: Float[Tensor, "*turns"], sine: Float[Tensor, "*turns"]
) -> Float[Tensor, "poses joints 3"]:
    x, y, z = joints.unbind(-1)
    return torch.stack((cosine * x + sine * z, y, cosine * z - sine * x), dim=-1)


GUIDED_STEPS, GUIDED_ITERATIONS = 10, 6
# Contacts change with the motion: they are detected anew in each round.
ROUNDS, ITERATIONS = 3, 20
PLACE_UNIT, PLACE_PRIOR = 0.3, 1e-4

Solution = tuple[Float32[Tensor, "latent"], Float32[Tensor, "3"]]
"""Standardised numbers of a latent, and its place in the world."""


@dataclass(frozen=True, eq=False)
class ConstrainedLatent:
    """A latent whose motion meets its constraints when placed at `place`: yaw (radians), then x and z (metres).

    `bones` are the fixed bone lengths in metres, where joints are constrained.
    """

    latent: Float32[Tensor, "latent"]
    place: Float32[Tensor, "3"]
    bones: Float32[Tensor, "bones"] | None


def sample_constrained(
    trained: TrainedDenoiser,
    field: TrainedField,
    conditions: Conditions,
    constraints: tuple[Constraint, ...],
    *,
    seed: int,
    number: int,
    sampling: SamplingOptions = SamplingOptions(),
) -> ConstrainedLatent:
    """Sample the latent of one row of conditions under constraints; deterministic in (seed, number)."""
    used = in_use(trained.denoiser.first_read.to("cpu"), conditions.duration.to("cpu"))[0]
    seconds = float(conditions.duration[0]) * field.max_duration_seconds

    def latent_of(numbers: Float32[Tensor, "latent"]) -> Float32[Tensor, "latent"]:
        return trained.space.restore((numbers * used)[None])[0]

    joints = JointsAt(field, np.concatenate([each.seconds for each in constraints]))
    goal = ConstraintCost(joints, constraints)
    every = max(1, trained.with_sampling(sampling).diffusion.sampling_steps // GUIDED_STEPS)

    def adjust(clean: Float64[Tensor, "1 latent"], index: int, alpha: float) -> Float64[Tensor, "1 latent"]:
        if index % every:
            return clean
        # Given √ᾱ z + √(1 − ᾱ) ε, a number of variance 1 has the posterior variance 1 − ᾱ.
        search = Search(clean[0].float(), (1.0 - alpha) ** 0.5, latent_of, goal)
        return search.run(GUIDED_ITERATIONS)[0].to(torch.float64)[None]

    latents = trained.sample(conditions, seed=seed, sampling=sampling, first=number, adjust=adjust)
    search, feet = Search(trained.space.standardise(latents)[0], 1.0, latent_of, goal), foot_sliding(field, seconds)
    numbers, place = search.drawn, goal.place(latents[0])
    for _ in range(ROUNDS):
        latent = latent_of(numbers)
        bones = median_bones(field, latent, seconds)
        if goal.bones is not None and field.skeleton == SMPL22:
            bones = goal.bones
        current = None if feet is None else feet.with_contacts_of(latent)
        numbers, place = replace(search, feet=current, bones=bones).run(ITERATIONS, (numbers, place))
    keeps_bones = field.skeleton == SMPL22 and any(each.kind != "path" for each in constraints)
    return ConstrainedLatent(latent_of(numbers), place, bones if keeps_bones else None)


@dataclass(frozen=True, eq=False)
class Search:
    """L-BFGS over the numbers of a latent and its place in the world.

    The cost is ½‖(n − n₀) / σ‖² with the numbers `drawn` and their `deviation`, plus `goal` (with poses of these
    `bones`), plus `feet`.
    """

    drawn: Float32[Tensor, "latent"]
    deviation: float
    latent_of: Callable[[Float32[Tensor, "latent"]], Float32[Tensor, "latent"]]
    goal: ConstraintCost
    feet: FootSliding | None = None
    bones: Float32[Tensor, "bones"] | None = None

    def run(self, iterations: int, start: Solution | None = None) -> Solution:
        """Numbers and place after `iterations` from `start` (default: those drawn)."""
        numbers, place = start or (self.drawn, self.goal.place(self.latent_of(self.drawn)))
        moved = torch.cat(((numbers - self.drawn) / self.deviation, torch.zeros(3))).requires_grad_()
        steps = torch.optim.LBFGS([moved], max_iter=iterations, history_size=10, line_search_fn="strong_wolfe")

        def read() -> Solution:
            return self.drawn + self.deviation * moved[:-3], place + PLACE_UNIT * self.goal.places_motion * moved[-3:]

        def objective() -> float:
            steps.zero_grad()
            numbers, place = read()
            latent = self.latent_of(numbers)
            cost = 0.5 * moved[:-3].square().sum() + PLACE_PRIOR * moved[-3:].square().sum()
            cost = cost + self.goal.cost(latent, place, self.bones)
            if self.feet is not None:
                cost = cost + self.feet.cost(latent)
            torch.autograd.backward(cost)
            return float(cost.detach())

        with torch.enable_grad():
            steps.step(objective)  # type: ignore[no-untyped-call]
        with torch.no_grad():
            return read()


def joints_of(numbers: Float[Tensor, "poses features"], vectors: PoseVectors) -> Float[Tensor, "poses joints 3"]:
    """Joint positions in the window's frame, metres, of vectors in their own units; differentiable."""
    if not isinstance(vectors, RotationVectors):
        joints = numbers.reshape(len(numbers), -1, 3)
        return torch.cat((joints[:, :1], joints[:, 1:] + joints[:, :1]), dim=1)
    pairs = numbers[:, 3:].reshape(len(numbers), -1, 2, 3)
    first = torch.nn.functional.normalize(pairs[..., 0, :], dim=-1)
    second = pairs[..., 1, :]
    second = torch.nn.functional.normalize(second - (first * second).sum(-1, keepdim=True) * first, dim=-1)
    local = torch.stack((first, second, torch.linalg.cross(first, second)), dim=-1)
    offsets = torch.as_tensor(vectors.skeleton.offsets, device=numbers.device)
    world, places = [local[:, 0]], [numbers[:, :3] + offsets[0]]
    for joint, parent in enumerate(vectors.skeleton.parents):
        if parent >= 0:
            world.append(world[parent] @ local[:, joint])
            places.append(places[parent] + world[parent] @ offsets[joint])
    return torch.stack(places, dim=1)
