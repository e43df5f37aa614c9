"""Hier (Ghosh et al. 2021; anindita127/Complextext2animation, src/model): one code for each half of the body.

Decoded autoregressively as in JL2P, through a tree of body parts: limbs with the trunk, then pairs of limbs.
"""

from dataclasses import dataclass, replace
from itertools import chain, pairwise

import numpy as np
import torch
from torch import Tensor, nn
from torch.func import functional_call
from torch.nn.functional import binary_cross_entropy_with_logits, smooth_l1_loss

from motionkit.core.shapes import Float
from motionkit.features.layout import SMPL22_LAYOUT
from motionkit.training.networks import Conditions
from peers.generating import GIVEN, GIVEN_MINILM, SLOW, PeerConfig, PeerStage, cosine, dropping
from peers.layers import ConditionVector, NetworkInputs, PeerNetwork, first_poses, last_states
from peers.motions import Lengths, MotionBatch, PoseSpace, Rows, SampleBatch, frames_within

TRUNK = 4
CHANGE_WEIGHT, MATCH_WEIGHT = 0.1, 0.1


def body_parts(space: PoseSpace) -> list[list[int]]:
    """Indices into `native` vectors of right arm, left arm, right leg, left leg, and trunk (with the root)."""
    vector, numbers = space.layout, np.arange(space.num_features)
    # Positions and rotations are of all joints but the root.
    each = np.hstack(
        (
            numbers[vector.joint_positions].reshape(-1, 3),
            numbers[vector.joint_rotations].reshape(-1, 6),
            numbers[vector.joint_velocities].reshape(-1, 3)[1:],
        )
    )
    # The first joint of a chain belongs to another part.
    right_leg, left_leg, spine, right_arm, left_arm = (
        each[np.array(joints[1:]) - 1].flatten().tolist() for joints in SMPL22_LAYOUT.chains
    )
    contacts = numbers[vector.contacts].tolist()
    root = [*range(vector.root_height.stop), *numbers[vector.joint_velocities][:3].tolist()]
    return [right_arm, left_arm, right_leg + contacts[2:], left_leg + contacts[:2], root + spine]


@dataclass(frozen=True)
class HierNetworkConfig:
    """Hier: widths of body parts, of limbs with the trunk, of the codes of both halves, and of the critic's layers.

    With probability `mean_first` the first pose is replaced by the mean pose.
    """

    part: int = 32
    limb: int = 128
    width: int = 512
    critic: tuple[int, ...] = (64, 256, 128, 64)
    kept_weight: float = 1e-3
    critic_weight: float = 1e-3
    mean_first: float = 0.0


class TwoStreamEncoder(nn.Module):
    """Frames → the codes of the upper and the lower body."""

    def __init__(self, parts: list[list[int]], config: HierNetworkConfig) -> None:
        super().__init__()
        self.parts = parts
        self.of_parts = nn.ModuleList(nn.Linear(len(part), config.part) for part in parts)
        self.of_limbs = nn.ModuleList(nn.Linear(2 * config.part, config.limb) for _ in parts[:TRUNK])
        self.norms = nn.ModuleList(nn.BatchNorm1d(2 * config.limb) for _ in range(2))
        self.cells = nn.ModuleList(nn.GRU(2 * config.limb, config.width, batch_first=True) for _ in range(2))

    def forward(self, rows: Rows, lengths: Lengths) -> Float[Tensor, "2 batch width"]:
        """Final hidden states of both GRUs."""
        mask = frames_within(lengths, rows.shape[1])
        *limbs, trunk = (layer(rows[..., part]) for layer, part in zip(self.of_parts, self.parts, strict=True))
        limbs = [layer(torch.cat((limb, trunk), dim=-1)) for layer, limb in zip(self.of_limbs, limbs, strict=True)]
        codes = []
        for half, (norm, cell) in enumerate(zip(self.norms, self.cells, strict=True)):
            pair = torch.cat(limbs[2 * half : 2 * half + 2], dim=-1)
            normed = torch.zeros_like(pair)
            normed[mask] = norm(pair[mask])
            codes.append(last_states(cell(normed)[0], lengths))
        return torch.stack(codes)


class TwoStreamDecoder(nn.Module):
    """Codes → frames; each adds a predicted change to the one before. Both halves contribute to the trunk."""

    def __init__(self, parts: list[list[int]], config: HierNetworkConfig) -> None:
        super().__init__()
        self.order, self.sizes = list(chain(*parts)), [len(part) for part in parts]
        self.back = torch.tensor(self.order).argsort().tolist()
        halves = [sum(self.sizes[half : half + 2]) + self.sizes[TRUNK] for half in (0, 2)]
        self.cells = nn.ModuleList(nn.GRUCell(numbers, config.width) for numbers in halves)
        self.to_pairs = nn.ModuleList(nn.Linear(config.width, 2 * config.limb) for _ in halves)
        self.to_limbs = nn.ModuleList(nn.Linear(config.limb, 2 * config.part) for _ in parts[:TRUNK])
        self.to_parts = nn.ModuleList(nn.Linear(config.part, len(part)) for part in parts)

    def forward(
        self, codes: Float[Tensor, "2 batch width"], first: Float[Tensor, "batch numbers"], frames: int
    ) -> Rows:
        """Standardised rows, starting from the pose `first`."""
        pose, states, poses = first[:, self.order], list(codes), []
        for _ in range(frames):
            *own_limbs, trunk = torch.split(pose, self.sizes, dim=1)
            limbs: list[Tensor] = []
            for half in range(2):
                inputs = torch.cat((*own_limbs[2 * half : 2 * half + 2], trunk), dim=1)
                states[half] = self.cells[half](inputs, states[half])
                limbs += self.to_pairs[half](states[half]).chunk(2, dim=1)
            split = [layer(limb).chunk(2, dim=1) for layer, limb in zip(self.to_limbs, limbs, strict=True)]
            # A linear map of the mean is the mean of the four predictions of the trunk.
            inner = [own for own, _ in split] + [torch.stack([other for _, other in split]).mean(dim=0)]
            change = torch.cat([layer(part) for layer, part in zip(self.to_parts, inner, strict=True)], dim=1)
            pose = pose + change
            poses.append(pose)
        return torch.stack(poses, dim=1)[..., self.back]


class Critic(nn.Module):
    """Discriminator: logits above 0 for motions that look real."""

    def __init__(self, numbers: int, widths: tuple[int, ...]) -> None:
        super().__init__()
        self.cell = nn.GRU(numbers, widths[0], batch_first=True)
        self.layers = nn.Sequential(
            *chain(*((nn.Linear(*pair), nn.LeakyReLU()) for pair in pairwise(widths))), nn.Linear(widths[-1], 1)
        )

    def forward(self, rows: Rows, lengths: Lengths) -> Float[Tensor, "batch 1"]:
        """Logits."""
        logits: Tensor = self.layers(last_states(self.cell(rows)[0], lengths))
        return logits


class Hier(PeerNetwork):
    """Hier: two codes, one for each half of the body, from a motion or a condition, decoded to poses."""

    def __init__(self, config: HierNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        parts = body_parts(inputs.space)
        self.config, self.numbers = config, inputs.space.num_features
        self.sentence = ConditionVector(inputs.conditions, 2 * config.width)
        self.encoder, self.decoder = TwoStreamEncoder(parts, config), TwoStreamDecoder(parts, config)
        self.critic = Critic(inputs.space.num_features, config.critic)

    def encode_condition(self, conditions: Conditions) -> Float[Tensor, "2 batch width"]:
        """Codes of conditions."""
        return torch.stack(self.sentence(conditions).tanh().chunk(2, dim=1))

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Smooth L1 of frames, frame differences and codes, of motions' and conditions' codes; adversarial losses."""
        config, rows, lengths, mask = self.config, batch.rows, batch.lengths, batch.mask
        codes, condition_codes = self.encoder(rows, lengths), self.encode_condition(batch.conditions)
        first = first_poses(rows, config.mean_first, batch.generator)
        both = self.decoder(torch.cat((codes, condition_codes), dim=1), first.repeat(2, 1), rows.shape[1])
        two = reconstructed, decoded = (both * mask.repeat(2, 1)[..., None]).chunk(2)
        of_one, of_other = (smooth_l1_loss(each[mask], rows[mask]) for each in two)
        true_changes = rows.diff(dim=1)[mask[:, 1:]]
        change_of_one, change_of_other = (smooth_l1_loss(each.diff(dim=1)[mask[:, 1:]], true_changes) for each in two)
        frames, changes = of_one + of_other, change_of_one + change_of_other
        matched = 2 * smooth_l1_loss(codes, condition_codes)
        kept = 2 * smooth_l1_loss(self.encoder(reconstructed, lengths), codes)
        # Detached critic weights in the decoder's loss, detached motions in the critic's: one backward pass does both.
        still = {name: weight.detach() for name, weight in self.critic.named_parameters()}
        fooled = functional_call(self.critic, still, (decoded, lengths))
        judged = self.critic(torch.cat((rows, decoded.detach())), lengths.repeat(2))
        real = torch.ones_like(fooled)
        adversarial = binary_cross_entropy_with_logits(fooled, real)
        critic = binary_cross_entropy_with_logits(judged, torch.cat((real, torch.zeros_like(real))))
        loss = frames + CHANGE_WEIGHT * changes + MATCH_WEIGHT * matched
        loss = loss + config.kept_weight * kept + config.critic_weight * (adversarial + critic)
        return {"loss": loss, "frames": frames, "changes": changes, "matched": matched, "critic": critic}

    def sample(self, batch: SampleBatch) -> Rows:
        """Standardised rows, starting from the mean pose; deterministic."""
        codes = self.encode_condition(batch.conditions)
        rows: Tensor = self.decoder(codes, codes.new_zeros(codes.shape[1], self.numbers), batch.frames)
        return rows


SIZES = HierNetworkConfig(limb=64, width=160, mean_first=0.5)
NANO = PeerConfig(SIZES, cosine(2400, 32, 3e-3), GIVEN_MINILM, SLOW, clip_norm=1.0)
PAPER = PeerConfig(HierNetworkConfig(), dropping(300, 32), GIVEN, replace(SLOW, sampled_frames=32))
HIER = PeerStage("hier", Hier, NANO, PAPER)
