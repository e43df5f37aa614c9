"""Every generative network learns four motions by heart, and gives each when its action is asked for."""

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from math import cos, pi

import jaxtyping
import numpy as np
import pytest
import torch
from torch import Tensor

from motionkit.features import field, native
from motionkit.features.field import FIELD_VECTORS
from motionkit.features.native import NativeVectors
from motionkit.training.config import DiffusionConfig
from motionkit.training.loop import dropout_from, set_rate, step_generator
from motionkit.training.networks import Conditions, ConditionSizes
from motionkit.training.pose_vectors import VectorScaling
from peers.actor import ACTOR
from peers.camdm import CAMDM
from peers.flow import FLOW
from peers.generating import PeerStage
from peers.hier import HIER
from peers.inr_mlp import INR_MLP
from peers.jl2p import JL2P
from peers.layers import NetworkInputs, PeerNetwork, TransformerSizes
from peers.mdm import MDM_50
from peers.mld import MLD
from peers.motions import MotionBatch, PoseSpace, SampleBatch
from peers.nemf import NEMF, Nemf
from peers.t2m import T2M
from tests.helpers.nerm_corpus import analytic_positions
from tests.helpers.tiny_peers import tiny_config

FPS, FRAMES = Fraction(20), 16
SIZES = ConditionSizes(0, ("a", "b", "c", "d"))
# Steps of each stage, as many as it takes.
STEPS = {"mdm-50": 500, "inr-mlp": 1200, "flow": 250, "camdm": 600, "mld": 800, "nemf": 500}
STEPS |= {"t2m-autoencoder": 150, "t2m": 200}
# A prior from which a VAE's latents are not far, so that its draws say nothing; a motion without a past as often.
CHANGED = {
    "actor": {"kl_weight": 1e-2},
    "mld-vae": {"kl_weight": 1e-3},
    "camdm": {"no_past": 0.7},
    # The velocity holds a frame's noise: tokens are wider than its 66 numbers.
    "flow": {"guidance_scale": 1.0, "sampling_steps": 24, "transformer": TransformerSizes(2, 96, 2, 96, 0.0)},
}
EACH = torch.arange(4)
CONDITIONS = Conditions(torch.zeros(4, 0), EACH, torch.ones(4, dtype=torch.bool), torch.ones(4))
# How often each motion is in a batch: of many noises a step, where steps are cheap.
COPIES = {"mld": 16, "inr-mlp": 4, "flow": 8}


@pytest.fixture(autouse=True)
def unchecked_shapes() -> Iterator[None]:
    """Thousands of steps; the shapes in them are checked where the same networks take few (test_generative_stages)."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def motions(pose_vectors: str) -> tuple[PoseSpace, Tensor]:
    """Four motions of a convention, standardised by their own mean and one scale."""
    positions = np.stack([analytic_positions(np.arange(FRAMES) / float(FPS), kind) for kind in range(4)])
    if pose_vectors == "field":
        numbers, vectors = field.encode(positions, *field.window_frame(positions[:, 0])), FIELD_VECTORS
    else:
        numbers, vectors = np.stack([native.vectors(each, "smpl22", FPS) for each in positions]), NativeVectors()
    rows = torch.from_numpy(numbers).float()
    mean = rows.mean(dim=(0, 1))
    scaling = VectorScaling(mean, torch.full_like(mean, float((rows - mean).std())))
    return PoseSpace(vectors, scaling, FPS), scaling.apply(rows)


def learnt(stage: PeerStage, *, steps: int | None = None) -> tuple[PeerNetwork, Tensor]:
    """A stage's network after it and earlier ones were trained on four motions, and what it should give."""
    earlier = {each.name: learnt(each, steps=steps)[0] for each in stage.builds_on}
    config = tiny_config(stage.name)
    space, rows = motions(config.motions.pose_vectors)
    torch.manual_seed(0)
    inputs = NetworkInputs(space, SIZES, 4, earlier)
    network = stage.make_network(replace(config.network, **CHANGED.get(stage.name, {})), inputs)
    optimizer = torch.optim.AdamW(network.parameters(), lr=0.0, weight_decay=0.0)
    count = STEPS.get(stage.name, 300) if steps is None else steps
    which = EACH.repeat(COPIES.get(stage.name, 1))
    frames = torch.arange(FRAMES).expand(len(which), -1)
    lengths, mask = torch.full((len(which),), FRAMES), torch.ones(len(which), FRAMES, dtype=torch.bool)
    for step in range(count):
        generator = step_generator(0, stage.name, step)
        batch = MotionBatch(rows[which], lengths, mask, CONDITIONS.rows(which), which, frames, generator, step, count)
        with dropout_from(generator, torch.device("cpu")):
            loss = network.train().losses(batch)["loss"]
        optimizer.zero_grad()
        loss.backward()
        set_rate(optimizer, 4e-3 * min(1.0, (step + 1) / 20) * 0.5 * (1 + cos(pi * step / count)))
        optimizer.step()
    # What CAMDM makes of nothing is what followed four frames.
    return network.eval().requires_grad_(False), rows[:, 4:] if stage is CAMDM else rows


def made(network: PeerNetwork, frames: int) -> Tensor:
    """One motion of each action."""
    nothing = CONDITIONS.unconditional()
    generators = [torch.Generator().manual_seed(row) for row in range(4)]
    diffusion = replace(network.diffusion or DiffusionConfig(), guidance_scale=1.0)
    return network.sample(SampleBatch(torch.full((4,), frames), CONDITIONS, nothing, generators, diffusion)).float()


def again(network: Nemf, truth: Tensor) -> Tensor:
    """The motions of the mean latents of these: who knows no conditions cannot be asked for one of them."""
    lengths = torch.full((4,), truth.shape[1])
    with torch.no_grad():
        (local, _), (turns, _) = network.encode(truth, lengths)
        made = network.rows(local, turns, lengths)
    # Velocities of joints are not made.
    velocities = network.space.layout.joint_velocities
    made[..., velocities] = truth[..., velocities]
    return made


def errors(found: Tensor, truth: Tensor) -> Tensor:
    """Root mean squares between each motion that was made and each true one."""
    return (found[:, None] - truth[None]).square().mean(dim=(2, 3)).sqrt()


# MDM with 1,000 steps differs from MDM with 50 in its settings alone.
@pytest.mark.parametrize(
    "stage", [MDM_50, MLD, INR_MLP, ACTOR, T2M, CAMDM, FLOW, JL2P, HIER, NEMF], ids=lambda stage: stage.name
)
def test_four_motions_are_learnt_by_heart(stage: PeerStage) -> None:
    torch.set_num_threads(1)
    network, truth = learnt(stage)
    apart = errors(truth, truth)
    nearest_other = (apart + 1e9 * torch.eye(4)).min(dim=1).values

    def known(own: PeerNetwork) -> bool:
        found = errors(again(own, truth) if isinstance(own, Nemf) else made(own, truth.shape[1]), truth)
        return bool((found.argmin(dim=1) == EACH).all() and (found.diagonal() < 0.6 * nearest_other).all())

    assert known(network)
    assert not known(learnt(stage, steps=1)[0])
