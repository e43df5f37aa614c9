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
from motionkit.training.networks import Conditions, ConditionSizes, VectorScaling
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


def learnt(stage: PeerStage) -> tuple[PeerNetwork, Tensor]:
    """A stage's network after it and earlier ones were trained on four motions, and what it should give."""
    earlier = {each.name: learnt(each)[0] for each in stage.builds_on}
    config = tiny_config(stage.name)
    space, rows = motions(config.motions.pose_vectors)
    torch.manual_seed(0)
    network_config = replace(config.network, **CHANGED.get(stage.name, {}))
    network = stage.make_network(network_config, NetworkInputs(space, SIZES, 4, earlier)).train()
    optimizer = torch.optim.AdamW(network.parameters(), lr=0.0, weight_decay=0.0)
    count, which = STEPS.get(stage.name, 300), EACH.repeat(COPIES.get(stage.name, 1))
    frames = torch.arange(FRAMES).expand(len(which), -1)
    lengths, mask = torch.full((len(which),), FRAMES), torch.ones(len(which), FRAMES, dtype=torch.bool)
    for step in range(count):
        generator = step_generator(0, stage.name, step)
        batch = MotionBatch(rows[which], lengths, mask, CONDITIONS.rows(which), which, frames, generator, step, count)
        with dropout_from(generator, torch.device("cpu")):
            loss = network.losses(batch)["loss"]
        optimizer.zero_grad()
        loss.backward()
        set_rate(optimizer, 4e-3 * min(1.0, (step + 1) / 20) * 0.5 * (1 + cos(pi * step / count)))
        optimizer.step()
    # What CAMDM makes of nothing is what followed four frames.
    return network.eval().requires_grad_(False), rows[:, 4:] if stage is CAMDM else rows


def sampled(network: PeerNetwork, frames: int) -> Tensor:
    """One motion of each action."""
    generators = [torch.Generator().manual_seed(row) for row in range(4)]
    diffusion = replace(network.diffusion or DiffusionConfig(), guidance_scale=1.0)
    lengths, nothing = torch.full((4,), frames), CONDITIONS.unconditional()
    return network.sample(SampleBatch(lengths, CONDITIONS, nothing, generators, diffusion)).float()


def reconstructed(network: Nemf, truth: Tensor) -> Tensor:
    """The motions of these motions' mean latents: NeMF takes no conditions."""
    lengths = torch.full((4,), truth.shape[1])
    (local, _), (turns, _) = network.encode(truth, lengths)
    found = network.rows(local, turns, lengths)
    velocities = network.space.layout.joint_velocities  # which it does not predict
    found[..., velocities] = truth[..., velocities]
    return found


# MDM with 1,000 steps differs from MDM with 50 in its settings alone.
@pytest.mark.parametrize(
    "stage", [MDM_50, MLD, INR_MLP, ACTOR, T2M, CAMDM, FLOW, JL2P, HIER, NEMF], ids=lambda stage: stage.name
)
def test_four_motions_are_learnt_by_heart(stage: PeerStage) -> None:
    torch.set_num_threads(1)
    network, truth = learnt(stage)
    found = reconstructed(network, truth) if isinstance(network, Nemf) else sampled(network, truth.shape[1])
    errors, apart = ((each[:, None] - truth[None]).square().mean(dim=(2, 3)).sqrt() for each in (found, truth))
    assert bool((errors.argmin(dim=1) == EACH).all())
    assert bool((errors.diagonal() < 0.6 * (apart + 1e9 * torch.eye(4)).amin(dim=1)).all())
