"""The grid peers (LIIF, Meta-SR, A-LIIF, LMF): sizes by hand, plain references, and what their papers promise."""

from collections.abc import Callable
from itertools import pairwise

import pytest
import torch
from torch import Tensor, nn

from pahires.temporal.network import ObservedWindow
from peers.a_liif import ALiif, ALiifNetworkConfig
from peers.completing import EdsrConfig, EdsrEncoder
from peers.liif import Liif, LiifNetworkConfig
from peers.lmf import Lmf, LmfNetworkConfig
from peers.meta_sr import MetaSr, MetaSrNetworkConfig

NUMBERS = 135
SMALL = EdsrConfig(blocks=1, features=4)
SMALL_NETWORKS: dict[str, Callable[[], nn.Module]] = {
    "liif": lambda: Liif(LiifNetworkConfig(SMALL, hidden=8, layers=2), 5),
    "meta-sr": lambda: MetaSr(MetaSrNetworkConfig(SMALL, hidden=8), 5),
    "a-liif": lambda: ALiif(ALiifNetworkConfig(SMALL, width=6, layers=2, basis=3, expansion_hidden=8), 5),
    "lmf": lambda: Lmf(LmfNetworkConfig(SMALL, width=6, layers=3), 5),
}
ENSEMBLES = ("liif", "a-liif", "lmf")


def small(name: str) -> nn.Module:
    torch.manual_seed(0)
    return SMALL_NETWORKS[name]()


def window_of(
    kept: list[int], asked: list[float], *, fps: float = 30.0, numbers: int = 5, seed: int = 0
) -> ObservedWindow:
    """Random frames at `kept` and queries at `asked`, both in frames of `fps`; two windows, the second shifted."""
    generator = torch.Generator().manual_seed(seed)
    times, queries = torch.tensor(kept) / fps, torch.tensor(asked, dtype=torch.float32) / fps
    return ObservedWindow(
        frames=torch.randn(2, len(kept), numbers, generator=generator),
        times_seconds=times.expand(2, -1),
        queries_seconds=torch.stack((queries, queries.flip(0))),
        query_spacing_seconds=torch.full((2,), 1 / fps),
    )


def num_parameters(module: nn.Module) -> int:
    return sum(each.numel() for each in module.parameters())


def test_the_encoder_has_edsr_baselines_size_and_sees_69_frames() -> None:
    encoder = EdsrEncoder(EdsrConfig(), NUMBERS)
    # Head 3·135·64 + 64, then 33 convolutions of 3·64·64 + 64.
    assert num_parameters(encoder) == 25_984 + 33 * 12_352 == 433_600
    frames = torch.randn(1, 201, NUMBERS, generator=torch.Generator().manual_seed(0)).requires_grad_()
    encoder(frames)[0, 100].sum().backward()
    assert frames.grad is not None
    felt = torch.nonzero(frames.grad[0].abs().sum(dim=1)).flatten()
    assert felt.tolist() == list(range(100 - 34, 100 + 35))
    assert len(felt) == 69


def test_sizes_are_those_of_the_papers() -> None:
    edsr, unfold = 433_600, 192

    def layers(*widths: int) -> int:
        return sum(before * after + after for before, after in pairwise(widths))

    assert num_parameters(Liif(LiifNetworkConfig(), NUMBERS)) == edsr + layers(unfold + 2, *[256] * 4, NUMBERS)
    assert num_parameters(MetaSr(MetaSrNetworkConfig(), NUMBERS)) == edsr + layers(2, 256, unfold * NUMBERS)
    assert num_parameters(ALiif(ALiifNetworkConfig(), NUMBERS)) == (
        edsr + layers(unfold + 2, *[256] * 4, 10) + 10 * layers(unfold + 2, *[16] * 4, NUMBERS)
    )
    for width, latent in ((16, 208), (64, 832)):
        assert num_parameters(Lmf(LmfNetworkConfig(width=width), NUMBERS)) == (
            edsr + layers(unfold + 1, 208, latent) + layers(width + 2, *[width] * 6, NUMBERS)
        )


def _dense(layers: list[nn.Linear], vector: Tensor) -> Tensor:
    for layer in layers[:-1]:
        vector = torch.clamp(layer.weight @ vector + layer.bias, min=0)
    return layers[-1].weight @ vector + layers[-1].bias


def _linears(module: nn.Module) -> list[nn.Linear]:
    return [layer for layer in module.modules() if isinstance(layer, nn.Linear)]


def _codes(network: nn.Module, window: ObservedWindow) -> Tensor:
    """Unfolded features by one look at each frame's neighbours, the encoder by numpy-like sums over its kernels."""
    encoder = network.encoder
    assert isinstance(encoder, EdsrEncoder)

    def convolved(layer: nn.Conv1d, rows: Tensor) -> Tensor:
        out = []
        for frame in range(len(rows)):
            near = [rows[min(max(frame + offset, 0), len(rows) - 1)] for offset in (-1, 0, 1)]
            out.append(sum(layer.weight[:, :, tap] @ near[tap] for tap in range(3)) + layer.bias)
        return torch.stack(out)

    every = []
    for rows in window.frames:
        head = hidden = convolved(encoder.head, rows)
        for block in encoder.blocks:
            hidden = hidden + convolved(block.second, torch.clamp(convolved(block.first, hidden), min=0))
        features = convolved(encoder.tail, hidden) + head
        last = len(features) - 1
        every.append(
            torch.stack(
                [torch.cat((features[max(i - 1, 0)], features[i], features[min(i + 1, last)])) for i in range(last + 1)]
            )
        )
    return torch.stack(every)


def _liif(network: Liif, code: Tensor, relative: float, cell: float) -> Tensor:
    return _dense(_linears(network.decoder), torch.cat((code, torch.tensor([2 * relative, 2 * cell]))))


def _a_liif(network: ALiif, code: Tensor, relative: float, cell: float) -> Tensor:
    """The mixed weights themselves, as the paper writes it, then an ordinary MLP."""
    inputs = torch.cat((code, torch.tensor([2 * relative, 2 * cell])))
    coefficients = _dense(_linears(network.expansion), inputs)
    coefficients = coefficients / torch.sqrt((coefficients**2).sum())
    hidden, layers = inputs, list(network.decoder.layers)
    for number, layer in enumerate(layers):
        weight = sum(c * part for c, part in zip(coefficients, layer.weight.chunk(len(coefficients)), strict=True))
        bias = sum(c * part for c, part in zip(coefficients, layer.bias.chunk(len(coefficients)), strict=True))
        hidden = weight @ hidden + bias
        hidden = hidden if number == len(layers) - 1 else torch.clamp(hidden, min=0)
    return hidden


def _lmf(network: Lmf, code: Tensor, relative: float, cell: float) -> Tensor:
    cell = cell * max(1 / cell / 4, 1.0)
    modulation = _dense(_linears(network.latent), torch.cat((code, torch.tensor([2 * cell]))))
    width, depth = network.width, network.depth
    scale, shift = modulation[: width * depth], modulation[width * depth : 2 * width * depth]
    hidden = torch.cat((modulation[-width:], torch.tensor([2 * relative, 2 * cell])))
    for number, layer in enumerate(network.layers):
        part = slice(number * width, (number + 1) * width)
        hidden = torch.clamp((layer.weight @ hidden + layer.bias) * (1 + scale[part]) + shift[part], min=0)
    return network.output.weight @ hidden + network.output.bias


def _meta_sr(network: MetaSr, code: Tensor, relative: float, cell: float) -> Tensor:
    matrix = _dense(_linears(network.weights), torch.tensor([relative, cell]))
    return sum(code[row] * matrix[row * 5 : row * 5 + 5] for row in range(len(code)))  # type: ignore[return-value]


REFERENCES = {"liif": _liif, "a-liif": _a_liif, "lmf": _lmf, "meta-sr": _meta_sr}


@pytest.mark.parametrize("name", REFERENCES)
# Kept frames of × 2.4 (a real frame each), of × 5, and a query before the first and after the last frame.
@pytest.mark.parametrize("kept", [[0, 2, 4, 7, 9], [0, 5, 10, 15]])
def test_answers_are_those_of_a_plain_reference(name: str, kept: list[int]) -> None:
    network = small(name)
    asked = [0.0, 1.0, 2.0, 3.5, 6.9, 8.0, float(kept[-1]), -0.5, kept[-1] + 0.5]
    window = window_of(kept, asked)
    with torch.no_grad():
        made, codes = network(window), _codes(network, window)
        spacing = kept[-1] / (len(kept) - 1)
        for batch in range(2):
            for query, instant in enumerate(asked if batch == 0 else asked[::-1]):
                before = max((row for row, frame in enumerate(kept) if frame <= instant), default=0)
                after = min((row for row, frame in enumerate(kept) if frame > instant), default=len(kept) - 1)

                def at(row: int, batch: int = batch, instant: float = instant) -> Tensor:
                    return REFERENCES[name](network, codes[batch, row], (instant - kept[row]) / spacing, 1 / spacing)  # type: ignore[operator]

                expected = at(before)
                if name in ENSEMBLES and before != after:
                    share = (instant - kept[before]) / (kept[after] - kept[before])
                    expected = (1 - share) * at(before) + share * at(after)
                # Meta-SR's places are rounded to 1e-4 of a frame.
                torch.testing.assert_close(made[batch, query], expected, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("name", SMALL_NETWORKS)
def test_one_frame_is_an_answer_and_every_parameter_is_learnt(name: str) -> None:
    network = small(name)
    alone = network(window_of([0], [0.0, 1.0]))
    assert alone.shape == (2, 2, 5)
    assert bool(torch.isfinite(alone).all())
    network(window_of([0, 2, 4, 7, 9], [0.0, 1.0, 3.0, 5.0])).square().sum().backward()
    still = [key for key, each in network.named_parameters() if each.grad is None or not bool(each.grad.any())]
    assert still == []


@pytest.mark.parametrize("name", SMALL_NETWORKS)
def test_an_answer_does_not_depend_on_what_else_is_asked_for(name: str) -> None:
    network, kept = small(name), [0, 3, 6, 9]
    together = network(window_of(kept, [1.0, 4.0, 8.0]))[0]
    torch.testing.assert_close(network(window_of(kept, [4.0]))[0, 0], together[1])
    torch.testing.assert_close(network(window_of(kept, [8.0, 1.0, 4.0]))[0, [1, 2, 0]], together)
