"""Δ-Interp and TS-Former: sizes by hand, plain references, what attends to what, and times between frames."""

import math

import pytest
import torch
from torch import Tensor, nn

from pahires.temporal.network import ObservedWindow
from peers.delta_interp import DeltaInterp, DeltaInterpNetworkConfig
from peers.ts_former import RelativeEncoder, TsFormer, TsFormerNetworkConfig

NUMBERS = 9
# Ten frames of the past and one of the future around a gap of six, as the LaFAN1 benchmark has them.
KEPT = [*range(10), 16]
GAP = [10.0, 11.0, 12.0, 13.0, 14.0, 15.0]


def delta_interp() -> DeltaInterp:
    torch.manual_seed(0)
    config = DeltaInterpNetworkConfig(width=8, blocks=2, layers=2, heads=2, embedding=3, positions=20)
    return DeltaInterp(config, NUMBERS).eval()


def ts_former() -> TsFormer:
    torch.manual_seed(0)
    return TsFormer(TsFormerNetworkConfig(width=8, layers=2, heads=2, head_width=4, inner=8), NUMBERS)


NETWORKS = {"delta-interp": delta_interp, "ts-former": ts_former}


def window_of(kept: list[int], asked: list[float], fps: float = 30.0) -> ObservedWindow:
    frames = torch.randn(2, len(kept), NUMBERS, generator=torch.Generator().manual_seed(len(kept)))
    times, queries = torch.tensor(kept) / fps, torch.tensor(asked, dtype=torch.float32) / fps
    return ObservedWindow(frames, times.expand(2, -1), queries.expand(2, -1), torch.full((2,), 1 / fps))


def num_parameters(module: nn.Module) -> int:
    return sum(each.numel() for each in module.parameters())


def test_sizes_are_the_published_ones() -> None:
    d, w = 135, 1024
    block = 4 * (w * w + w) + 2 * w + 3 * (w * w + w)
    delta = 2 * (256 * 32 + 32) + 2 * ((d + 64) * w + w) + 6 * block + w * d + d
    assert num_parameters(DeltaInterp(DeltaInterpNetworkConfig(), d)) == delta
    w, h = 512, 64
    enter = (d + 1) * w + w + 1 + w * w + w + 1
    distance = h + h + 1 + h * h + h
    layer = 4 * w * 8 * h + 2 * 2 * w + 2 * (w * w + w)
    stage = enter + distance + 6 * layer + 2 * w + (w * w + w + 1 + w * d + d)
    assert num_parameters(TsFormer(TsFormerNetworkConfig(), d)) == 2 * stage + (2 * w + w + 1 + w * w + w)


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
    window = window_of(KEPT, GAP)
    made = network(window)
    for batch in range(2):
        poses = window.frames[batch]
        length = network.length(torch.tensor([6.0]))[0]

        def entered(layer: nn.Linear, pose: Tensor, position: float, length: Tensor = length) -> Tensor:
            return layer(torch.cat((pose, network.position(torch.tensor([float(position)]))[0], length)))  # type: ignore[no-any-return]

        given = torch.stack([entered(network.given, poses[row] - poses[9], KEPT[row]) for row in range(len(KEPT))])
        missing = torch.stack([entered(network.missing, torch.zeros(NUMBERS), frame) for frame in GAP])
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
    window = window_of(KEPT, GAP)
    made = network(window)
    for batch in range(2):
        poses = window.frames[batch]
        placeholders = torch.zeros(6, NUMBERS)
        for number, frame in enumerate(GAP):
            share = (frame - 9) / 7
            placeholders[number, :3] = (1 - share) * poses[9, :3] + share * poses[10, :3]
        known = torch.cat((torch.ones(11, 1), torch.zeros(6, 1)))
        positions = torch.tensor([*KEPT, *GAP])
        keyframes = network.keyframe_position(torch.stack((positions - 9, 16 - positions), dim=1))
        entered = torch.cat((torch.cat((poses, placeholders)), known), dim=1)
        draft = _encoded(network.context, entered, positions, keys=11, added=keyframes)[11:]
        # In the second stage everything attends to everything: the given frames and all six drafts.
        refined = _encoded(network.detail, torch.cat((torch.cat((poses, draft)), known), dim=1), positions, keys=17)
        torch.testing.assert_close(made[batch], draft + refined[11:], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", NETWORKS)
def test_an_answer_depends_on_its_instant_alone_and_moves_with_it(name: str) -> None:
    network = NETWORKS[name]().requires_grad_(False)
    together = network(window_of(KEPT, [*GAP, 11.5, 9.0, 17.0, -1.0]))
    torch.testing.assert_close(network(window_of(KEPT, [11.5, 13.0])), together[:, [6, 3]], rtol=1e-4, atol=1e-5)
    near = network(window_of(KEPT, [12.0, 12.001, 12.5, 13.0]))
    moved = (near[:, 1:] - near[:, :1]).abs().amax(dim=(0, 2))
    assert float(moved[0]) < 0.01 * float(moved[2])


@pytest.mark.parametrize("name", NETWORKS)
def test_every_parameter_is_learnt_from_a_gap_and_one_frame_is_an_answer(name: str) -> None:
    network = NETWORKS[name]()
    for kept in ([0], [0, 1]):
        alone = network(window_of(kept, [0.0, 1.0, 5.0]))
        assert alone.shape == (2, 3, NUMBERS)
        assert bool(torch.isfinite(alone).all())
    network(window_of(KEPT, GAP)).square().sum().backward()
    still = [key for key, each in network.named_parameters() if each.grad is None or not bool(each.grad.any())]
    assert still == []
