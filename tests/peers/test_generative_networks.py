"""Each generative network against an independent statement of it, and that it learns four motions by heart.

A pass is stated for one motion without padding, of the network's own torch layers.
"""

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from math import cos, pi

import jaxtyping
import numpy as np
import pytest
import torch
from torch import Tensor, nn

from motionkit.core.errors import UsageError
from motionkit.core.skeleton import SMPL22
from motionkit.features import field, native
from motionkit.features.convention import PoseVectors
from motionkit.features.field import FIELD_VECTORS
from motionkit.features.native import NativeVectors
from motionkit.training.config import DiffusionConfig
from motionkit.training.loop import dropout_from, step_generator
from motionkit.training.networks import Conditions, ConditionSizes, VectorScaling
from peers.diffusion import (
    CAMDM,
    FLOW,
    MDM,
    MDM_50,
    MLD,
    AbsoluteCoordinates,
    Flow,
    FlowLayer,
    FlowNetworkConfig,
    LongSkips,
    Mdm,
    MdmNetworkConfig,
    Mld,
    MldNetworkConfig,
    MldVae,
    MldVaeNetworkConfig,
)
from peers.generating import PeerStage
from peers.latents import (
    ACTOR,
    INR_MLP,
    NEMF,
    Nemf,
    NemfNetworkConfig,
    NemfPath,
    NemfPathNetworkConfig,
    fit_mixture,
    length_intervals,
)
from peers.layers import NetworkInputs, PeerNetwork, TransformerSizes
from peers.motions import MotionBatch, PoseSpace, SampleBatch, frames_within
from peers.recurrent import HIER, JL2P, T2M, body_parts
from tests.helpers.nerm_corpus import analytic_positions
from tests.helpers.tiny_peers import STAGES, tiny_config

FPS = Fraction(20)
SIZES = TransformerSizes(3, 16, 2, 24, 0.1)
TEXTS, NONE = ConditionSizes(6, ()), ConditionSizes(0, ())


def space(numbers: int = 263, vectors: PoseVectors = NativeVectors()) -> PoseSpace:
    return PoseSpace(vectors, VectorScaling(torch.zeros(numbers), torch.ones(numbers)), FPS)


FIELD = space(66, FIELD_VECTORS)


def inputs(
    sizes: ConditionSizes = TEXTS, earlier: PeerNetwork | None = None, of: PoseSpace | None = None
) -> NetworkInputs:
    return NetworkInputs(of or space(), sizes, 3, earlier)


def conditions(rows: int = 2, dimension: int = 6) -> Conditions:
    text = torch.randn((rows, dimension), generator=torch.Generator().manual_seed(3))
    return Conditions(text, torch.full((rows,), -1), torch.ones(rows, dtype=torch.bool), torch.ones(rows))


def batch_of(lengths: list[int], numbers: int = 263, padding: int = 0) -> MotionBatch:
    """Random motions of these lengths, zero-padded to the longest, and further."""
    torch.manual_seed(5)
    count, most = len(lengths), max(lengths)
    mask, frames = frames_within(torch.tensor(lengths), most + padding), torch.arange(most + padding).expand(count, -1)
    rows = nn.functional.pad(torch.randn(count, most, numbers), (0, 0, 0, padding)) * mask[..., None]
    generator = torch.Generator().manual_seed(0)
    return MotionBatch(rows, torch.tensor(lengths), mask, conditions(count), torch.arange(count), frames, generator)


def close(found: Tensor, expected: Tensor) -> None:
    torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-4)


def positions(count: int, width: int = 16) -> Tensor:
    angles = [[place / 10_000 ** (2 * i / width) for i in range(width // 2)] for place in range(count)]
    return torch.tensor([[f(angle) for angle in row for f in (np.sin, np.cos)] for row in angles], dtype=torch.float32)


def long_skips(skips: LongSkips, tokens: Tensor, *memory: Tensor) -> Tensor:
    """Layers 0 … n − 1, of which i feeds n − 1 − i."""
    kept: list[Tensor] = []
    for number, layer in enumerate(skips.layers):
        if number > len(skips.joins):
            join = skips.joins[number - len(skips.joins) - 1]
            tokens = join(torch.cat((tokens, kept[len(skips.layers) - 1 - number]), dim=-1))
        tokens = layer(tokens[None], *memory)[0]
        kept.append(tokens)
    return skips.norm(tokens)


def test_mdms_published_sizes_have_its_published_17_9_million_parameters() -> None:
    layer = 4 * (512 * 512 + 512) + 2 * 2 * 512 + (512 * 1024 + 1024) + (1024 * 512 + 512)
    by_hand = 2 * (512 * 263) + 512 + 263 + 3 * (512 * 512 + 512) + 8 * layer
    for stage in (MDM, MDM_50):
        mdm = Mdm(stage.paper.network, inputs(ConditionSizes(512, ())))
        assert sum(parameter.numel() for parameter in mdm.parameters()) == by_hand == 17_880_327


def test_mdm() -> None:
    network, batch = Mdm(MdmNetworkConfig(SIZES), inputs()).eval(), batch_of([5, 3])
    found = network(batch.rows, torch.tensor([7, 90]), batch.conditions, batch.mask)
    for row, (length, step) in enumerate(((5, 7), (3, 90))):
        first = network.step_in(positions(100)[step]) + network.condition.text(batch.conditions.text[row])
        tokens = torch.cat((first[None], network.frame_in(batch.rows[row, :length]))) + positions(length + 1)
        close(found[row, :length], network.frame_out(network.layers(tokens[None])[0, 1:]))


def test_mld() -> None:
    vae, batch = MldVae(MldVaeNetworkConfig(SIZES, longest=20), inputs(NONE)).eval(), batch_of([6, 4])
    mean, log_variance = vae.encode(batch.rows, batch.mask)
    made = vae.decode(mean, batch.mask)
    for row, length in enumerate((6, 4)):
        tokens = torch.cat((vae.distribution, vae.frame_in(batch.rows[row, :length])))
        tokens = long_skips(vae.encoder, tokens + vae.encoder_positions[: length + 2])
        close(torch.stack((mean[row], log_variance[row])), tokens[:2])
        out = long_skips(vae.decoder, vae.decoder_positions[:length], tokens[None, :1])
        close(made[row, :length], vae.frame_out(out))
    assert not made[1, 4:].any()
    network = Mld(MldNetworkConfig(SIZES, time_features=12), inputs(earlier=vae)).eval()
    assert not [name for name in network.state_dict() if "vae" in name]
    noisy = torch.randn(2, 1, 16)
    found = network(noisy, torch.tensor([3, 500]), batch.conditions)
    for row, step in enumerate((3, 500)):
        angles = torch.tensor([step / 10_000 ** (i / 6) for i in range(6)])
        time = network.step_in(torch.cat((angles.cos(), angles.sin())))
        text = network.condition.text(batch.conditions.text[row].clamp(min=0))
        close(
            found[row, 0], long_skips(network.layers, torch.stack((noisy[row, 0], time, text)) + network.positions)[0]
        )


def root_mean_square(values: Tensor) -> Tensor:
    return values / torch.sqrt(values.square().mean(-1, keepdim=True) + torch.finfo(torch.float32).eps)


def flow_layer(layer: FlowLayer, tokens: Tensor, embedding: Tensor) -> Tensor:
    """AdaLN-zero, rotary positions, attention and SwiGLU, head by head and frame by frame."""
    moved, width = layer.moved(embedding).chunk(6), tokens.shape[1]
    size = width // layer.heads
    hidden = layer.qkv(root_mean_square(tokens) * (1 + moved[1]) + moved[0])
    mixed, frames = torch.empty_like(tokens), torch.arange(len(tokens))
    angles = frames[:, None] / 10_000 ** (torch.arange(0, size, 2) / size)
    turn = torch.polar(torch.ones_like(angles), angles)
    for head in range(layer.heads):
        q, k, v = (hidden[:, kind * width + head * size :][:, :size] for kind in range(3))
        q, k = root_mean_square(q) * layer.query_norm.weight, root_mean_square(k) * layer.key_norm.weight
        q, k = (torch.complex(*each.chunk(2, dim=1)) * turn for each in (q, k))
        q, k = (torch.cat((each.real, each.imag), dim=1) for each in (q, k))
        mixed[:, head * size : (head + 1) * size] = torch.softmax(q @ k.T / size**0.5, dim=1) @ v
    tokens = tokens + moved[2] * layer.attended(mixed)
    gate, up = layer.gate_up(root_mean_square(tokens) * (1 + moved[4]) + moved[3]).chunk(2, dim=1)
    return tokens + moved[5] * layer.down(gate * torch.sigmoid(gate) * up)


def test_the_flow() -> None:
    network, batch = Flow(FlowNetworkConfig(SIZES), inputs(of=FIELD)).eval(), batch_of([5, 3], 66)
    for weight in network.parameters():  # what starts as zeros would hide all behind it
        nn.init.normal_(weight, std=0.2)
    network.requires_grad_(False)
    found = network(batch.rows, torch.tensor([0.25, 0.9]), batch.conditions, batch.mask)
    for row, (length, step) in enumerate(((5, 250), (3, 900))):
        time, text = network.time_in(positions(1000)[step]), network.condition.text(batch.conditions.text[row])
        embedding = (time + text) * torch.sigmoid(time + text)
        tokens = network.frame_in(batch.rows[row, :length])
        for layer in network.layers:
            tokens = flow_layer(layer, tokens, embedding)
        shift, scale = network.last(embedding).chunk(2)
        close(found[row, :length], network.frame_out(root_mean_square(tokens) * (1 + scale) + shift))


def test_absolute_coordinates_are_the_joints() -> None:
    truth = analytic_positions(np.arange(20) / 20, 1).astype(np.float32)
    rows = torch.from_numpy(field.encode(truth[None], np.zeros(1), np.zeros((1, 2))))
    scaling = VectorScaling(torch.linspace(-1, 1, 66), torch.linspace(0.5, 2, 66))
    coordinates = AbsoluteCoordinates(PoseSpace(FIELD_VECTORS, scaling, FPS))
    absolute = coordinates.absolute(scaling.apply(rows))
    np.testing.assert_allclose(coordinates.joints.invert(absolute)[0].view(20, 22, 3).numpy(), truth, atol=1e-5)
    close(coordinates.relative(absolute), scaling.apply(rows))
    with pytest.raises(UsageError, match=r"motions.pose_vectors=field"):
        AbsoluteCoordinates(space())


def test_joints_are_those_of_the_vectors() -> None:
    vectors = native.vectors(analytic_positions(np.arange(50) / 20, 2), "smpl22", FPS)
    scaling = VectorScaling(torch.linspace(-1, 1, 263), torch.linspace(0.5, 2, 263))
    found = PoseSpace(NativeVectors(), scaling, FPS).joints(scaling.apply(torch.from_numpy(vectors))[None])
    seconds = np.arange(len(vectors)) / float(FPS)
    np.testing.assert_allclose(found[0].numpy(), native.positions_at(vectors, "smpl22", seconds), atol=1e-5)


def test_mixtures_are_of_motions_of_one_action_and_length() -> None:
    lengths = np.repeat([30, 60, 62, 90], 40)
    found = [np.unique(lengths[rows]).tolist() for rows in length_intervals(lengths)]
    # 50 codes and ten frames at least, 50 more behind, and the same length on one side.
    assert found == [[30, 60], [62, 90]]
    centres = np.array([np.full(16, 2.0), np.full(16, -2.0)])
    codes = centres.repeat(20, axis=0) + np.random.default_rng(0).standard_normal((40, 16))
    mixture = fit_mixture(codes, np.full_like(codes, 0.1), reseeds=1)
    drawn = torch.stack([mixture.draw(torch.Generator().manual_seed(seed)) for seed in range(400)]).numpy()
    near = np.linalg.norm(drawn[:, None] - centres, axis=2).min(axis=1)
    assert (near < 8).mean() > 0.97 and 0.3 < (drawn[:, 0] > 0).mean() < 0.7


def test_body_parts_are_the_joints_that_their_names_say() -> None:
    parts = body_parts(space())
    assert sorted(number for part in parts for number in part) == list(range(263))
    sides = ["right", "left", "right", "left"]
    for numbers, side, contacts in zip(parts, sides, ((), (), (261, 262), (259, 260)), strict=False):
        own = np.array([name.startswith(side) for name in SMPL22.joint_names])
        joints = {1 + (number - 4) // 3 for number in numbers if 4 <= number < 67}
        joints |= {1 + (number - 67) // 6 for number in numbers if 67 <= number < 193}
        joints |= {(number - 193) // 3 for number in numbers if 193 <= number < 259}
        assert len(joints) == 4 and own[list(joints)].all()
        assert tuple(number for number in numbers if number >= 259) == contacts


def test_nemf() -> None:
    path = NemfPath(NemfPathNetworkConfig(widths=(5, 4), kernel=3), inputs(NONE))
    sizes = NemfNetworkConfig(16, (5, 6), 4, 4, 3, frequencies=2, width=7, local_layers=3, turn_layers=2)
    network = Nemf(sizes, inputs(NONE, path)).eval()
    local, turns = torch.randn(2, 4), torch.randn(2, 3)
    made = torch.cat(network(16, local, turns), dim=-1)
    for row in range(2):
        for frame in (0, 5, 15):
            time = frame / 8 - 1
            waves = torch.tensor([np.sin(time), np.cos(time), np.sin(2 * time), np.cos(2 * time)], dtype=torch.float32)
            given, hidden = torch.cat((waves, local[row])), torch.zeros(0)
            for layer in network.local_layers:
                hidden = layer(torch.cat((hidden, given)))
            pose = network.pose_out(hidden)
            for layer in network.turn_layers:
                hidden = layer(torch.cat((hidden, given, turns[row])))
            close(made[row, frame], torch.cat((pose, network.turn_out(hidden))))


@pytest.mark.parametrize("name", ["actor", "mld-vae", "t2m-autoencoder", "jl2p", "hier", "nemf-path", "nemf"])
def test_padding_is_not_seen(name: str) -> None:
    torch.manual_seed(1)
    stage, sizes = STAGES[name], TEXTS if name in ("actor", "jl2p", "hier") else NONE
    earlier = NemfPath(tiny_config("nemf-path").network, inputs(NONE)) if stage.builds_on else None
    network = stage.network(tiny_config(name).network, inputs(sizes, earlier)).eval()
    shorter, longer = (network.losses(batch_of([16, 11], padding=padding))["loss"] for padding in (0, 5))
    close(shorter, longer)


FRAMES, ACTIONS = 16, ConditionSizes(0, ("a", "b", "c", "d"))
# Steps of each stage, as many as it takes.
STEPS = {"mdm-50": 500, "inr-mlp": 1200, "flow": 250, "camdm": 600, "mld": 800, "nemf": 500, "t2m": 200}
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


@pytest.fixture
def unchecked_shapes() -> Iterator[None]:
    """Thousands of steps; the shapes in them are checked where the same networks take few (test_stages)."""
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
    """A stage's network after it and an earlier one were trained on four motions, and what it should give."""
    earlier = learnt(stage.builds_on)[0] if stage.builds_on else None
    config = tiny_config(stage.name)
    space_of_four, rows = motions(config.motions.pose_vectors)
    torch.manual_seed(0)
    network_config = replace(config.network, **CHANGED.get(stage.name, {}))
    sizes = NONE if stage is NEMF else ACTIONS
    network = stage.network(network_config, NetworkInputs(space_of_four, sizes, 4, earlier)).train()
    optimizer = torch.optim.AdamW(network.parameters(), lr=0.0, weight_decay=0.0)
    count, which = STEPS.get(stage.name, 300), EACH.repeat(COPIES.get(stage.name, 1))
    frames = torch.arange(FRAMES).expand(len(which), -1)
    lengths, mask = torch.full((len(which),), FRAMES), torch.ones(len(which), FRAMES, dtype=torch.bool)
    for step in range(count):
        generator = step_generator(0, stage.name, step)
        given, progress = CONDITIONS.rows(which), step / count
        batch = MotionBatch(rows[which], lengths, mask, given, which, frames, generator, step, progress)
        with dropout_from(generator, torch.device("cpu")):
            loss = network.losses(batch)["loss"]
        optimizer.zero_grad()
        loss.backward()
        for group in optimizer.param_groups:
            group["lr"] = 4e-3 * min(1.0, (step + 1) / 20) * 0.5 * (1 + cos(pi * step / count))
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


# Every network learns four motions by heart, and gives each when its action is asked for.
# MDM with 1,000 steps differs from MDM with 50 in its settings alone.
@pytest.mark.parametrize(
    "stage", [MDM_50, MLD, INR_MLP, ACTOR, T2M, CAMDM, FLOW, JL2P, HIER, NEMF], ids=lambda stage: stage.name
)
@pytest.mark.usefixtures("unchecked_shapes")
def test_four_motions_are_learnt_by_heart(stage: PeerStage) -> None:
    torch.set_num_threads(1)
    network, truth = learnt(stage)
    found = reconstructed(network, truth) if isinstance(network, Nemf) else sampled(network, truth.shape[1])
    errors, apart = ((each[:, None] - truth[None]).square().mean(dim=(2, 3)).sqrt() for each in (found, truth))
    assert bool((errors.argmin(dim=1) == EACH).all())
    assert bool((errors.diagonal() < 0.6 * (apart + 1e9 * torch.eye(4)).amin(dim=1)).all())
