"""T2M's temporal VAE (Guo et al. 2022; EricGuo5513/text-to-motion, networks/modules.py): autoregressive in snippets."""

import copy
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import l1_loss, smooth_l1_loss

from motionkit.core.shapes import Float, Int64
from motionkit.training.config import Schedule
from motionkit.training.networks import Conditions
from peers.generating import GIVEN, GIVEN_MINILM, UNCONDITIONAL, PeerConfig, PeerStage, cosine
from peers.layers import ConditionVector, NetworkInputs, PeerNetwork, sinusoids
from peers.motions import Lengths, MotionBatch, MotionsConfig, Rows, SampleBatch, frames_within

AUTOENCODER = "t2m-autoencoder"
SNIPPET = 4  # frames
CONTACTS = 4  # the last features of a pose, which the encoder does not see
SLOPE = 0.2
Snippets = Float[Tensor, "batch snippets size"]


@dataclass(frozen=True)
class T2mAutoencoderNetworkConfig:
    """T2M's movement autoencoder: convolutions between four frames and one snippet."""

    width: int = 512
    dropout: float = 0.2
    size_weight: float = 1e-3
    change_weight: float = 1e-3


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
    """Autoencoder: four frames ↔ one snippet."""

    def __init__(self, config: T2mAutoencoderNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        numbers, width = inputs.space.num_features, config.width
        self.config, self.width = config, width
        self.encoder = nn.Sequential(
            nn.Conv1d(numbers - CONTACTS, width, 4, 2, 1),
            nn.Dropout(config.dropout),
            nn.LeakyReLU(SLOPE),
            nn.Conv1d(width, width, 4, 2, 1),
            nn.Dropout(config.dropout),
            nn.LeakyReLU(SLOPE),
        )
        self.encoder_out = nn.Linear(width, width)
        self.decoder = SnippetDecoder(width, numbers)

    def encode(self, rows: Rows) -> Snippets:
        """Snippets of motions whose lengths are multiples of four frames."""
        hidden = self.encoder(rows[..., :-CONTACTS].transpose(1, 2)).transpose(1, 2)
        snippets: Tensor = self.encoder_out(hidden)
        return snippets

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """L1 of valid frames, and L1 penalties on snippets and on their differences."""
        rows, counts = whole_snippets(batch)
        mask = frames_within(counts, rows.shape[1] // SNIPPET)
        snippets = self.encode(rows)
        decoded = self.decoder(snippets)
        frame_mask = mask.repeat_interleave(SNIPPET, dim=1)
        frames = l1_loss(decoded[frame_mask], rows[frame_mask])
        sizes = snippets[mask].abs().mean()
        pairs = mask[:, 1:]
        changes = (snippets[:, 1:] - snippets[:, :-1]).abs().mean(dim=-1)[pairs].sum() / pairs.sum().clamp(min=1)
        return {
            "loss": frames + self.config.size_weight * sizes + self.config.change_weight * changes,
            "frames": frames,
            "sizes": sizes,
        }


class SnippetDecoder(nn.Module):
    """Snippets → four frames each."""

    def __init__(self, width: int, numbers: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.ConvTranspose1d(width, width, 4, 2, 1),
            nn.LeakyReLU(SLOPE),
            nn.ConvTranspose1d(width, numbers, 4, 2, 1),
            nn.LeakyReLU(SLOPE),
        )
        self.out = nn.Linear(numbers, numbers)

    def forward(self, snippets: Snippets) -> Rows:
        """Standardised rows."""
        rows: Tensor = self.out(self.layers(snippets.transpose(1, 2)).transpose(1, 2))
        return rows


def whole_snippets(batch: MotionBatch) -> tuple[Float[Tensor, "batch whole numbers"], Lengths]:
    """Rows truncated to whole snippets, and each motion's number of snippets."""
    counts = batch.lengths // SNIPPET
    frames = SNIPPET * int(counts.max())
    return batch.rows[:, :frames], counts


class Recurrent(nn.Module):
    """A GRU cell on embedded inputs, with the time to arrival added; with a `latent` size, N(μ, σ²) of its state."""

    def __init__(self, inputs: int, width: int, latent: int = 0) -> None:
        super().__init__()
        self.embed = nn.Sequential(nn.Linear(inputs, width), nn.LayerNorm(width), nn.LeakyReLU(SLOPE))
        self.cell = nn.GRUCell(width, width)
        self.width = width
        if latent:
            self.mean, self.log_variance = nn.Linear(width, latent), nn.Linear(width, latent)

    def forward(
        self, inputs: Float[Tensor, "batch inputs"], left: Int64[Tensor, "batch"], state: Float[Tensor, "batch width"]
    ) -> Float[Tensor, "batch width"]:
        """The next hidden state; `left` counts the snippets still to come."""
        following: Tensor = self.cell(self.embed(inputs) + sinusoids(left, self.width), state)
        return following

    def gaussian(self, state: Float[Tensor, "batch width"]) -> tuple[Tensor, Tensor]:
        """μ and log σ²."""
        return self.mean(state), self.log_variance(state)


class T2m(PeerNetwork):
    """Snippets under a condition, each from the one before and a latent; the latent's prior is learned with it."""

    def __init__(self, config: T2mNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        autoencoder = inputs.earlier[AUTOENCODER]
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
        zeros = noise.new_zeros(len(noise), SNIPPET, self.frames_out.out.out_features)
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
        rows: Tensor = self.frames_out(snippets * frames_within(counts, snippets.shape[1])[..., None])
        return rows


def kl_between(one: tuple[Tensor, Tensor], other: tuple[Tensor, Tensor]) -> Float[Tensor, "batch latent"]:
    """Elementwise KL divergence of two Gaussians given by μ and log σ²."""
    spread = one[1].exp() + (one[0] - other[0]).square()
    return 0.5 * (other[1] - one[1] + spread / other[1].exp() - 1)


IN_24 = MotionsConfig(sampled_frames=24)
T2M_AUTOENCODER = PeerStage(
    AUTOENCODER,
    "T2M, stage 1: snippets of four frames",
    T2mAutoencoder,
    nano=PeerConfig(
        T2mAutoencoderNetworkConfig(width=192), IN_24, UNCONDITIONAL, cosine(4000, 128, 3e-3), precision="auto"
    ),
    paper=PeerConfig(T2mAutoencoderNetworkConfig(), IN_24, UNCONDITIONAL, Schedule(epochs=270, batch_size=128)),
    share=0.3,
)
T2M = PeerStage(
    "t2m",
    "T2M, stage 2: a conditional recurrent VAE of snippets",
    T2m,
    nano=PeerConfig(
        T2mNetworkConfig(width=256, value=128, latent=64),
        conditions=GIVEN_MINILM,
        schedule=cosine(1500, 32, 5e-4),
        clip_norm=0.5,
    ),
    paper=PeerConfig(
        T2mNetworkConfig(),
        conditions=GIVEN,
        schedule=Schedule(steps=300_000, batch_size=32, learning_rate=2e-4),
        clip_norm=0.5,
    ),
    builds_on=(T2M_AUTOENCODER,),
    share=0.7,
)
