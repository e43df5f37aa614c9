"""Encoding motions that were not in training: a z by optimisation against the frozen field (appendix B.2, Table 4).

There is no encoder: L-BFGS minimises Eq. 3's terms over z alone, from a ridge fit where the latent is local, else from
zero.
"""

import torch
from jaxtyping import Float32

from motionkit.clips import PoseBatch
from nerm.field import FieldNetwork
from nerm.field_model import TrainedField
from nerm.knots import ridge_knots

ITERATIONS = 25


def starting_latents(trained: TrainedField, batch: PoseBatch) -> Float32[torch.Tensor, "batch latent"]:
    """Where the search begins: the ridge fit that training began with too (local layout), or the prior's mean."""
    if trained.components is None:
        return torch.zeros(len(batch.window), trained.latent_dimension)
    scaling = trained.scaling.to(torch.device("cpu"))
    scores = trained.components.scores(scaling.apply(batch.vectors))
    layout = FieldNetwork.knot_layout(trained.config)
    return ridge_knots(scores, batch.coordinates, layout, trained.config.ridge).flatten(1)


def encode_by_optimisation(
    trained: TrainedField, batch: PoseBatch, *, iterations: int = ITERATIONS
) -> Float32[torch.Tensor, "batch latent"]:
    """The z of each clip of a batch: argmin ‖f_θ(t, z, s) − x‖² + λ_KL·½‖z‖²/d, all clips at once.

    ½‖z‖²/d is the KL term of a posterior whose variance is fixed. On the CPU in the end.
    """
    config, device = trained.config, trained.device
    target = trained.scaling.apply(batch.vectors.to(device))
    latents = starting_latents(trained, batch).to(device).requires_grad_()
    fps = batch.fps.to(device)
    with torch.no_grad():
        encoded = trained.network.encode_coordinates(batch.coordinates.to(device), fps)
    search = torch.optim.LBFGS([latents], max_iter=iterations, history_size=10, line_search_fn="strong_wolfe")

    def objective() -> float:
        search.zero_grad()
        misfit = (trained.network.decode(latents, encoded, fps) - target).square().mean(dim=(1, 2))
        prior = 0.5 * config.kl_weight * latents.square().mean(dim=1)
        # A sum, not a mean: clips are independent, and each should see the gradient it would see alone.
        loss = (misfit + prior).sum()
        torch.autograd.backward(loss)
        return float(loss.detach())

    search.step(objective)  # type: ignore[no-untyped-call]
    return latents.detach().cpu()
