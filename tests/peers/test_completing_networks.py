"""The networks that complete motion: plain references, what attends to what, what their papers promise."""

import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor, nn

from pahires.model import PaHiRes
from pahires.temporal.network import ObservedWindow
from peers.inbetweening import DeltaInterp, DeltaInterpNetworkConfig, RelativeEncoder, TsFormer, TsFormerNetworkConfig
from peers.super_resolution import (
    ALiif,
    ALiifNetworkConfig,
    EdsrConfig,
    EdsrEncoder,
    Liif,
    LiifNetworkConfig,
    Lmf,
    LmfNetworkConfig,
    MetaSr,
    MetaSrNetworkConfig,
)
from tests.helpers.tiny_temporal import PAHIRES_NETWORK

POSE = 9
SMALL = EdsrConfig(blocks=1, features=4)
NETWORKS: dict[str, Callable[[], nn.Module]] = {
    "liif": lambda: Liif(LiifNetworkConfig(SMALL, hidden=8, layers=2), POSE),
    "meta-sr": lambda: MetaSr(MetaSrNetworkConfig(SMALL, hidden=8), POSE),
    "a-liif": lambda: ALiif(ALiifNetworkConfig(SMALL, width=6, layers=2, basis=3, expansion_hidden=8), POSE),
    "lmf": lambda: Lmf(LmfNetworkConfig(SMALL, width=6, layers=3), POSE),
    "delta-interp": lambda: DeltaInterp(DeltaInterpNetworkConfig(8, 2, 2, 2, 3, 20), POSE),
    "pahires": lambda: PaHiRes(PAHIRES_NETWORK, POSE),
    "ts-former": lambda: TsFormer(TsFormerNetworkConfig(8, 2, 2, 4, 8), POSE),
}
ENSEMBLES, INBETWEENERS = ("liif", "a-liif", "lmf"), ("delta-interp", "ts-former")
# Ten frames of the past and one of the future around a gap of six, as the LaFAN1 benchmark has them.
AROUND = [*range(10), 16]
GAP = [10.0, 11.0, 12.0, 13.0, 14.0, 15.0]


def small(name: str) -> nn.Module:
    torch.manual_seed(0)
    network = NETWORKS[name]().eval()
    if isinstance(network, PaHiRes):  # its answers start at zero
        nn.init.normal_(network.answer.weight, std=0.1)
    return network


def window_of(kept: list[int], queries: list[float]) -> ObservedWindow:
    """Two windows of random frames at `kept`, with queries, both in frames of 30 fps."""
    frames = torch.randn(2, len(kept), POSE, generator=torch.Generator().manual_seed(len(kept)))
    times, instants = torch.tensor(kept) / 30, torch.tensor(queries, dtype=torch.float32) / 30
    return ObservedWindow(frames, times.expand(2, -1), instants.expand(2, -1), torch.full((2,), 1 / 30))


def close(found: Tensor, expected: Tensor) -> None:
    torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-4)


def test_the_encoder_has_edsr_baselines_size_and_sees_69_frames() -> None:
    encoder = EdsrEncoder(EdsrConfig(), 135)
    # Head 3·135·64 + 64, then 33 convolutions of 3·64·64 + 64.
    assert sum(each.numel() for each in encoder.parameters()) == 25_984 + 33 * 12_352 == 433_600
    frames = torch.randn(1, 201, 135, generator=torch.Generator().manual_seed(0)).requires_grad_()
    encoder(frames)[0, 100].sum().backward()
    assert frames.grad is not None
    felt = torch.nonzero(frames.grad[0].abs().sum(dim=1)).flatten()
    assert felt.tolist() == list(range(100 - 34, 100 + 35))


def _codes(network: nn.Module, rows: Tensor) -> Tensor:
    """Each frame's features beside its neighbours'."""
    features, last = network.encoder(rows[None])[0], len(rows) - 1
    return torch.stack(
        [torch.cat([features[min(max(i + step, 0), last)] for step in (-1, 0, 1)]) for i in range(last + 1)]
    )


def _liif(network: Liif, code: Tensor, relative: float, cell: float) -> Tensor:
    return network.decoder(torch.cat((code, torch.tensor([2 * relative, 2 * cell]))))


def _a_liif(network: ALiif, code: Tensor, relative: float, cell: float) -> Tensor:
    """The mixed weights themselves, as the paper writes it, then an ordinary MLP."""
    hidden = torch.cat((code, torch.tensor([2 * relative, 2 * cell])))
    coefficients = network.expansion(hidden)
    coefficients = coefficients / torch.sqrt((coefficients**2).sum())
    for number, layer in enumerate(network.decoder.layers):
        weight, bias = (
            torch.einsum("k,k...->...", coefficients, values.unflatten(0, (len(coefficients), -1)))
            for values in (layer.weight, layer.bias)
        )
        hidden = weight @ (torch.clamp(hidden, min=0) if number else hidden) + bias
    return hidden


def _lmf(network: Lmf, code: Tensor, relative: float, cell: float) -> Tensor:
    cell = cell * max(1 / cell / 4, 1.0)
    modulation = network.latent(torch.cat((code, torch.tensor([2 * cell]))))
    scales, shifts, latent = modulation.split((18, 18, 6))
    hidden = torch.cat((latent, torch.tensor([2 * relative, 2 * cell])))
    for layer, scale, shift in zip(network.layers, scales.split(6), shifts.split(6), strict=True):
        hidden = torch.clamp(layer(hidden) * (1 + scale) + shift, min=0)
    return network.output(hidden)


def _meta_sr(network: MetaSr, code: Tensor, relative: float, cell: float) -> Tensor:
    return code @ network.weights(torch.tensor([relative, cell])).view(len(code), POSE)


REFERENCES = {"liif": _liif, "a-liif": _a_liif, "lmf": _lmf, "meta-sr": _meta_sr}


@pytest.mark.parametrize("name", REFERENCES)
# Kept frames of × 2.4 (a real frame each), of × 5, and a query before the first and after the last frame.
@pytest.mark.parametrize("kept", [[0, 2, 4, 7, 9], [0, 5, 10, 15]])
@torch.no_grad()
def test_super_resolution_is_its_plain_reference(name: str, kept: list[int]) -> None:
    network = small(name)
    queries = [0.0, 1.0, 2.0, 3.5, 6.9, 8.0, float(kept[-1]), -0.5, kept[-1] + 0.5]
    window = window_of(kept, queries)
    made, spacing = network(window), kept[-1] / (len(kept) - 1)
    for batch in range(2):
        codes = _codes(network, window.frames[batch])
        for query, instant in enumerate(queries):
            before = max((row for row, frame in enumerate(kept) if frame <= instant), default=0)
            after = min((row for row, frame in enumerate(kept) if frame > instant), default=len(kept) - 1)
            first, second = (
                REFERENCES[name](network, codes[row], (instant - kept[row]) / spacing, 1 / spacing)
                for row in (before, after)
            )
            mixes = name in ENSEMBLES and before != after
            share = (instant - kept[before]) / (kept[after] - kept[before]) if mixes else 0.0
            # Meta-SR's places are rounded to 1e-4 of a frame.
            close(made[batch, query], (1 - share) * first + share * second)


def _encoded(
    encoder: RelativeEncoder, rows: Tensor, positions: Tensor, keys: int, added: Tensor | float = 0.0
) -> Tensor:
    """A relative transformer encoder, head by head and pair by pair; rows attend to the first `keys`."""
    rows = encoder.enter(rows) + added
    distances = encoder.distance((positions[None, :keys] - positions[:, None])[..., None])
    for layer in encoder.layers:
        normed, mixed = layer.before_attention(rows), []
        for head in range(layer.heads):
            q, k, v = (
                projected[:, head * 4 : (head + 1) * 4]
                for projected in (layer.query(normed), layer.key(normed[:keys]), layer.value(normed[:keys]))
            )
            scores = torch.einsum("rc,rkc->rk", q, k + distances) / math.sqrt(rows.shape[1])
            mixed.append(torch.softmax(scores, dim=1) @ v)
        rows = rows + layer.out(torch.cat(mixed, dim=1))
        rows = rows + layer.inner(layer.before_inner(rows))
    return encoder.leave(encoder.norm(rows))


@torch.no_grad()
def test_ts_former_is_its_plain_reference_of_two_stages() -> None:
    network, window = small("ts-former"), window_of(AROUND, GAP)
    assert isinstance(network, TsFormer)
    made, positions = network(window), torch.tensor([*AROUND, *GAP])
    known = torch.cat((torch.ones(11, 1), torch.zeros(6, 1)))
    keyframes = network.keyframe_position(torch.stack((positions - 9, 16 - positions), dim=1))
    share = (torch.tensor(GAP)[:, None] - 9) / 7
    for batch, poses in enumerate(window.frames):
        placeholders = torch.zeros(6, POSE)
        placeholders[:, :3] = (1 - share) * poses[9, :3] + share * poses[10, :3]
        entered = torch.cat((torch.cat((poses, placeholders)), known), dim=1)
        draft = _encoded(network.context, entered, positions, keys=11, added=keyframes)[11:]
        # In the second stage everything attends to everything: the given frames and all six drafts.
        refined = _encoded(network.detail, torch.cat((torch.cat((poses, draft)), known), dim=1), positions, keys=17)
        close(made[batch], draft + refined[11:])


@pytest.mark.parametrize("name", NETWORKS)
def test_an_answer_depends_on_its_instant_alone(name: str) -> None:
    network, kept = small(name), AROUND if name in INBETWEENERS else [0, 3, 6, 9]
    together = network(window_of(kept, [*GAP, 4.0, 9.0, 17.0, -1.0, 11.5]))
    close(network(window_of(kept, [4.0, 13.0, 11.5])), together[:, [6, 3, 10]])


@pytest.mark.parametrize("name", INBETWEENERS)
def test_an_inbetweeners_answer_moves_with_its_instant(name: str) -> None:
    near = small(name)(window_of(AROUND, [12.0, 12.001, 12.5, 13.0])).detach()
    moved = (near[:, 1:] - near[:, :1]).abs().amax(dim=(0, 2))
    assert float(moved[0]) < 0.01 * float(moved[2])


@pytest.mark.parametrize("name", NETWORKS)
def test_one_frame_is_an_answer_and_every_parameter_is_learnt(name: str) -> None:
    network = small(name)
    for kept in ([0], [0, 1]):
        alone = network(window_of(kept, [0.0, 1.0, 5.0]))
        assert alone.shape == (2, 3, POSE) and bool(torch.isfinite(alone).all())
    network(window_of(AROUND if name in INBETWEENERS else [0, 2, 4, 7, 9], GAP)).square().sum().backward()
    still = [key for key, each in network.named_parameters() if each.grad is None or not bool(each.grad.any())]
    assert still == []
