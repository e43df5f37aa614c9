"""Encoding motions that were not in training: a z by optimisation against the frozen field (appendix B.2, Table 4).

There is no encoder: L-BFGS minimises Eq. 3's terms over z alone, starting from the linear model's fit (local latents)
or from zero. Numbers are scaled by their effect on the poses, which differs widely between banks of knots and paths.
"""

from collections.abc import Callable

import torch

from motionkit.core.shapes import Float, Float32, Float64
from motionkit.training.pose_vectors import PoseTensors
from nerm.field.network import EncodedCoordinates
from nerm.field.trained import TrainedField

EVALUATIONS = 30
HISTORY = 10
SUFFICIENT_DECREASE, SMALLEST_CURVATURE = 1e-4, 1e-10
PROBES = 8
SMALLEST_EFFECT = 0.05


def starting_latents(trained: TrainedField, batch: PoseTensors) -> Float32[torch.Tensor, "batch latent"]:
    """The initial z: the linear fit that initialises training too (local layout), or the prior's mean."""
    model = trained.linear_model
    if model is None:
        return torch.zeros(len(batch.window), trained.latent_dimension)
    return model.fit(batch)


def encode_by_optimisation(
    trained: TrainedField, batch: PoseTensors, *, evaluations: int = EVALUATIONS
) -> Float32[torch.Tensor, "batch latent"]:
    """The z of each clip of a batch: argmin ‖f_θ(t, z, s) − x‖² + λ_KL·½‖z‖²/d, independent of the other clips.

    A clip's poses must be in order of time. ½‖z‖²/d is the KL term for a fixed posterior variance; a field without
    distributions has none (Eq. 9). The result is on the CPU.
    """
    config, device = trained.config, trained.device
    kl_weight = config.loss.kl_weight if config.latents.variational else 0.0
    target = trained.scaling.apply(batch.vectors.to(device))
    start = starting_latents(trained, batch).to(device)
    fps = batch.fps.to(device)
    with torch.no_grad():
        encoded = trained.network.encode_coordinates(batch.coordinates.to(device), fps)
    unit = 1.0 / effect_of_numbers(trained, start, encoded, fps)

    @torch.enable_grad()
    def objective(moved: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        moved = moved.detach().requires_grad_()
        latents = start + unit * moved
        misfit = (trained.network.decode(latents, encoded, fps) - target).square().mean(dim=(1, 2))
        losses = misfit + 0.5 * kl_weight * latents.square().mean(dim=1)
        (gradients,) = torch.autograd.grad(losses.sum(), moved)
        return losses.detach(), gradients

    return (start + unit * minimise_each(objective, torch.zeros_like(start), evaluations)).cpu()


@torch.no_grad()
def minimise_each(
    objective: Callable[[torch.Tensor], tuple[torch.Tensor, torch.Tensor]],
    start: Float[torch.Tensor, "batch n"],
    evaluations: int,
) -> Float[torch.Tensor, "batch n"]:
    """Minimise a function of each row by L-BFGS with backtracking (Nocedal & Wright 2006, algorithms 7.5 and 3.1).

    `objective` returns values [batch] and gradients [batch, n]. Rows are evaluated together, but each has its own step
    length and history: where a value does not decrease, a shorter step is evaluated next, elsewhere the next one.
    """
    point = start
    value, gradient = objective(point)
    # The latest steps of each row and the changes of its gradient, the newest last; zeros have no effect.
    steps = point.new_zeros((HISTORY, *point.shape))
    changes = torch.zeros_like(steps)
    length = torch.ones_like(value)
    for _ in range(evaluations - 1):
        direction = -_newton_step(gradient, steps, changes)
        trial = point + length[:, None] * direction
        trial_value, trial_gradient = objective(trial)
        expected = length * (gradient * direction).sum(dim=1)
        decreased = trial_value <= value + SUFFICIENT_DECREASE * expected
        step, change = trial - point, trial_gradient - gradient
        is_convex = (step * change).sum(dim=1) > SMALLEST_CURVATURE * change.square().sum(dim=1)
        (rows,) = torch.where(decreased & is_convex)
        steps[:, rows] = torch.cat((steps[1:, rows], step[None, rows]))
        changes[:, rows] = torch.cat((changes[1:, rows], change[None, rows]))
        # Towards the minimum of the parabola through both values and the slope.
        shorter = length * (0.5 * expected / (expected + value - trial_value)).nan_to_num(0.0).clamp(0.1, 0.5)
        length = torch.where(decreased, 1.0, shorter)
        value = torch.where(decreased, trial_value, value)
        point, gradient = (
            torch.where(decreased[:, None], new, old) for new, old in ((trial, point), (trial_gradient, gradient))
        )
    return point


def _newton_step(
    gradient: Float[torch.Tensor, "batch n"],
    steps: Float[torch.Tensor, "history batch n"],
    changes: Float[torch.Tensor, "history batch n"],
) -> Float[torch.Tensor, "batch n"]:
    """The inverse Hessian that L-BFGS estimates, times the gradient (Nocedal & Wright 2006, algorithm 7.4)."""
    curvature = (steps * changes).sum(dim=-1)
    inverse = torch.where(curvature > 0, 1.0 / curvature, 0.0)
    size = changes[-1].square().sum(dim=-1)
    # Without a step yet: of length 1 at most.
    first = 1.0 / gradient.abs().sum(dim=-1).clamp(min=1.0)
    result, weights = gradient, []
    for index in reversed(range(len(steps))):
        weights.append(inverse[index] * (steps[index] * result).sum(dim=-1))
        result = result - weights[-1][:, None] * changes[index]
    result = result * torch.where(size > 0, curvature[-1] / size, first)[:, None]
    for index, weight in enumerate(reversed(weights)):
        other = inverse[index] * (changes[index] * result).sum(dim=-1)
        result = result + (weight - other)[:, None] * steps[index]
    return result


def effect_of_numbers(
    trained: TrainedField,
    latents: Float32[torch.Tensor, "batch latent"],
    encoded: EncodedCoordinates,
    fps: Float64[torch.Tensor, "batch"],
) -> Float[torch.Tensor, "batch latent"]:
    """The relative effect of a unit of each number of z on the poses of its clip.

    √diag(JᵀJ) by Hutchinson's estimator with random signs, the same for all clips; at least `SMALLEST_EFFECT`, to bound
    the steps of numbers with hardly any effect.
    """
    generator = torch.Generator().manual_seed(0)
    latents = latents.detach().requires_grad_()
    vectors = trained.network.decode(latents, encoded, fps)
    total = torch.zeros_like(latents)
    for _ in range(PROBES):
        signs = (torch.randint(0, 2, vectors.shape[1:], generator=generator) * 2.0 - 1.0).to(vectors.device)
        (gradient,) = torch.autograd.grad(vectors, latents, signs.expand_as(vectors), retain_graph=True)
        total += gradient.square()
    effect = total.sqrt()
    return (effect / effect.square().mean(dim=1, keepdim=True).sqrt()).clamp(min=SMALLEST_EFFECT)
