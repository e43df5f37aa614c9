"""Each generative network against an independent statement of it: numbers of parameters, and passes by hand."""

from collections.abc import Mapping
from fractions import Fraction

import numpy as np
import pytest
import torch
from torch import Tensor

from motionkit.core.errors import UsageError
from motionkit.core.skeleton import SMPL22
from motionkit.features import field, native
from motionkit.features.field import FIELD_VECTORS
from motionkit.features.native import NativeVectors
from motionkit.training.config import DiffusionConfig, Prediction
from motionkit.training.networks import Conditions, ConditionSizes
from motionkit.training.pose_vectors import VectorScaling
from peers.actor import Actor, ActorNetworkConfig
from peers.camdm import Camdm, CamdmNetworkConfig
from peers.flow import AbsoluteCoordinates, Flow, FlowNetworkConfig
from peers.hier import Hier, HierNetworkConfig, body_parts
from peers.inr_mlp import InrMlp, InrMlpNetworkConfig, fit_mixture, length_intervals
from peers.jl2p import Jl2p, Jl2pNetworkConfig
from peers.layers import NetworkInputs, TransformerSizes, diffusion_loss, diffusion_sample
from peers.mdm import MDM, MDM_50, Mdm, MdmNetworkConfig
from peers.mld import MLD, MLD_VAE, Mld, MldNetworkConfig, MldVae, MldVaeNetworkConfig
from peers.motions import MotionBatch, PoseSpace, SampleBatch
from peers.nemf import Nemf, NemfNetworkConfig, NemfPath, NemfPathNetworkConfig, with_velocities
from tests.helpers.nerm_corpus import analytic_positions
from tests.peers.plain_transformer import Weights, layer, linear, long_skips, norm, part

FPS = Fraction(20)
SIZES = TransformerSizes(3, 16, 2, 24, 0.1)
TEXTS = ConditionSizes(6, ())


def space(numbers: int = 263) -> PoseSpace:
    return PoseSpace(NativeVectors(), VectorScaling(torch.zeros(numbers), torch.ones(numbers)), FPS)


def inputs(
    of: PoseSpace,
    sizes: ConditionSizes,
    earlier: Mapping[str, torch.nn.Module] = {},
    num_windows: int = 7,
) -> NetworkInputs:
    return NetworkInputs(of, sizes, num_windows, earlier)


def count(network: torch.nn.Module) -> int:
    return sum(parameter.numel() for parameter in network.parameters())


def conditions(rows: int, dimension: int = 6) -> Conditions:
    text = torch.randn((rows, dimension), generator=torch.Generator().manual_seed(3))
    return Conditions(text, torch.full((rows,), -1), torch.ones(rows, dtype=torch.bool), torch.ones(rows))


# A layer of width d and inner width f: four d×d maps with biases, two norms, and d×f, f×d with biases.
def encoder_layer_size(d: int, f: int) -> int:
    return 4 * (d * d + d) + 2 * 2 * d + (d * f + f) + (f * d + d)


def decoder_layer_size(d: int, f: int) -> int:
    return encoder_layer_size(d, f) + 4 * (d * d + d) + 2 * d


def test_published_sizes_have_the_published_numbers_of_parameters() -> None:
    """MDM's 17.9 million (its Table 1 of sizes, without CLIP); those of MLD follow from its layers by hand."""
    torch.manual_seed(0)
    for stage in (MDM, MDM_50):
        mdm = Mdm(stage.recipes["paper"]["network"], inputs(space(), ConditionSizes(512, ())))
        by_hand = 2 * (512 * 263) + 512 + 263 + 3 * (512 * 512 + 512) + 8 * encoder_layer_size(512, 1024)
        assert count(mdm) == by_hand == 17_880_327
    vae = MldVae(MLD_VAE.recipes["paper"]["network"], inputs(space(), ConditionSizes(0, ())))
    skips = 4 * (512 * 256 + 256) + 2 * 256
    both = 9 * encoder_layer_size(256, 1024) + 9 * decoder_layer_size(256, 1024) + 2 * skips
    assert count(vae) == 2 * 263 * 256 + 256 + 263 + 2 * 256 + 2 * 500 * 256 + both
    mld = Mld(MLD.recipes["paper"]["network"], inputs(space(), ConditionSizes(768, ()), {"mld-vae": vae}))
    maps = 2 * (768 * 256 + 256) + (256 * 256 + 256) + 3 * 256
    assert count(mld) == maps + 9 * encoder_layer_size(256, 1024) + skips


def test_a_pass_of_mdm_is_the_one_by_hand() -> None:
    torch.manual_seed(1)
    network = Mdm(MdmNetworkConfig(SIZES), inputs(space(), TEXTS)).eval()
    lengths, steps, given = torch.tensor([5, 3]), torch.tensor([7, 900]), conditions(2)
    noisy = torch.randn(2, 5, 263)
    found = network(noisy, steps, given, lengths)
    weights = network.state_dict()
    for row in range(2):
        own = int(lengths[row])

        def position(place: int) -> torch.Tensor:
            angles = [place / 10_000 ** (2 * i / 16) for i in range(8)]
            return torch.tensor([f(angle) for angle in angles for f in (np.sin, np.cos)], dtype=torch.float32)

        time = linear(weights, "step_in.0", position(int(steps[row])))
        first = linear(weights, "step_in.2", time * torch.sigmoid(time)) + linear(weights, "text_in", given.text[row])
        tokens = torch.cat((first[None], linear(weights, "frame_in", noisy[row, :own])))
        tokens = tokens + torch.stack([position(place) for place in range(own + 1)])
        for number in range(3):
            tokens = layer(part(weights, f"layers.layers.{number}."), tokens, heads=2)
        expected = linear(weights, "frame_out", tokens[1:])
        torch.testing.assert_close(found[row, :own], expected, rtol=1e-4, atol=1e-5)


def test_a_pass_of_mlds_vae_is_the_one_by_hand() -> None:
    torch.manual_seed(2)
    vae = MldVae(MldVaeNetworkConfig(SIZES, longest=20), inputs(space(), ConditionSizes(0, ()))).eval()
    lengths, rows = torch.tensor([6, 4]), torch.randn(2, 6, 263)
    batch = MotionBatch(rows, lengths, conditions(2, 0), torch.arange(2), torch.arange(6).expand(2, -1))
    mean, log_variance = vae.encode(rows, lengths)
    made = vae.decode(mean, batch.mask)
    weights = vae.state_dict()
    for row in range(2):
        own = int(lengths[row])
        tokens = torch.cat((weights["distribution"], linear(weights, "frame_in", rows[row, :own])))
        tokens = long_skips(part(weights, "encoder."), tokens + weights["encoder_positions"][: own + 2], 2, 3)
        torch.testing.assert_close(torch.stack((mean[row], log_variance[row])), tokens[:2], rtol=1e-4, atol=1e-5)
        queries = weights["decoder_positions"][:own]
        out = long_skips(part(weights, "decoder."), queries, 2, 3, memory=tokens[:1])
        torch.testing.assert_close(made[row, :own], linear(weights, "frame_out", out), rtol=1e-4, atol=1e-5)
    assert not made[1, 4:].any()


def test_a_pass_of_mlds_denoiser_is_the_one_by_hand() -> None:
    torch.manual_seed(3)
    vae = MldVae(MldVaeNetworkConfig(SIZES, longest=20), inputs(space(), ConditionSizes(0, ())))
    network = Mld(MldNetworkConfig(SIZES, time_features=12), inputs(space(), TEXTS, {"mld-vae": vae})).eval()
    noisy, steps, given = torch.randn(2, 1, 16), torch.tensor([3, 500]), conditions(2)
    found = network(noisy, steps, given)
    weights = network.state_dict()
    assert not [name for name in weights if "vae" in name]
    for row in range(2):
        angles = torch.tensor([int(steps[row]) / 10_000 ** (i / 6) for i in range(6)])
        time = linear(weights, "step_in.0", torch.cat((angles.cos(), angles.sin())))
        time = linear(weights, "step_in.2", time * torch.sigmoid(time))
        text = linear(weights, "text_in.1", given.text[row].clamp(min=0))
        tokens = torch.stack((noisy[row, 0], time, text)) + weights["positions"]
        expected = long_skips(part(weights, "layers."), tokens, 2, 3)
        torch.testing.assert_close(found[row, 0], expected[0], rtol=1e-3, atol=1e-4)


def test_joints_are_those_of_the_vectors() -> None:
    positions = analytic_positions(np.arange(50) / 20, 2)
    vectors = native.vectors(positions, "smpl22", FPS)
    mean, scale = torch.linspace(-1, 1, 263), torch.linspace(0.5, 2, 263)
    of = PoseSpace(NativeVectors(), VectorScaling(mean, scale), FPS)
    found = of.joints(((torch.from_numpy(vectors) - mean) / scale)[None])
    np.testing.assert_allclose(found[0].numpy(), native.positions(vectors, "smpl22", FPS), atol=1e-5)


@pytest.mark.parametrize("prediction", ["noise", "latent", "velocity"])
@pytest.mark.parametrize("sampler", ["ddpm", "ddim"])
def test_nothing_is_copied_from_the_device_in_a_step(sampler: str, prediction: Prediction) -> None:
    """A tensor on torch's device "meta" has no values, so copying it to the CPU is an error."""
    device = torch.device("meta")
    config = DiffusionConfig(
        num_steps=8, schedule="cosine", prediction=prediction, sampler=sampler, sampling_steps=8, guidance_scale=2.5
    )

    def output(noisy: torch.Tensor, steps: torch.Tensor, told: Conditions) -> torch.Tensor:
        assert {noisy.device, steps.device, told.given.device} == {device}
        return noisy

    clean, mask = torch.zeros(2, 3, 4, device=device), torch.ones(2, 3, dtype=torch.bool, device=device)
    loss = diffusion_loss(output, clean, mask, conditions(2).to(device), config, torch.Generator())
    assert loss.device == device
    batch = SampleBatch(
        lengths=torch.tensor([3, 2]),
        conditions=conditions(2),
        unconditional=conditions(2),
        generators=[torch.Generator() for _ in range(2)],
        device=device,
    )
    found = diffusion_sample(output, batch, lambda: batch.noise_within(batch.lengths, 4), config)
    assert (found.device, found.dtype, found.shape) == (device, torch.float64, (2, 3, 4))


def positions(count: int, width: int) -> Tensor:
    angles = [[place / 10_000 ** (2 * i / width) for i in range(width // 2)] for place in range(count)]
    return torch.tensor([[f(angle) for angle in row for f in (np.sin, np.cos)] for row in angles], dtype=torch.float32)


def field_space() -> PoseSpace:
    made = space(66)
    made.vectors = FIELD_VECTORS
    return made


def test_a_pass_of_inr_mlp_is_the_one_by_hand() -> None:
    torch.manual_seed(1)
    network = InrMlp(InrMlpNetworkConfig(4, 8, (10, 6)), inputs(field_space(), TEXTS, num_windows=3))
    code, told, frames = torch.randn(2, 4), torch.randn(2, 4), torch.tensor([[0, 7, 3], [5, 5, 1]])
    found, weights = network(frames, code, told), network.state_dict()
    for row in range(2):
        for column in range(3):
            hidden = torch.cat((code[row], told[row], positions(8, 8)[frames[row, column]]))
            for number in (0, 2):
                hidden = linear(weights, f"layers.{number}", hidden)
                hidden = torch.where(hidden > 0, hidden, hidden.exp() - 1)
            expected = linear(weights, "layers.4", hidden)
            torch.testing.assert_close(found[row, column], expected, rtol=1e-4, atol=1e-5)


def test_mixtures_are_of_motions_of_one_action_and_length() -> None:
    lengths = np.repeat([30, 60, 62, 90], 40)
    found = [np.unique(lengths[rows]).tolist() for rows in length_intervals(lengths)]
    # 50 codes and ten frames at least, 50 more behind, and the same length on one side.
    assert found == [[30, 60], [62, 90]]
    assert sum(len(rows) for rows in length_intervals(lengths)) == 160
    rng = np.random.default_rng(0)
    centres = np.array([np.full(16, 2.0), np.full(16, -2.0)])
    codes = centres.repeat(20, axis=0) + rng.standard_normal((40, 16))
    mixture = fit_mixture(codes, np.full_like(codes, 0.1), reseeds=1)
    drawn = torch.stack([mixture.draw(torch.Generator().manual_seed(seed)) for seed in range(400)]).numpy()
    near = np.linalg.norm(drawn[:, None] - centres, axis=2).min(axis=1)
    assert (near < 8).mean() > 0.97 and 0.3 < (drawn[:, 0] > 0).mean() < 0.7


def test_a_pass_of_actor_is_the_one_by_hand() -> None:
    torch.manual_seed(2)
    network = Actor(ActorNetworkConfig(SIZES), inputs(space(), TEXTS)).eval()
    lengths, rows, given = torch.tensor([6, 4]), torch.randn(2, 6, 263), conditions(2)
    mean, log_variance = network.encode(rows, lengths, given)
    batch = MotionBatch(rows, lengths, given, torch.arange(2), torch.arange(6).expand(2, -1))
    made, weights = network.decode(mean, batch.mask, given), network.state_dict()
    for row in range(2):
        own = int(lengths[row])
        first = [linear(weights, f"{name}_token.text", given.text[row]) for name in ("mean", "variance")]
        tokens = torch.cat((torch.stack(first), linear(weights, "frame_in", rows[row, :own])))
        tokens = tokens + positions(own + 2, 16)
        for number in range(3):
            tokens = layer(part(weights, f"encoder.layers.{number}."), tokens, 2)
        torch.testing.assert_close(torch.stack((mean[row], log_variance[row])), tokens[:2], rtol=1e-4, atol=1e-5)
        memory, tokens = tokens[:1] + linear(weights, "bias.text", given.text[row]), positions(own, 16)
        for number in range(3):
            tokens = layer(part(weights, f"decoder.layers.{number}."), tokens, 2, memory=memory)
        torch.testing.assert_close(made[row, :own], linear(weights, "frame_out", tokens), rtol=1e-3, atol=1e-4)
    assert not made[1, 4:].any()


def gru(weights: Weights, inputs: Tensor, hidden: Tensor) -> Tensor:
    """A gated recurrent unit, written out (torch's order of gates: reset, update, new)."""
    of_inputs = (inputs @ weights["weight_ih"].T + weights["bias_ih"]).chunk(3)
    of_hidden = (hidden @ weights["weight_hh"].T + weights["bias_hh"]).chunk(3)
    reset, update = (torch.sigmoid(of_inputs[gate] + of_hidden[gate]) for gate in (0, 1))
    new = torch.tanh(of_inputs[2] + reset * of_hidden[2])
    return (1 - update) * new + update * hidden


def test_a_pass_of_camdm_is_the_one_by_hand() -> None:
    torch.manual_seed(4)
    network = Camdm(CamdmNetworkConfig(SIZES, past=3, future=5), inputs(space(), TEXTS)).eval()
    torch.nn.init.normal_(network.no_past)
    noisy, past, given = torch.randn(2, 5, 263), torch.randn(2, 3, 263), conditions(2)
    found = network(noisy, torch.tensor([1, 3]), given, past, torch.tensor([True, False]))
    weights = network.state_dict()
    for row, step in enumerate((1, 3)):
        time = linear(weights, "step_in.0", positions(4, 16)[step])
        time = linear(weights, "step_in.2", time * torch.sigmoid(time))
        before = linear(weights, "past_in", past[row]) if row == 0 else weights["no_past"].expand(3, -1)
        told = linear(weights, "condition.text", given.text[row])
        tokens = torch.cat((time[None], told[None], before, linear(weights, "frame_in", noisy[row])))
        tokens = tokens + positions(10, 16)
        for number in range(3):
            tokens = layer(part(weights, f"layers.layers.{number}."), tokens, 2)
        torch.testing.assert_close(found[row], linear(weights, "frame_out", tokens[5:]), rtol=1e-3, atol=1e-4)


def root_mean_square(values: Tensor) -> Tensor:
    return values / torch.sqrt(values.square().mean(-1, keepdim=True) + torch.finfo(torch.float32).eps)


def flow_layer(weights: Weights, tokens: Tensor, told: Tensor, heads: int) -> Tensor:
    """AdaLN-zero, rotary positions, attention and SwiGLU, head by head and frame by frame."""
    moved = linear(weights, "moved", told).chunk(6)
    width = tokens.shape[1]
    size = width // heads
    hidden = linear(weights, "qkv", root_mean_square(tokens) * (1 + moved[1]) + moved[0])
    mixed = torch.empty_like(tokens)
    for head in range(heads):
        q, k, v = (hidden[:, kind * width + head * size :][:, :size] for kind in range(3))
        q, k = root_mean_square(q) * weights["query_norm.weight"], root_mean_square(k) * weights["key_norm.weight"]
        for each in (q, k):
            for frame in range(len(tokens)):
                for pair in range(size // 2):
                    angle = torch.tensor(frame / 10_000 ** (2 * pair / size))
                    first, second = each[frame, pair].clone(), each[frame, pair + size // 2].clone()
                    each[frame, pair] = first * angle.cos() - second * angle.sin()
                    each[frame, pair + size // 2] = first * angle.sin() + second * angle.cos()
        mixed[:, head * size : (head + 1) * size] = torch.softmax(q @ k.T / size**0.5, dim=1) @ v
    tokens = tokens + moved[2] * linear(weights, "attended", mixed)
    gate, up = linear(weights, "gate_up", root_mean_square(tokens) * (1 + moved[4]) + moved[3]).chunk(2, dim=1)
    return tokens + moved[5] * linear(weights, "down", gate * torch.sigmoid(gate) * up)


def test_a_pass_of_the_flow_is_the_one_by_hand() -> None:
    torch.manual_seed(5)
    network = Flow(FlowNetworkConfig(SIZES), inputs(field_space(), TEXTS)).eval()
    for weight in network.parameters():  # what starts as zeros would hide all behind it
        torch.nn.init.normal_(weight, std=0.2)
    noisy, lengths, times, given = torch.randn(2, 5, 66), torch.tensor([5, 3]), torch.tensor([0.25, 0.9]), conditions(2)
    found, weights = network(noisy, times, given, lengths), network.state_dict()
    for row in range(2):
        own = int(lengths[row])
        angles = [float(times[row]) * 1000 / 10_000 ** (2 * i / 16) for i in range(8)]
        time = torch.tensor([f(angle) for angle in angles for f in (np.sin, np.cos)], dtype=torch.float32)
        time = linear(weights, "time_in.0", time)
        told = linear(weights, "time_in.2", time * torch.sigmoid(time)) + linear(
            weights, "condition.text", given.text[row]
        )
        told = told * torch.sigmoid(told)
        tokens = linear(weights, "frame_in", noisy[row, :own])
        for number in range(3):
            tokens = flow_layer(part(weights, f"layers.{number}."), tokens, told, 2)
        shift, scale = linear(weights, "last", told).chunk(2)
        expected = linear(weights, "frame_out", root_mean_square(tokens) * (1 + scale) + shift)
        torch.testing.assert_close(found[row, :own], expected, rtol=1e-3, atol=1e-4)


def test_absolute_coordinates_are_the_joints() -> None:
    positions_of = analytic_positions(np.arange(20) / 20, 1).astype(np.float32)
    rows = torch.from_numpy(field.encode(positions_of[None], np.zeros(1), np.zeros((1, 2))))
    of = field_space()
    of.mean, of.scale = torch.linspace(-1, 1, 66), torch.linspace(0.5, 2, 66)
    coordinates = AbsoluteCoordinates(of)
    standard = coordinates.absolute((rows - of.mean) / of.scale)
    mean, scale = coordinates._standard()
    np.testing.assert_allclose((standard.view(20, 22, 3) * scale + mean).numpy(), positions_of, atol=1e-5)
    torch.testing.assert_close(coordinates.relative(standard), (rows - of.mean) / of.scale, atol=1e-5, rtol=1e-5)
    with pytest.raises(UsageError, match=r"motions.pose_vectors=field"):
        AbsoluteCoordinates(space())


TINY_HIER = HierNetworkConfig(part=3, limb=5, width=7, critic=(4, 6))


def batch_of(lengths: list[int]) -> MotionBatch:
    torch.manual_seed(5)
    rows, frames = torch.randn(len(lengths), max(lengths), 263), torch.arange(max(lengths))
    seen = frames < torch.tensor(lengths)[:, None]
    told = conditions(len(lengths))
    return MotionBatch(
        rows * seen[..., None], torch.tensor(lengths), told, torch.arange(len(lengths)), frames.expand(len(lengths), -1)
    )


def test_a_pass_of_jl2p_is_the_one_by_hand() -> None:
    torch.manual_seed(1)
    network, batch = Jl2p(Jl2pNetworkConfig(6), inputs(space(), TEXTS)), batch_of([5, 3])
    weights = network.state_dict()
    encoder = {name.removesuffix("_l0"): weight for name, weight in part(weights, "encoder.").items()}
    codes, first = network.encode(batch.rows, batch.lengths), batch.rows[:, 0]
    made = network.decode(codes, first, 4)
    for row, length in enumerate((5, 3)):
        state = torch.zeros(6)
        for frame in range(length):
            state = gru(encoder, batch.rows[row, frame], state)
        torch.testing.assert_close(codes[row], state, rtol=1e-4, atol=1e-5)
        pose = first[row]
        for frame in range(4):
            state = gru(part(weights, "cell."), pose, state)
            pose = pose + linear(weights, "change", state)
            torch.testing.assert_close(made[row, frame], pose, rtol=1e-4, atol=1e-4)


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
    with pytest.raises(UsageError, match=r"motions.pose_vectors=native"):
        body_parts(field_space())


def tree(weights: Weights, row: Tensor, parts: list[list[int]]) -> list[Tensor]:
    """Limbs with the trunk, of one pose."""
    of_parts = [linear(weights, f"of_parts.{number}", row[numbers]) for number, numbers in enumerate(parts)]
    return [linear(weights, f"of_limbs.{limb}", torch.cat((of_parts[limb], of_parts[4]))) for limb in range(4)]


def test_a_pass_of_hier_is_the_one_by_hand() -> None:
    torch.manual_seed(3)
    network, batch = Hier(TINY_HIER, inputs(space(), TEXTS)).eval(), batch_of([4, 2])
    for each in network.encoder.norms:
        each.running_mean.normal_(), each.running_var.uniform_(0.5, 2.0)
    weights, parts = network.state_dict(), body_parts(space())
    codes = network.encoder(batch.rows, batch.lengths)
    made = network.decoder(codes, batch.rows[:, 0], 3)
    encoder, decoder = part(weights, "encoder."), part(weights, "decoder.")
    for row, length in enumerate((4, 2)):
        states = [torch.zeros(7), torch.zeros(7)]
        for frame in range(length):
            limbs = tree(encoder, batch.rows[row, frame], parts)
            for half in range(2):
                norm = part(encoder, f"norms.{half}.")
                pair = torch.cat((limbs[2 * half], limbs[2 * half + 1]))
                pair = (pair - norm["running_mean"]) / (norm["running_var"] + 1e-5).sqrt()
                cell = {name.removesuffix("_l0"): each for name, each in part(encoder, f"cells.{half}.").items()}
                states[half] = gru(cell, pair * norm["weight"] + norm["bias"], states[half])
        torch.testing.assert_close(codes[:, row], torch.stack(states), rtol=1e-4, atol=1e-5)
        pose = batch.rows[row, 0]
        for frame in range(3):
            change, trunks = torch.zeros(263), []
            for half in range(2):
                told = pose[parts[2 * half] + parts[2 * half + 1] + parts[4]]
                states[half] = gru(part(decoder, f"cells.{half}."), told, states[half])
                pair = linear(decoder, f"to_pairs.{half}", states[half])
                for limb, own in ((2 * half, pair[:5]), (2 * half + 1, pair[5:])):
                    inner = linear(decoder, f"to_limbs.{limb}", own)
                    change[parts[limb]] = linear(decoder, f"to_parts.{limb}", inner[:3])
                    trunks.append(linear(decoder, "to_parts.4", inner[3:]))
            change[parts[4]] = sum(trunks) / 4
            pose = pose + change
            torch.testing.assert_close(made[row, frame], pose, rtol=1e-4, atol=1e-4)


NONE = ConditionSizes(0, ())
TINY_PATH = NemfPathNetworkConfig(widths=(5, 4), kernel=3)
TINY_NEMF = NemfNetworkConfig(
    16, (5, 6), local_latent=4, turn_latent=3, frequencies=2, width=7, local_layers=3, turn_layers=2, kl_cycles=4
)


def tiny(config: NemfNetworkConfig = TINY_NEMF) -> Nemf:
    torch.manual_seed(1)
    return Nemf(config, inputs(space(), NONE, {"nemf-path": NemfPath(TINY_PATH, inputs(space(), NONE))})).eval()


def cropped(rows: Tensor, lengths: list[int]) -> MotionBatch:
    batch, frames = rows.shape[:2]
    nothing = conditions(batch, 0).unconditional()
    seen = torch.arange(frames) < torch.tensor(lengths)[:, None]
    every = torch.arange(frames).expand(batch, -1)
    return MotionBatch(rows * seen[..., None], torch.tensor(lengths), nothing, torch.arange(batch), every)


def test_a_field_is_the_one_by_hand() -> None:
    network = tiny()
    local, turns = torch.randn(2, 4), torch.randn(2, 3)
    positions, rotations, orientation = network(16, local, turns)
    weights = network.state_dict()

    def layer(name: str, inputs: Tensor) -> Tensor:
        return norm(weights, f"{name}.1", linear(weights, f"{name}.0", inputs)).clamp(min=0)

    for row in range(2):
        for frame in (0, 5, 15):
            time = frame / 8 - 1
            waves = torch.tensor([np.sin(time), np.cos(time), np.sin(2 * time), np.cos(2 * time)], dtype=torch.float32)
            told = torch.cat((waves, local[row]))
            hidden = layer("local_layers.0", told)
            for number in (1, 2):
                hidden = layer(f"local_layers.{number}", torch.cat((hidden, told)))
            pose = linear(weights, "pose_out", hidden)
            for number in (0, 1):
                hidden = layer(f"turn_layers.{number}", torch.cat((hidden, told, turns[row])))
            expected = torch.cat((pose, linear(weights, "turn_out", hidden)))
            found = torch.cat((positions[row, frame], rotations[row, frame], orientation[row, frame]))
            torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-5)


def residual(weights: Weights, values: Tensor, share: float, *, halves: bool) -> Tensor:
    """Of frames [frames, inputs], convolution by sums over its taps; before the activation, and what is kept."""
    taps = weights["changed.weight"]
    kernel, step = taps.shape[2], 2 if halves else 1
    around = (kernel - 1) // 2
    padded = torch.cat((torch.zeros(around, values.shape[1]), values, torch.zeros(around, values.shape[1])))
    starts = range(0, len(padded) - kernel + 1, step)
    changed = [sum(taps[:, :, tap] @ padded[start + tap] for tap in range(kernel)) for start in starts]
    changed = torch.stack(changed) + weights["changed.bias"]
    kept = (values[::2] + values[1::2]) / 2 if halves else values
    kept = kept @ weights["kept.weight"][:, :, 0].T + weights["kept.bias"]
    changed = torch.tanh(changed) if halves else changed
    return torch.stack((share * changed, (1 - share) * kept))


def test_latents_are_those_by_hand() -> None:
    network, rows, lengths = tiny(), torch.randn(2, 16, 263), [16, 11]
    batch = cropped(rows, lengths)
    (found, log_variance), (turns, _) = network.encode(batch.rows, batch.lengths)
    weights = part(network.state_dict(), "local_encoder.")
    for row, length in enumerate(lengths):
        poses = torch.zeros(16, 189)
        poses[:length] = rows[row, :length, 4:193]
        changes = torch.zeros(16, 189)
        changes[: length - 1] = (poses[1:length] - poses[: length - 1]) * float(network.space.fps) / 4
        values = torch.cat((poses, changes), dim=1)
        for number, share in ((0, 1 / 2), (1, 1 / 3)):
            values = residual(part(weights, f"layers.{number}."), values, share, halves=True).sum(dim=0)
        flat = values.T.flatten()
        torch.testing.assert_close(found[row], linear(weights, "mean", flat), rtol=1e-4, atol=1e-4)
        torch.testing.assert_close(log_variance[row], linear(weights, "log_variance", flat), rtol=1e-4, atol=1e-4)
    # A motion's latents know nothing of the zeros behind it.
    alone = network.encode(rows[1:, :11], torch.tensor([11]))
    torch.testing.assert_close(alone[0][0], found[1:], rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(alone[1][0], turns[1:], rtol=1e-4, atol=1e-5)


def test_a_path_is_the_one_by_hand() -> None:
    torch.manual_seed(2)
    network, rows = NemfPath(TINY_PATH, inputs(space(), NONE)), torch.randn(1, 9, 263)
    root, contacts = network(rows, torch.tensor([9]))
    weights = network.state_dict()
    values = with_velocities(rows[..., 4:193], torch.tensor([9]), float(network.space.fps))[0]
    values = torch.cat((values, rows[0, :, :1]), dim=1)
    for number, share in ((0, 1 / 2), (1, 1 / 3), (2, 1 / 4)):
        own = part(weights, f"layers.{number}.")
        changed, kept = residual(own, values, share, halves=False)
        if number < 2:
            changed = torch.where(changed > 0, changed, own["activation.weight"] * changed)
        values = changed + kept
    torch.testing.assert_close(torch.cat((root[0], contacts[0]), dim=1), values, rtol=1e-4, atol=1e-5)
    # A motion's path knows nothing of what is behind it.
    shorter, _ = network(rows, torch.tensor([6]))
    torch.testing.assert_close(shorter[:, :6], network(rows[:, :6], torch.tensor([6]))[0], rtol=1e-4, atol=1e-5)
