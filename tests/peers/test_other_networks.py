"""INR-MLP, ACTOR, T2M, CAMDM and the flow against independent statements: numbers of parameters, passes by hand."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from torch import Tensor

from motionkit.core.errors import UsageError
from motionkit.features import field
from motionkit.features.field import FIELD_VECTORS
from motionkit.training.conditions import ConditionSizes
from peers.actor import ACTOR, Actor, ActorNetworkConfig
from peers.camdm import CAMDM, Camdm, CamdmNetworkConfig
from peers.flow import FLOW, AbsoluteCoordinates, Flow, FlowNetworkConfig
from peers.inr_mlp import INR_MLP, InrMlp, InrMlpNetworkConfig, fit_mixture, length_intervals
from peers.motions import MotionBatch, PoseSpace
from peers.t2m import T2M, T2M_AUTOENCODER, T2m, T2mAutoencoder, T2mAutoencoderNetworkConfig, T2mNetworkConfig
from tests.helpers.nerm_corpus import analytic_positions
from tests.peers.plain_transformer import Weights, layer, linear, norm, part
from tests.peers.test_generative_networks import (
    SIZES,
    TEXTS,
    conditions,
    count,
    decoder_layer_size,
    encoder_layer_size,
    inputs,
    space,
)

CLIP = ConditionSizes(512, ())
ACTIONS = ConditionSizes(0, tuple(f"action-{number}" for number in range(12)))


def dense(*widths: int) -> int:
    return sum(before * after + after for before, after in pairwise(widths))


def positions(count: int, width: int) -> Tensor:
    angles = [[place / 10_000 ** (2 * i / width) for i in range(width // 2)] for place in range(count)]
    return torch.tensor([[f(angle) for angle in row for f in (np.sin, np.cos)] for row in angles], dtype=torch.float32)


def field_space() -> PoseSpace:
    made = space(66)
    made.vectors = FIELD_VECTORS
    return made


def test_published_sizes_have_the_numbers_of_parameters_that_follow_from_their_layers() -> None:
    torch.manual_seed(0)
    # ACTOR on the 150 numbers of HumanAct12: 24 rotations of six numbers, a translation filled up with zeros.
    actor = Actor(ACTOR.recipes["paper"]["network"], inputs(space(150), ACTIONS))
    layers = 8 * (encoder_layer_size(256, 1024) + decoder_layer_size(256, 1024))
    assert count(actor) == dense(150, 256) + dense(256, 150) + 3 * 12 * 256 + layers
    inr = InrMlp(INR_MLP.recipes["paper"]["network"], inputs(space(147), ACTIONS))
    codes = 2 * 7 * 128 + 2 * 12 * 128
    assert count(inr) == codes + dense(512, 1000, 500, 500, 200, 100, 147)
    configs = [stage.recipes["paper"]["network"] for stage in (T2M_AUTOENCODER, T2M)]
    autoencoder = T2mAutoencoder(configs[0], inputs(space(), ConditionSizes(0, ())))
    decoder = (4 * 512 * 512 + 512) + (4 * 512 * 263 + 263) + dense(263, 263)
    assert count(autoencoder) == (4 * 259 * 512 + 512) + (4 * 512 * 512 + 512) + dense(512, 512) + decoder
    temporal = T2m(configs[1], inputs(space(), CLIP, {"t2m-autoencoder": autoencoder}))

    def cell(inputs: int) -> int:
        return dense(inputs, 1024) + 2 * 1024 + 6 * (1024 * 1024 + 1024)

    heads = 2 * 2 * dense(1024, 128) + dense(1024, 1024) + 2 * 1024 + dense(1024, 512)
    sentence = dense(512, 1024) + dense(1024, 512) + 3 * dense(1024, 1024)
    assert count(temporal) == decoder + cell(1024) + cell(1536) + cell(1152) + heads + sentence
    camdm = Camdm(CAMDM.recipes["paper"]["network"], inputs(space(), CLIP))
    ends = 2 * dense(263, 256) + dense(256, 263) + dense(512, 256) + 2 * dense(256, 256) + 256
    assert count(camdm) == ends + 4 * encoder_layer_size(256, 1024)
    flow = Flow(FLOW.recipes["paper"]["network"], inputs(field_space(), CLIP))
    inside = (
        dense(512, 6 * 512) + dense(512, 3 * 512) + dense(512, 512) + 2 * 64 + dense(512, 2 * 1365) + dense(1365, 512)
    )
    outside = dense(66, 512) + 3 * dense(512, 512) + dense(512, 1024) + dense(512, 66)
    assert count(flow) == outside + 8 * inside


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


def leaky(values: Tensor) -> Tensor:
    return torch.where(values > 0, values, 0.2 * values)


def test_two_snippets_of_t2m_are_those_by_hand() -> None:
    torch.manual_seed(3)
    autoencoder = T2mAutoencoder(T2mAutoencoderNetworkConfig(12, 0.0), inputs(space(), ConditionSizes(0, ()))).eval()
    config = T2mNetworkConfig(width=16, value=10, latent=5)
    network = T2m(config, inputs(space(), TEXTS, {"t2m-autoencoder": autoencoder})).eval()
    weights, given = network.state_dict(), conditions(1)
    truth, noise = torch.randn(2, 12), torch.randn(2, 5)
    told, hidden = network._begin(given)
    previous = network._first(torch.zeros(1, 4, 263))
    sentence = linear(weights, "sentence.text", given.text[0])
    value = linear(weights, "value", sentence)
    states = {
        name: linear(weights, f"starts.{row}", sentence) for row, name in enumerate(("prior", "posterior", "decoder"))
    }

    def moved(name: str, known: Tensor, left: int) -> Tensor:
        own = part(weights, f"{name}.")
        embedded = leaky(norm(own, "embed.1", linear(own, "embed.0", known))) + positions(9, 16)[left]
        states[name] = gru(part(own, "cell."), embedded, states[name])
        return states[name]

    last = previous[0]
    for step, left in enumerate((7, 6)):
        previous, kl = network._step(
            previous, told, hidden, torch.tensor([left]), noise[step : step + 1], truth[step : step + 1]
        )
        means = []
        for name, known in (("prior", (last, value)), ("posterior", (last, value, truth[step]))):
            state = moved(name, torch.cat(known), left)
            means.append([linear(weights, f"{name}.{kind}", state) for kind in ("mean", "log_variance")])
        latent = means[1][0] + torch.exp(means[1][1] / 2) * noise[step]
        state = moved("decoder", torch.cat((last, value, latent)), left)
        inner = leaky(norm(weights, "snippet_out.1", linear(weights, "snippet_out.0", state)))
        last = linear(weights, "snippet_out.3", inner)
        torch.testing.assert_close(previous[0], last, rtol=1e-4, atol=1e-5)
        normal = [torch.distributions.Normal(mean, torch.exp(log / 2)) for mean, log in means]
        expected = torch.distributions.kl_divergence(normal[1], normal[0]).sum()
        torch.testing.assert_close(kl[0], expected, rtol=1e-4, atol=1e-5)


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
