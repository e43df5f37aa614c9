"""Latents that are held to constraints: the sampler is led there, then the latent is searched (docs/generation.md).

At some steps the predicted clean latent is moved to where its motion costs least: the constraints, and how far it was
moved in units of what the step leaves open (a normal prior around the prediction; Song et al. 2024, hard data
consistency). The steps that follow make a motion of it. At the end the latent that came out is searched longer, and
feet that stand count too, so that steps carry the body where it is to go.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float32, Float64
from torch import Tensor

from motionkit.core.skeleton import SMPL22
from motionkit.generate.constraints import Constraint
from motionkit.generate.models import SamplingOptions
from nerm.conditions import Conditions
from nerm.denoiser.trained import TrainedDenoiser
from nerm.field.goals import HeldTo, StandingFeet, held_to, median_bones, standing_feet
from nerm.field.trained import TrainedField
from nerm.latents.posterior import in_use

GUIDED_STEPS, GUIDED_ITERATIONS = 10, 6
# Contacts change with the motion: they are looked for in each round anew.
ROUNDS, ITERATIONS = 3, 20
PLACE_UNIT, PLACE_PRIOR = 0.3, 1e-4

Found = tuple[Float32[Tensor, "latent"], Float32[Tensor, "3"]]
"""Standardised numbers of a latent, and its place in the world."""


@dataclass(frozen=True, eq=False)
class Held:
    """A latent whose motion meets its constraints where it lies at `place`: a turn (radians), then x and z (metres).

    Where places of joints are asked for it does so on `bones` of one length each, metres.
    """

    latent: Float32[Tensor, "latent"]
    place: Float32[Tensor, "3"]
    bones: Float32[Tensor, "bones"] | None


def sample_held(
    trained: TrainedDenoiser,
    field: TrainedField,
    conditions: Conditions,
    constraints: tuple[Constraint, ...],
    *,
    seed: int,
    number: int,
    sampling: SamplingOptions = SamplingOptions(),
) -> Held:
    """The latent of a single row of conditions that is held to constraints; it follows from (seed, number) alone."""
    used = in_use(trained.denoiser.first_read.to("cpu"), conditions.duration.to("cpu"))[0]
    seconds = float(conditions.duration[0]) * field.max_duration_seconds

    def latent_of(numbers: Float32[Tensor, "latent"]) -> Float32[Tensor, "latent"]:
        return trained.space.restore((numbers * used)[None])[0]

    goal = held_to(field, constraints)
    every = max(1, trained.with_sampling(sampling).diffusion.sampling_steps // GUIDED_STEPS)

    def adjust(clean: Float64[Tensor, "1 latent"], index: int, alpha: float) -> Float64[Tensor, "1 latent"]:
        if index % every:
            return clean
        # Of a number of variance 1, (1 − ᾱ) is left open by √ᾱ z + √(1 − ᾱ) ε.
        search = Search(clean[0].float(), (1.0 - alpha) ** 0.5, latent_of, goal)
        return search.run(GUIDED_ITERATIONS)[0].to(torch.float64)[None]

    latents = trained.sample(conditions, seed=seed, sampling=sampling, first=number, adjust=adjust)
    search, feet = Search(trained.space.standardise(latents)[0], 1.0, latent_of, goal), standing_feet(field, seconds)
    numbers, place = search.drawn, goal.place(latents[0])
    for _ in range(ROUNDS):
        latent = latent_of(numbers)
        bones = median_bones(field, latent, seconds)
        if goal.bones is not None and field.skeleton == SMPL22:
            bones = goal.bones
        seen = None if feet is None else feet.seen(latent)
        numbers, place = replace(search, feet=seen, bones=bones).run(ITERATIONS, (numbers, place))
    keeps_bones = field.skeleton == SMPL22 and any(each.kind != "path" for each in constraints)
    return Held(latent_of(numbers), place, bones if keeps_bones else None)


@dataclass(frozen=True, eq=False)
class Search:
    """A search for the numbers, and the place in the world, that cost least, by L-BFGS.

    They cost ½‖(n − n₀) / σ‖² for the numbers `drawn` and their `deviation`, what `goal` says (of poses with these
    `bones`), and what `feet` say.
    """

    drawn: Float32[Tensor, "latent"]
    deviation: float
    latent_of: Callable[[Float32[Tensor, "latent"]], Float32[Tensor, "latent"]]
    goal: HeldTo
    feet: StandingFeet | None = None
    bones: Float32[Tensor, "bones"] | None = None

    def run(self, iterations: int, start: Found | None = None) -> Found:
        """The numbers and the place after so many iterations from `start`, else from those drawn."""
        numbers, place = start or (self.drawn, self.goal.place(self.latent_of(self.drawn)))
        moved = torch.cat(((numbers - self.drawn) / self.deviation, torch.zeros(3))).requires_grad_()
        steps = torch.optim.LBFGS([moved], max_iter=iterations, history_size=10, line_search_fn="strong_wolfe")

        def read() -> Found:
            return self.drawn + self.deviation * moved[:-3], place + PLACE_UNIT * self.goal.finds_place * moved[-3:]

        def objective() -> float:
            steps.zero_grad()
            latent, laid = self.latent_of(read()[0]), read()[1]
            cost = 0.5 * moved[:-3].square().sum() + PLACE_PRIOR * moved[-3:].square().sum()
            cost = cost + self.goal.cost(latent, laid, self.bones)
            if self.feet is not None:
                cost = cost + self.feet.cost(latent)
            torch.autograd.backward(cost)
            return float(cost.detach())

        with torch.enable_grad():
            steps.step(objective)  # type: ignore[no-untyped-call]
        with torch.no_grad():
            return read()
