"""Sampling latents under constraints: guided diffusion steps, then optimisation of the latent (docs/generation.md).

At some steps the predicted clean latent is optimised to meet the constraints, with a normal prior around the
prediction whose deviation is the step's remaining noise (Song et al. 2024, hard data consistency). The steps that
follow make it a plausible motion. At the end the sampled latent is optimised for longer, with a cost for sliding feet,
so that footsteps carry the body to its targets.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from motionkit.core.shapes import Float32, Float64
from motionkit.core.skeleton import SMPL22
from motionkit.generate.constraints import Constraint
from motionkit.generate.models import SamplingOptions
from nerm.conditions import Conditions
from nerm.denoiser.trained import TrainedDenoiser
from nerm.field.goals import ConstraintCost, FootSliding, constraint_cost, foot_sliding, median_bones
from nerm.field.trained import TrainedField
from nerm.latents.posterior import in_use

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

    goal = constraint_cost(field, constraints)
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
