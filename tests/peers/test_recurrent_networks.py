"""JL2P and Hier against independent statements: numbers of parameters, passes by hand, what is in sight, the critic."""

import numpy as np
import pytest
import torch
from torch import Tensor

from motionkit.core.errors import UsageError
from motionkit.core.skeleton import SMPL22
from peers.hier import HIER, Hier, HierNetworkConfig, body_parts
from peers.jl2p import JL2P, Jl2p, Jl2pNetworkConfig
from peers.motions import MotionBatch
from tests.peers.plain_transformer import Weights, linear, part
from tests.peers.test_generative_networks import TEXTS, conditions, count, inputs, space
from tests.peers.test_other_networks import CLIP, dense, field_space, gru

TINY_HIER = HierNetworkConfig(part=3, limb=5, width=7, critic=(4, 6))


def batch_of(lengths: list[int]) -> MotionBatch:
    torch.manual_seed(5)
    rows, frames = torch.randn(len(lengths), max(lengths), 263), torch.arange(max(lengths))
    seen = frames < torch.tensor(lengths)[:, None]
    told = conditions(len(lengths))
    return MotionBatch(
        rows * seen[..., None], torch.tensor(lengths), told, torch.arange(len(lengths)), frames.expand(len(lengths), -1)
    )


def test_published_sizes_have_the_numbers_of_parameters_that_follow_from_their_layers() -> None:
    jl2p = Jl2p(JL2P.recipes["paper"]["network"], inputs(space(), CLIP))
    cell = 3 * (263 * 1024 + 1024) + 3 * (1024 * 1024 + 1024)
    assert count(jl2p) == dense(512, 1024) + 2 * cell + dense(1024, 263)
    hier = Hier(HIER.recipes["paper"]["network"], inputs(space(), CLIP))
    # Arms of 4 joints, legs of 4 with two contacts, 5 joints of the spine; the root has its speed twice and height.
    arm, leg, trunk = 4 * 12, 4 * 12 + 2, 5 * 12 + 3 + 4
    assert 2 * arm + 2 * leg + trunk == 263

    def recurrent(inputs: int, width: int) -> int:
        return 3 * (inputs * width + width) + 3 * (width * width + width)

    leaves = 2 * dense(arm, 32) + 2 * dense(leg, 32) + dense(trunk, 32)
    encoder = leaves + 4 * dense(64, 128) + 2 * 2 * 256 + 2 * recurrent(256, 512)
    back = 2 * dense(32, arm) + 2 * dense(32, leg) + dense(32, trunk)
    cells = recurrent(2 * arm + trunk, 512) + recurrent(2 * leg + trunk, 512)
    decoder = cells + 2 * dense(512, 256) + 4 * dense(128, 64) + back
    critic = recurrent(263, 64) + dense(64, 256, 128, 64, 1)
    assert count(hier) == dense(512, 1024) + encoder + decoder + critic


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
    for norm in network.encoder.norms:
        norm.running_mean.normal_(), norm.running_var.uniform_(0.5, 2.0)
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
