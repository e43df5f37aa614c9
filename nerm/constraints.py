"""Latents of motions that meet constraints (docs/generation.md; ours).

At some steps of the diffusion the predicted clean latent is optimised to meet them, with a normal prior around the
prediction whose deviation is the step's remaining noise (Song et al. 2024, hard data consistency). The steps that
follow make it a plausible motion. At the end the sampled latent is optimised for longer, with a cost for sliding feet,
so that footsteps carry the body to its targets. Costs are differentiable functions of the latent and of the motion's
place in the world: yaw about +Y (radians), then a translation on the floor (x, z).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from motionkit.core.shapes import Bool, Float, Float32, Float64
from motionkit.core.skeleton import SMPL22
from motionkit.features.layout import SMPL22_LAYOUT
from motionkit.fields.contact.bones import legs_of
from motionkit.fields.contact.detection import find_contacts, ground_of
from motionkit.generate.constraints import Constraint
from nerm.latents import LatentSpace

# Metres of position error that cost as much as a radian of heading error.
TURN_METRES = 0.3
INSTANTS_PER_SECOND = 60.0
# Speed of a foot in contact, m/s, and independent samples per second; deviation of bone lengths, m.
FEET_DEVIATION, SAMPLES_PER_SECOND = 0.1, 3.0
BONE_DEVIATION, MEDIAN_SAMPLES = 0.003, 100


JointsOf = Callable[[Float32[Tensor, "latent"]], Float32[Tensor, "instants joints 3"]]
"""Latent → the 22 joints of its motion at fixed instants, metres, in the window's frame; differentiable."""


@dataclass(frozen=True, eq=False)
class ConstraintCost:
    """The cost of constraints: squared position and heading errors in units of their deviations.

    `joints` are at the instants of all constraints, one after the other.
    """

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
        for constraint, joints in self._each(latent):
            ahead = _facing(joints)
            if constraint.frame == "world":
                here = _turned(joints, torch.cos(place[0]), torch.sin(place[0]))
                here = here + torch.stack((place[1], torch.zeros_like(place[1]), place[2]))
            else:
                under_root = joints[:, :1] * joints.new_tensor([1.0, 0.0, 1.0])
                here = _turned(joints - under_root, ahead[:, 1:], -ahead[:, :1])
            if bones is not None and constraint.kind != "path":
                total = total + 0.5 * (_bones(joints) - bones).square().sum() / BONE_DEVIATION**2
            # Not a number: free.
            positions, heading = (torch.from_numpy(each).float() for each in (constraint.positions, constraint.heading))
            apart = here[:, constraint.joint_indices] - positions.nan_to_num(0.0)
            apart = torch.where(positions.isnan(), 0.0, apart)
            # The chord of the angle is continuous at half a turn, unlike the angle.
            yaw = torch.atan2(ahead[:, 0], ahead[:, 1]) + place[0] - heading.nan_to_num(0.0)
            turned = torch.where(heading.isnan(), 0.0, 2.0 * torch.sin(0.5 * yaw))
            squares = apart.square().sum() + TURN_METRES**2 * turned.square().sum()
            total = total + 0.5 * squares / constraint.deviation**2
        return total

    @torch.no_grad()
    def place(self, latent: Float32[Tensor, "latent"]) -> Float32[Tensor, "3"]:
        """The place in the world that best meets the constraints (least squares, ignoring headings)."""
        if not self.places_motion:
            return torch.zeros(3)
        mine, given = [], []
        for constraint, joints in self._each(latent):
            if constraint.places_motion:
                positions = torch.from_numpy(constraint.positions).float()[..., [0, 2]]
                known = ~positions.isnan().any(dim=-1)
                mine.append(joints[:, constraint.joint_indices][known][:, [0, 2]])
                given.append(positions[known])
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
        whole = [each.positions for each in self.constraints if each.joints == SMPL22.joint_names]
        return _bones(torch.from_numpy(np.concatenate(whole)).float()).mean(dim=0) if whole else None

    def _each(self, latent: Float32[Tensor, "latent"]) -> Sequence[tuple[Constraint, Float32[Tensor, "own joints 3"]]]:
        """Each constraint, with the joints at its instants."""
        joints = torch.split(self.joints(latent), [len(each.seconds) for each in self.constraints])
        return list(zip(self.constraints, joints, strict=True))


@dataclass(frozen=True, eq=False)
class FootSliding:
    """The cost of feet that slide while in contact: this makes the gait agree with a given path.

    Contacts are detected in the motion of the latent `around`, and assumed for those near it.
    """

    joints: JointsOf
    around: Float32[Tensor, "latent"]

    @cached_property
    def contact(self) -> Float32[Tensor, "steps feet 1"]:
        """How far a foot is held between two instants, 0 to 1."""
        with torch.no_grad():
            paths = legs_of(SMPL22).foot_paths(self.joints(self.around).numpy()).astype(np.float64)
        hold = find_contacts(paths, INSTANTS_PER_SECOND, ground_of(paths, INSTANTS_PER_SECOND)).hold
        return torch.from_numpy(np.minimum(hold[1:], hold[:-1])[..., None]).float()

    def cost(self, latent: Float32[Tensor, "latent"]) -> Float32[Tensor, ""]:
        """Squared horizontal speeds of ankles and toes in contact, in units of `FEET_DEVIATION`."""
        joints = self.joints(latent)
        paths = joints[:, list(legs_of(SMPL22).feet)].reshape(len(joints), 2, 2, 3)
        velocity = (paths[1:] - paths[:-1]) * INSTANTS_PER_SECOND
        squares = self.contact * (velocity[..., 0].square() + velocity[..., 2].square())
        total: Tensor = 0.5 * SAMPLES_PER_SECOND / INSTANTS_PER_SECOND * squares.sum() / FEET_DEVIATION**2
        return total


def _bones(joints: Float32[Tensor, "instants joints 3"]) -> Float32[Tensor, "instants bones"]:
    lengths: Tensor = torch.linalg.vector_norm(joints[:, 1:] - joints[:, list(SMPL22.parents[1:])], dim=-1)
    return lengths


def _facing(joints: Float[Tensor, "poses joints 3"]) -> Float[Tensor, "poses 2"]:
    """Facing directions as unit vectors (x, z), as in `motionkit.features.field.heading`."""
    hips, shoulders = (joints[:, right] - joints[:, left] for right, left in SMPL22_LAYOUT.lateral_joints)
    across = hips + shoulders
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


def sample_constrained(
    constraints: tuple[Constraint, ...],
    duration_seconds: float,
    *,
    sample: Callable[..., Float32[Tensor, "1 latent"]],
    num_steps: int,
    space: LatentSpace,
    used: Bool[Tensor, "latent"],
    joints_at: Callable[[Float64[np.ndarray, "instants"]], JointsOf],
) -> tuple[Float32[Tensor, "latent"], Float32[Tensor, "3"], Float32[Tensor, "bones"] | None]:
    """Sample a latent under constraints: the latent, its place, and bone lengths in metres (None for paths alone).

    The motion meets its constraints when placed at yaw (radians), x and z (metres), on bones of these lengths.

    `sample` runs a diffusion of `num_steps` with `adjust`; `used` are the numbers of z that a motion of this duration
    uses; `joints_at` returns the joints of a latent's motion at some seconds.
    """

    def latent_of(numbers: Float32[Tensor, "latent"]) -> Float32[Tensor, "latent"]:
        return space.restore((numbers * used)[None])[0]

    goal = ConstraintCost(joints_at(np.concatenate([each.seconds for each in constraints])), constraints)
    every = max(1, num_steps // GUIDED_STEPS)

    def adjust(clean: Float64[Tensor, "1 latent"], index: int, alpha: float) -> Float64[Tensor, "1 latent"]:
        if index % every:
            return clean
        # Given √ᾱ z + √(1 − ᾱ) ε, a number of variance 1 has the posterior variance 1 − ᾱ.
        search = Search(clean[0].float(), (1.0 - alpha) ** 0.5, latent_of, goal)
        return search.run(GUIDED_ITERATIONS)[0].to(torch.float64)[None]

    latent = sample(adjust=adjust)[0]
    numbers, place = space.standardise(latent[None])[0], goal.place(latent)
    search = Search(numbers, 1.0, latent_of, goal)
    instants = np.arange(int(duration_seconds * INSTANTS_PER_SECOND) + 1) / INSTANTS_PER_SECOND
    of_feet, body = joints_at(instants), joints_at(np.linspace(0.0, duration_seconds, MEDIAN_SAMPLES))
    for _ in range(ROUNDS):
        latent = latent_of(numbers)
        with torch.no_grad():
            bones = _bones(body(latent)).median(dim=0).values if goal.bones is None else goal.bones
        feet = FootSliding(of_feet, latent) if len(instants) > 2 else None
        numbers, place = replace(search, feet=feet, bones=bones).run(ITERATIONS, (numbers, place))
    keeps_bones = any(each.kind != "path" for each in constraints)
    return latent_of(numbers), place, bones if keeps_bones else None


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
