"""Encoding motions that were not in training: a z by optimisation against the frozen field (appendix B.2, Table 4).

There is no encoder: L-BFGS minimises Eq. 3's terms over z alone, starting from the linear model's fit (local latents)
or from zero. Numbers are scaled by their effect on the poses, which differs widely between banks of knots and paths.
"""

import torch
from jaxtyping import Float, Float32, Float64

from motionkit.data.poses import PoseBatch
from nerm.field.network import EncodedCoordinates
from nerm.field.trained import TrainedField

ITERATIONS = 30
PROBES = 4
SMALLEST_EFFECT = 0.05


def starting_latents(trained: TrainedField, batch: PoseBatch) -> Float32[torch.Tensor, "batch latent"]:
    """The initial z: the linear fit that initialises training too (local layout), or the prior's mean."""
    model = trained.linear_model
    if model is None:
        return torch.zeros(len(batch.window), trained.latent_dimension)
    return model.fit(batch)


def encode_by_optimisation(
    trained: TrainedField, batch: PoseBatch, *, iterations: int = ITERATIONS
) -> Float32[torch.Tensor, "batch latent"]:
    """The z of each clip of a batch: argmin ‖f_θ(t, z, s) − x‖² + λ_KL·½‖z‖²/d, all clips at once.

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
    moved = torch.zeros_like(start).requires_grad_()
    search = torch.optim.LBFGS([moved], max_iter=iterations, history_size=10, line_search_fn="strong_wolfe")

    def objective() -> float:
        search.zero_grad()
        latents = start + unit * moved
        misfit = (trained.network.decode(latents, encoded, fps) - target).square().mean(dim=(1, 2))
        prior = 0.5 * kl_weight * latents.square().mean(dim=1)
        # A sum, not a mean: clips are independent, and each gets the gradient that it would get alone.
        loss = (misfit + prior).sum()
        torch.autograd.backward(loss)
        return float(loss.detach())

    search.step(objective)  # type: ignore[no-untyped-call]
    return (start + unit * moved).detach().cpu()


def effect_of_numbers(
    trained: TrainedField,
    latents: Float32[torch.Tensor, "batch latent"],
    encoded: EncodedCoordinates,
    fps: Float64[torch.Tensor, "batch"],
) -> Float[torch.Tensor, "latent"]:
    """The relative effect of a unit of each number of z on the poses, averaged over clips.

    √diag(JᵀJ) by Hutchinson's estimator with random signs; at least `SMALLEST_EFFECT`, to bound the steps of numbers
    with hardly any effect.
    """
    generator = torch.Generator().manual_seed(0)
    latents = latents.detach().requires_grad_()
    vectors = trained.network.decode(latents, encoded, fps)
    total = torch.zeros_like(latents[0])
    for _ in range(PROBES):
        signs = (torch.randint(0, 2, vectors.shape, generator=generator) * 2.0 - 1.0).to(vectors.device)
        (gradient,) = torch.autograd.grad(vectors, latents, signs, retain_graph=True)
        total += gradient.square().mean(dim=0)
    effect = total.sqrt()
    return (effect / effect.square().mean().sqrt()).clamp(min=SMALLEST_EFFECT)
