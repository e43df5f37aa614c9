"""NeMF against independent statements: numbers of parameters, passes by hand, turns there and back, what is behind."""

from collections.abc import Iterator
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch import Tensor

from motionkit.training.conditions import ConditionSizes
from peers.motions import MotionBatch
from peers.nemf import NEMF, NEMF_PATH, Nemf, NemfNetworkConfig, NemfPath, NemfPathNetworkConfig, with_velocities
from tests.peers.plain_transformer import Weights, linear, norm, part
from tests.peers.test_four_motions import motions
from tests.peers.test_generative_networks import conditions, count, inputs, space
from tests.peers.test_other_networks import dense

NONE = ConditionSizes(0, ())
PATH = NemfPathNetworkConfig(widths=(5, 4), kernel=3)
TINY = NemfNetworkConfig(
    16, (5, 6), local_latent=4, turn_latent=3, frequencies=2, width=7, local_layers=3, turn_layers=2, kl_cycles=4
)


def tiny(config: NemfNetworkConfig = TINY) -> Nemf:
    torch.manual_seed(1)
    return Nemf(config, inputs(space(), NONE, {"nemf-path": NemfPath(PATH, inputs(space(), NONE))})).eval()


def batch_of(rows: Tensor, lengths: list[int]) -> MotionBatch:
    batch, frames = rows.shape[:2]
    nothing = conditions(batch, 0).unconditional()
    seen = torch.arange(frames) < torch.tensor(lengths)[:, None]
    every = torch.arange(frames).expand(batch, -1)
    return MotionBatch(rows * seen[..., None], torch.tensor(lengths), nothing, torch.arange(batch), every)


def test_published_sizes_have_the_numbers_of_parameters_that_follow_from_their_layers() -> None:
    def convolutions(kernel: int, *widths: int) -> int:
        return sum(kernel * before * after + after + dense(before, after) for before, after in pairwise(widths))

    path_config, config = (stage.recipes["paper"]["network"] for stage in (NEMF_PATH, NEMF))
    path = NemfPath(path_config, inputs(space(), NONE))
    # 21 joints of three coordinates and six numbers of a rotation, their changes, a turn; velocity, height, contacts.
    poses = 21 * 9
    assert count(path) == convolutions(15, 2 * poses + 1, 512, 512, 512, 512, 256, 128, 2 + 1 + 4) + 6
    field = Nemf(config, inputs(space(), NONE, {"nemf-path": path}))
    encoders = convolutions(4, 2 * poses, 128, 256, 512, 512) + convolutions(4, 6, 128, 256, 512, 512)
    latents = 2 * dense(8 * 512, 1024) + 2 * dense(8 * 512, 256)
    layers = dense(14 + 1024, 1024) + 7 * dense(1024 + 1038, 1024) + 3 * dense(1024 + 1038 + 256, 1024) + 11 * 2 * 1024
    assert count(field) == encoders + latents + layers + dense(1024, poses) + dense(1024, 6)


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
    batch = batch_of(rows, lengths)
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
    network, rows = NemfPath(PATH, inputs(space(), NONE)), torch.randn(1, 9, 263)
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


@pytest.fixture
def turned(monkeypatch: pytest.MonkeyPatch) -> Iterator[SimpleNamespace]:
    """A network whose field gives four known motions, with these and their space."""
    of, rows = motions("native")
    # Turns of either direction, up to two radians a second.
    rows[..., 0] = (2 * torch.cos(torch.arange(16) / 4 + torch.arange(4)[:, None]) - of.mean[0]) / of.scale[0]
    path = NemfPath(PATH, inputs(of, NONE))
    network = Nemf(TINY, inputs(of, NONE, {"nemf-path": path}))
    numbers = rows * of.scale + of.mean
    angle = of.heading(numbers)[..., 0]
    zero, one = torch.zeros_like(angle), torch.ones_like(angle)
    orientation = torch.stack((angle.cos(), zero, -angle.sin(), zero, one, zero), dim=-1)
    monkeypatch.setattr(network, "forward", lambda *of: (rows[..., 4:67], 2 * numbers[..., 67:193], orientation))
    yield SimpleNamespace(network=network, rows=rows, orientation=orientation)


def test_what_a_field_says_becomes_the_rows_that_it_was_learnt_from(turned: SimpleNamespace) -> None:
    network, rows = turned.network, turned.rows
    made = network.rows(torch.zeros(4, 4), torch.zeros(4, 3), torch.full((4,), 15))
    rows = rows[:, :15]
    torch.testing.assert_close(made[..., 4:193], rows[..., 4:193], atol=2e-3, rtol=1e-3)
    yaw, true = (each[:, 1:-1, 0] * network.space.scale[0] + network.space.mean[0] for each in (made, rows))
    torch.testing.assert_close(yaw, true, atol=0.05, rtol=0)
    root, contacts = network._path[0](made, torch.full((4,), 15))
    scaled = made * network.space.scale + network.space.mean
    torch.testing.assert_close(scaled[..., 1:4], root, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(scaled[..., 259:], contacts.sigmoid(), atol=1e-4, rtol=1e-4)
