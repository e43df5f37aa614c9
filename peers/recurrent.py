"""JL2P, Hier and T2M: recurrent networks that decode motions step by step from the code of a motion or a condition.

JL2P (Ahuja and Morency 2019; chahuja/language2pose, src/model/model.py) has one code. Hier (Ghosh et al. 2021;
anindita127/Complextext2animation, src/model) has one for each half of the body, and a tree of body parts: limbs with
the trunk, then pairs of limbs. T2M (Guo et al. 2022; EricGuo5513/text-to-motion, networks/modules.py) is a temporal VAE
of snippets of four frames.
"""

import copy
from dataclasses import dataclass, replace
from itertools import chain, pairwise

import numpy as np
import torch
from torch import Tensor, nn
from torch.func import functional_call
from torch.nn.functional import binary_cross_entropy_with_logits, l1_loss, smooth_l1_loss

from motionkit.core.shapes import Float
from motionkit.features.layout import SMPL22_LAYOUT
from motionkit.training.config import Schedule
from motionkit.training.networks import Conditions
from peers.generating import GIVEN, GIVEN_MINILM, SLOW, UNCONDITIONAL, PeerConfig, PeerStage, cosine, dropping
from peers.layers import ConditionVector, Latents, NetworkInputs, PeerNetwork, sinusoids
from peers.motions import Lengths, MotionBatch, MotionsConfig, PoseSpace, Rows, SampleBatch, frames_within

TRUNK = 4
CHANGE_WEIGHT, MATCH_WEIGHT = 0.1, 0.1
SNIPPET = 4  # frames
CONTACTS = 4  # the last features of a pose, which T2M's encoder does not see
SLOPE = 0.2
SNIPPET_WEIGHT, KL_WEIGHT = 1e-3, 0.01
TEACHER_FORCING, CURRICULUM = 0.4, 0.5  # probability per batch; share of the steps
Snippets = Float[Tensor, "batch snippets size"]


def last_states(states: Float[Tensor, "batch frames width"], lengths: Lengths) -> Latents:
    """A recurrent layer's states at the motions' last frames."""
    return states[torch.arange(len(states), device=states.device), lengths - 1]


def first_poses(rows: Rows, mean_share: float, generator: torch.Generator) -> Latents:
    """The first pose of each motion, replaced by the mean pose (zeros) with probability `mean_share`."""
    kept = torch.rand((len(rows), 1), generator=generator) >= mean_share
    return rows[:, 0] * kept.to(rows.device)


@dataclass(frozen=True)
class Jl2pNetworkConfig:
    """JL2P: the width of its GRU; with probability `mean_first` the first pose is replaced by the mean pose.

    Over the share `curriculum` of the steps, training uses the numbers of frames in `lengths` in turn, then the last.
    """

    width: int = 1024
    lengths: tuple[int, ...] = (2, 4, 8, 16)
    curriculum: float = 0.5
    mean_first: float = 0.0


class Jl2p(PeerNetwork):
    """JL2P: frames or a condition → a code, the initial state of an autoregressive decoder."""

    def __init__(self, config: Jl2pNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        numbers, width = inputs.space.num_features, config.width
        self.config, self.numbers = config, numbers
        self.sentence = ConditionVector(inputs.conditions, width)
        self.encoder = nn.GRU(numbers, width, batch_first=True)
        self.cell = nn.GRUCell(numbers, width)
        self.change = nn.Linear(width, numbers)

    def decode(self, code: Latents, first: Float[Tensor, "batch numbers"], frames: int) -> Rows:
        """Standardised rows, starting from `first`; each step predicts the change of pose."""
        pose, poses = first, []
        for _ in range(frames):
            code = self.cell(pose, code)
            pose = pose + self.change(code)
            poses.append(pose)
        return torch.stack(poses, dim=1)

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Smooth L1 of the curriculum's frames, decoded from motion codes or, in half of the batches, conditions'."""
        curriculum = self.config.lengths
        place = int(batch.progress / self.config.curriculum * (len(curriculum) - 1))
        rows = batch.rows[:, : curriculum[min(place, len(curriculum) - 1)]]
        frames = rows.shape[1]
        from_condition = bool(torch.rand((), generator=batch.generator) < 0.5)
        if from_condition:
            code = self.sentence(batch.conditions).tanh()
        else:
            code = last_states(self.encoder(rows)[0], batch.lengths.clamp(max=frames))
        predicted = self.decode(code, first_poses(rows, self.config.mean_first, batch.generator), frames)
        mask = batch.mask[:, :frames]
        return {"loss": smooth_l1_loss(predicted[mask], rows[mask])}

    def sample(self, batch: SampleBatch) -> Rows:
        """Standardised rows, starting from the mean pose; deterministic."""
        code = self.sentence(batch.conditions).tanh()
        return self.decode(code, code.new_zeros(len(code), self.numbers), batch.frames)


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


@dataclass(frozen=True)
class T2mAutoencoderNetworkConfig:
    """T2M's movement autoencoder: convolutions between four frames and one snippet."""

    width: int = 512
    dropout: float = 0.2


@dataclass(frozen=True)
class T2mNetworkConfig:
    """T2M's temporal VAE: widths of its cells, of the text's vector and of a snippet's latent.

    Training sees `first_units` snippets of a motion, and `last_units` after half of its steps.
    """

    width: int = 1024
    value: int = 512
    latent: int = 128
    first_units: int = 10
    last_units: int = 49


class T2mAutoencoder(PeerNetwork):
    """T2M, stage 1: an autoencoder, four frames ↔ one snippet."""

    def __init__(self, config: T2mAutoencoderNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        numbers, width = inputs.space.num_features, config.width
        self.width, self.numbers = width, numbers
        self.encoder = nn.Sequential(
            nn.Conv1d(numbers - CONTACTS, width, 4, 2, 1),
            nn.Dropout(config.dropout),
            nn.LeakyReLU(SLOPE),
            nn.Conv1d(width, width, 4, 2, 1),
            nn.Dropout(config.dropout),
            nn.LeakyReLU(SLOPE),
            nn.Conv1d(width, width, 1),
        )
        self.decoder = nn.Sequential(
            nn.ConvTranspose1d(width, width, 4, 2, 1),
            nn.LeakyReLU(SLOPE),
            nn.ConvTranspose1d(width, numbers, 4, 2, 1),
            nn.LeakyReLU(SLOPE),
            nn.Conv1d(numbers, numbers, 1),
        )

    def encode(self, rows: Rows) -> Snippets:
        """Snippets of motions whose lengths are multiples of four frames."""
        return _by_channels(self.encoder, rows[..., :-CONTACTS])

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """L1 of valid frames, and L1 penalties on snippets and on their differences."""
        rows, counts = whole_snippets(batch)
        mask = frames_within(counts, rows.shape[1] // SNIPPET)
        snippets = self.encode(rows)
        decoded = _by_channels(self.decoder, snippets)
        frame_mask = mask.repeat_interleave(SNIPPET, dim=1)
        frames = l1_loss(decoded[frame_mask], rows[frame_mask])
        sizes = snippets[mask].abs().mean()
        pairs = mask[:, 1:]
        changes = snippets.diff(dim=1).abs().mean(dim=-1)[pairs].sum() / pairs.sum().clamp(min=1)
        loss = frames + SNIPPET_WEIGHT * sizes + SNIPPET_WEIGHT * changes
        return {"loss": loss, "frames": frames, "sizes": sizes}


def _by_channels(convolutions: nn.Module, values: Float[Tensor, "batch times inputs"]) -> Snippets:
    """Convolutions over time, whose channels come first in torch."""
    outputs: Tensor = convolutions(values.transpose(1, 2)).transpose(1, 2)
    return outputs


def whole_snippets(batch: MotionBatch) -> tuple[Rows, Lengths]:
    """Rows truncated to whole snippets, and each motion's number of snippets."""
    counts = batch.lengths // SNIPPET
    return batch.rows[:, : SNIPPET * int(counts.max())], counts


class Recurrent(nn.Module):
    """A GRU cell on embedded inputs, with the time to arrival added; with a `latent` size, N(μ, σ²) of its state."""

    def __init__(self, inputs: int, width: int, latent: int = 0) -> None:
        super().__init__()
        self.width = width
        self.embed = nn.Sequential(nn.Linear(inputs, width), nn.LayerNorm(width), nn.LeakyReLU(SLOPE))
        self.cell = nn.GRUCell(width, width)
        if latent:
            self.mean, self.log_variance = nn.Linear(width, latent), nn.Linear(width, latent)

    def forward(self, inputs: Tensor, left: Lengths, state: Latents) -> Latents:
        """The next hidden state; `left` counts the snippets still to come."""
        following: Tensor = self.cell(self.embed(inputs) + sinusoids(left, self.width), state)
        return following

    def gaussian(self, state: Latents) -> tuple[Tensor, Tensor]:
        """μ and log σ²."""
        return self.mean(state), self.log_variance(state)


class T2m(PeerNetwork):
    """T2M, stage 2: snippets under a condition, each from the one before and a latent with a learned prior."""

    def __init__(self, config: T2mNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        autoencoder = inputs.earlier
        assert isinstance(autoencoder, T2mAutoencoder)
        self.config, width, size = config, config.width, autoencoder.width
        self.autoencoder = (autoencoder,)  # in a tuple: frozen; a copy of its decoder is fine-tuned
        self.frames_out = copy.deepcopy(autoencoder.decoder).requires_grad_(True)
        self.sentence, self.value = ConditionVector(inputs.conditions, width), nn.Linear(width, config.value)
        self.starts = nn.ModuleList(nn.Linear(width, width) for _ in range(3))
        sizes = size + config.value
        self.prior = Recurrent(sizes, width, config.latent)
        self.posterior = Recurrent(sizes + size, width, config.latent)
        self.decoder = Recurrent(sizes + config.latent, width)
        self.snippet_out = nn.Sequential(
            nn.Linear(width, width), nn.LayerNorm(width), nn.LeakyReLU(SLOPE), nn.Linear(width, size)
        )

    def forward(
        self,
        conditions: Conditions,
        counts: Lengths,
        noise: Float[Tensor, "batch snippets latent"],
        truth: Snippets | None = None,
        *,
        forced: bool = False,
    ) -> tuple[Snippets, Float[Tensor, "batch snippets"]]:
        """Snippets, and the KL of the posterior where `truth` is given; `forced`: each follows the true one before.

        Latents are drawn with this noise from the posterior, or without `truth` from the prior.
        """
        sentence = self.sentence(conditions)
        value, (prior_state, posterior_state, state) = self.value(sentence), (start(sentence) for start in self.starts)
        # The start token: the snippet of four zero frames.
        zeros = noise.new_zeros(len(noise), SNIPPET, self.autoencoder[0].numbers)
        with torch.no_grad():
            previous = self.autoencoder[0].encode(zeros)[:, 0]
        snippets, divergence = [], []
        for step in range(noise.shape[1]):
            left, inputs = (counts - step).clamp(min=0), torch.cat((previous, value), dim=1)
            prior_state = self.prior(inputs, left, prior_state)
            mean, log_variance = prior = self.prior.gaussian(prior_state)
            if truth is not None:
                posterior_state = self.posterior(torch.cat((inputs, truth[:, step]), dim=1), left, posterior_state)
                mean, log_variance = self.posterior.gaussian(posterior_state)
            latent = mean + (0.5 * log_variance).exp() * noise[:, step]
            state = self.decoder(torch.cat((inputs, latent), dim=1), left, state)
            previous = self.snippet_out(state)
            snippets.append(previous)
            divergence.append(kl_between((mean, log_variance), prior).sum(dim=1))
            if forced and truth is not None:
                previous = truth[:, step]
        return torch.stack(snippets, dim=1), torch.stack(divergence, dim=1)

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Smooth L1 of frames and snippets, and KL of posterior and prior, over the snippets of the curriculum."""
        config = self.config
        share = min(1.0, batch.progress / CURRICULUM)
        rows, counts = whole_snippets(batch)
        counts = counts.clamp(max=config.first_units + int(share * (config.last_units - config.first_units)))
        with torch.no_grad():
            truth = self.autoencoder[0].encode(rows)[:, : int(counts.max())]
        forced = bool(torch.rand((), generator=batch.generator) < TEACHER_FORCING)
        noise = [torch.randn((len(counts), config.latent), generator=batch.generator) for _ in range(truth.shape[1])]
        snippets, kl = self(batch.conditions, counts, torch.stack(noise, dim=1).to(rows.device), truth, forced=forced)
        mask = frames_within(counts, truth.shape[1])
        frame_mask = mask.repeat_interleave(SNIPPET, dim=1)
        frames = smooth_l1_loss(self._frames(snippets, counts)[frame_mask], rows[:, : frame_mask.shape[1]][frame_mask])
        matched = smooth_l1_loss(snippets[mask], truth[mask])
        kl = kl[mask].mean()
        return {"loss": frames + matched + KL_WEIGHT * kl, "frames": frames, "snippets": matched, "kl": kl}

    def sample(self, batch: SampleBatch) -> Rows:
        """Standardised rows, with latents from the prior; the last snippet may be truncated."""
        counts = (batch.lengths + SNIPPET - 1) // SNIPPET
        noise, counts = batch.noise_within(counts, self.config.latent).float(), counts.to(batch.device)
        snippets, _ = self(batch.conditions, counts, noise)
        return self._frames(snippets, counts)[:, : batch.frames]

    def _frames(self, snippets: Snippets, counts: Lengths) -> Rows:
        """Decoded frames; snippets beyond a motion's length are zeroed."""
        return _by_channels(self.frames_out, snippets * frames_within(counts, snippets.shape[1])[..., None])


def kl_between(one: tuple[Tensor, Tensor], other: tuple[Tensor, Tensor]) -> Float[Tensor, "batch latent"]:
    """Elementwise KL divergence of two Gaussians given by μ and log σ²."""
    spread = one[1].exp() + (one[0] - other[0]).square()
    return 0.5 * (other[1] - one[1] + spread / other[1].exp() - 1)


JL2P_SIZES = Jl2pNetworkConfig(width=256, lengths=(2, 4, 8, 16, 32, 82), mean_first=0.5)
JL2P_NANO = PeerConfig(JL2P_SIZES, cosine(6000, 64, 1e-3), GIVEN_MINILM, SLOW, clip_norm=1.0)
JL2P_PAPER = PeerConfig(Jl2pNetworkConfig(), dropping(1000, 100), GIVEN, replace(SLOW, sampled_frames=16))
JL2P = PeerStage("jl2p", Jl2p, JL2P_NANO, JL2P_PAPER)
HIER_SIZES = HierNetworkConfig(limb=64, width=160, mean_first=0.5)
HIER_NANO = PeerConfig(HIER_SIZES, cosine(2400, 32, 3e-3), GIVEN_MINILM, SLOW, clip_norm=1.0)
HIER_PAPER = PeerConfig(HierNetworkConfig(), dropping(300, 32), GIVEN, replace(SLOW, sampled_frames=32))
HIER = PeerStage("hier", Hier, HIER_NANO, HIER_PAPER)

IN_24 = MotionsConfig(sampled_frames=24)
SMALL_AUTOENCODER, PUBLISHED_24 = T2mAutoencoderNetworkConfig(width=192), Schedule(epochs=270, batch_size=128)
NANO_24 = PeerConfig(SMALL_AUTOENCODER, cosine(4000, 128, 3e-3), UNCONDITIONAL, IN_24, precision="auto")
PAPER_24 = PeerConfig(T2mAutoencoderNetworkConfig(), PUBLISHED_24, UNCONDITIONAL, IN_24)
T2M_AUTOENCODER = PeerStage("t2m-autoencoder", T2mAutoencoder, NANO_24, PAPER_24, share=0.3)
T2M_SIZES = T2mNetworkConfig(width=256, value=128, latent=64)
T2M_NANO = PeerConfig(T2M_SIZES, cosine(1500, 32, 5e-4), GIVEN_MINILM, clip_norm=0.5)
T2M_PUBLISHED = Schedule(steps=300_000, batch_size=32, learning_rate=2e-4)
T2M_PAPER = PeerConfig(T2mNetworkConfig(), T2M_PUBLISHED, GIVEN, clip_norm=0.5)
T2M = PeerStage("t2m", T2m, T2M_NANO, T2M_PAPER, builds_on=T2M_AUTOENCODER, share=0.7)
