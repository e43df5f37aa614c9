"""The networks that complete motion: plain references, what attends to what, what their papers promise."""

import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor, nn

from pahires.temporal.network import ObservedWindow
from peers.a_liif import ALiif, ALiifNetworkConfig
from peers.completing import EdsrConfig, EdsrEncoder
from peers.delta_interp import DeltaInterp, DeltaInterpNetworkConfig
from peers.liif import Liif, LiifNetworkConfig
from peers.lmf import Lmf, LmfNetworkConfig
from peers.meta_sr import MetaSr, MetaSrNetworkConfig
from peers.ts_former import RelativeEncoder, TsFormer, TsFormerNetworkConfig

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


POSE = 9
# Ten frames of the past and one of the future around a gap of six, as the LaFAN1 benchmark has them.
AROUND = [*range(10), 16]
GAP = [10.0, 11.0, 12.0, 13.0, 14.0, 15.0]


def delta_interp() -> DeltaInterp:
    torch.manual_seed(0)
    config = DeltaInterpNetworkConfig(width=8, blocks=2, layers=2, heads=2, embedding=3, positions=20)
    return DeltaInterp(config, POSE).eval()


def ts_former() -> TsFormer:
    torch.manual_seed(0)
    return TsFormer(TsFormerNetworkConfig(width=8, layers=2, heads=2, head_width=4, inner=8), POSE)


NETWORKS = {"delta-interp": delta_interp, "ts-former": ts_former}


def gap_window(kept: list[int], asked: list[float], fps: float = 30.0) -> ObservedWindow:
    frames = torch.randn(2, len(kept), POSE, generator=torch.Generator().manual_seed(len(kept)))
    times, queries = torch.tensor(kept) / fps, torch.tensor(asked, dtype=torch.float32) / fps
    return ObservedWindow(frames, times.expand(2, -1), queries.expand(2, -1), torch.full((2,), 1 / fps))


def _attended(attention: nn.MultiheadAttention, rows: Tensor, keys: Tensor) -> Tensor:
    """softmax(QKᵀ/√d)V, head by head and row by row."""
    width, heads = attention.embed_dim, attention.num_heads
    assert attention.in_proj_weight is not None
    q, k, v = (
        what @ attention.in_proj_weight[part * width : (part + 1) * width].T
        + attention.in_proj_bias[part * width : (part + 1) * width]
        for part, what in enumerate((rows, keys, keys))
    )
    size = width // heads
    out = torch.zeros_like(rows)
    for row in range(len(rows)):
        for head in range(heads):
            part = slice(head * size, (head + 1) * size)
            scores = torch.tensor([float(q[row, part] @ k[key, part]) / math.sqrt(size) for key in range(len(keys))])
            out[row, part] = sum(  # type: ignore[assignment]
                share * v[key, part] for key, share in enumerate(torch.exp(scores) / torch.exp(scores).sum())
            )
    return attention.out_proj(out)  # type: ignore[no-any-return]


def test_delta_interp_is_its_plain_reference() -> None:
    network = delta_interp().requires_grad_(False)
    window = gap_window(AROUND, GAP)
    made = network(window)
    for batch in range(2):
        poses = window.frames[batch]
        length = network.length(torch.tensor([6.0]))[0]

        def entered(layer: nn.Linear, pose: Tensor, position: float, length: Tensor = length) -> Tensor:
            return layer(torch.cat((pose, network.position(torch.tensor([float(position)]))[0], length)))  # type: ignore[no-any-return]

        given = torch.stack([entered(network.given, poses[row] - poses[9], AROUND[row]) for row in range(len(AROUND))])
        missing = torch.stack([entered(network.missing, torch.zeros(POSE), frame) for frame in GAP])
        for block in network.blocks:

            def passed(rows: Tensor, keys: Tensor, block: nn.Module = block) -> Tensor:
                hidden = torch.relu(block.norm(rows + _attended(block.attention, rows, keys)))
                first, _, _, second, _ = block.residual
                leaky = nn.functional.leaky_relu
                return hidden + leaky(second(leaky(first(hidden))))  # type: ignore[no-any-return]

            given = passed(given, given)
            missing = passed(missing, given)
        torch.testing.assert_close(made[batch], network.output(missing), rtol=1e-4, atol=1e-5)


def _encoded(
    encoder: RelativeEncoder, rows: Tensor, positions: Tensor, keys: int, added: Tensor | None = None
) -> Tensor:
    """A relative transformer encoder, head by head and pair by pair; rows attend to the first `keys`."""
    rows = encoder.enter(rows) + (0 if added is None else added)
    for layer in encoder.layers:
        attention, normed = layer.attention, layer.before_attention(rows)
        q, k, v = attention.query(normed), attention.key(normed[:keys]), attention.value(normed[:keys])
        size = q.shape[1] // attention.heads
        mixed = torch.zeros_like(q)
        for row in range(len(rows)):
            for head in range(attention.heads):
                part = slice(head * size, (head + 1) * size)
                scores = torch.stack(
                    [
                        q[row, part] @ (k[key, part] + encoder.distance((positions[key] - positions[row])[None]))
                        for key in range(keys)
                    ]
                ) / math.sqrt(rows.shape[1])
                mixed[row, part] = torch.softmax(scores, 0) @ v[:, part]
        rows = rows + attention.out(mixed)
        rows = rows + layer.inner(layer.before_inner(rows))
    return encoder.leave(encoder.norm(rows))  # type: ignore[no-any-return]


def test_ts_former_is_its_plain_reference_of_two_stages() -> None:
    network = ts_former().requires_grad_(False)
    window = gap_window(AROUND, GAP)
    made = network(window)
    for batch in range(2):
        poses = window.frames[batch]
        placeholders = torch.zeros(6, POSE)
        for number, frame in enumerate(GAP):
            share = (frame - 9) / 7
            placeholders[number, :3] = (1 - share) * poses[9, :3] + share * poses[10, :3]
        known = torch.cat((torch.ones(11, 1), torch.zeros(6, 1)))
        positions = torch.tensor([*AROUND, *GAP])
        keyframes = network.keyframe_position(torch.stack((positions - 9, 16 - positions), dim=1))
        entered = torch.cat((torch.cat((poses, placeholders)), known), dim=1)
        draft = _encoded(network.context, entered, positions, keys=11, added=keyframes)[11:]
        # In the second stage everything attends to everything: the given frames and all six drafts.
        refined = _encoded(network.detail, torch.cat((torch.cat((poses, draft)), known), dim=1), positions, keys=17)
        torch.testing.assert_close(made[batch], draft + refined[11:], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", NETWORKS)
def test_an_inbetweeners_answer_depends_on_its_instant_alone_and_moves_with_it(name: str) -> None:
    network = NETWORKS[name]().requires_grad_(False)
    together = network(gap_window(AROUND, [*GAP, 11.5, 9.0, 17.0, -1.0]))
    torch.testing.assert_close(network(gap_window(AROUND, [11.5, 13.0])), together[:, [6, 3]], rtol=1e-4, atol=1e-5)
    near = network(gap_window(AROUND, [12.0, 12.001, 12.5, 13.0]))
    moved = (near[:, 1:] - near[:, :1]).abs().amax(dim=(0, 2))
    assert float(moved[0]) < 0.01 * float(moved[2])


@pytest.mark.parametrize("name", NETWORKS)
def test_every_parameter_is_learnt_from_a_gap_and_one_frame_is_an_answer(name: str) -> None:
    network = NETWORKS[name]()
    for kept in ([0], [0, 1]):
        alone = network(gap_window(kept, [0.0, 1.0, 5.0]))
        assert alone.shape == (2, 3, POSE)
        assert bool(torch.isfinite(alone).all())
    network(gap_window(AROUND, GAP)).square().sum().backward()
    still = [key for key, each in network.named_parameters() if each.grad is None or not bool(each.grad.any())]
    assert still == []
