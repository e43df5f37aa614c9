"""T2M's temporal VAE (Guo et al. 2022; EricGuo5513/text-to-motion, networks/modules.py): autoregressive in snippets."""

import copy
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import l1_loss, smooth_l1_loss

from motionkit.core.shapes import Float
from motionkit.training.config import Schedule
from motionkit.training.networks import Conditions
from peers.generating import GIVEN, GIVEN_MINILM, UNCONDITIONAL, PeerConfig, PeerStage, cosine
from peers.layers import ConditionVector, Latents, NetworkInputs, PeerNetwork, sinusoids
from peers.motions import Lengths, MotionBatch, MotionsConfig, Rows, SampleBatch, frames_within

SNIPPET = 4  # frames
CONTACTS = 4  # the last features of a pose, which the encoder does not see
SLOPE = 0.2
SIZE_WEIGHT, CHANGE_WEIGHT = 1e-3, 1e-3
Snippets = Float[Tensor, "batch snippets size"]


@dataclass(frozen=True)
class T2mAutoencoderNetworkConfig:
    """T2M's movement autoencoder: convolutions between four frames and one snippet."""

    width: int = 512
    dropout: float = 0.2


@dataclass(frozen=True)
class T2mNetworkConfig:
    """T2M's temporal VAE: widths of its cells, of the text's vector and of a snippet's latent.

    Training sees `first_units` snippets of a motion, and `last_units` after the share `curriculum` of its steps.
    """

    width: int = 1024
    value: int = 512
    latent: int = 128
    kl_weight: float = 0.01
    teacher_forcing: float = 0.4
    first_units: int = 10
    last_units: int = 49
    curriculum: float = 0.5


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
        loss = frames + SIZE_WEIGHT * sizes + CHANGE_WEIGHT * changes
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
        share = min(1.0, batch.progress / config.curriculum)
        rows, counts = whole_snippets(batch)
        counts = counts.clamp(max=config.first_units + int(share * (config.last_units - config.first_units)))
        with torch.no_grad():
            truth = self.autoencoder[0].encode(rows)[:, : int(counts.max())]
        forced = bool(torch.rand((), generator=batch.generator) < config.teacher_forcing)
        noise = [torch.randn((len(counts), config.latent), generator=batch.generator) for _ in range(truth.shape[1])]
        snippets, kl = self(batch.conditions, counts, torch.stack(noise, dim=1).to(rows.device), truth, forced=forced)
        mask = frames_within(counts, truth.shape[1])
        frame_mask = mask.repeat_interleave(SNIPPET, dim=1)
        frames = smooth_l1_loss(self._frames(snippets, counts)[frame_mask], rows[:, : frame_mask.shape[1]][frame_mask])
        matched = smooth_l1_loss(snippets[mask], truth[mask])
        kl = kl[mask].mean()
        return {"loss": frames + matched + config.kl_weight * kl, "frames": frames, "snippets": matched, "kl": kl}

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


IN_24 = MotionsConfig(sampled_frames=24)
SMALL_AUTOENCODER, PUBLISHED_24 = T2mAutoencoderNetworkConfig(width=192), Schedule(epochs=270, batch_size=128)
NANO_24 = PeerConfig(SMALL_AUTOENCODER, cosine(4000, 128, 3e-3), UNCONDITIONAL, IN_24, precision="auto")
PAPER_24 = PeerConfig(T2mAutoencoderNetworkConfig(), PUBLISHED_24, UNCONDITIONAL, IN_24)
T2M_AUTOENCODER = PeerStage("t2m-autoencoder", T2mAutoencoder, NANO_24, PAPER_24, share=0.3)
SMALL = T2mNetworkConfig(width=256, value=128, latent=64)
NANO = PeerConfig(SMALL, cosine(1500, 32, 5e-4), GIVEN_MINILM, clip_norm=0.5)
PUBLISHED = Schedule(steps=300_000, batch_size=32, learning_rate=2e-4)
PAPER = PeerConfig(T2mNetworkConfig(), PUBLISHED, GIVEN, clip_norm=0.5)
T2M = PeerStage("t2m", T2m, NANO, PAPER, builds_on=T2M_AUTOENCODER, share=0.7)
