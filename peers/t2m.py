"""T2M's temporal VAE (Guo et al. 2022; EricGuo5513/text-to-motion, networks/modules.py): autoregressive in snippets."""

import copy
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import l1_loss, smooth_l1_loss

from motionkit.core.shapes import Float, Int64
from motionkit.training.config import DiffusionConfig, Schedule
from motionkit.training.networks import Conditions
from peers.generating import GIVEN, GIVEN_MINILM, UNCONDITIONAL, OptimizerConfig, PeerStage, cosine
from peers.layers import ConditionVector, NetworkInputs, PeerNetwork, sinusoids
from peers.motions import Lengths, MotionBatch, MotionsConfig, Rows, SampleBatch, frames_within

AUTOENCODER = "t2m-autoencoder"
SNIPPET = 4  # frames
CONTACTS = 4  # the last features of a pose, which the encoder does not see
SLOPE = 0.2


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

    def encode(self, rows: Rows) -> Float[Tensor, "batch snippets width"]:
        """Snippets of motions whose lengths are multiples of four frames."""
        hidden = self.encoder(rows[..., :-CONTACTS].transpose(1, 2)).transpose(1, 2)
        snippets: Tensor = self.encoder_out(hidden)
        return snippets

    def losses(self, batch: MotionBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """L1 of valid frames, and L1 penalties on snippets and on their differences."""
        rows, counts = whole_snippets(batch)
        mask = frames_within(counts, rows.shape[1] // SNIPPET)
        snippets = self.encode(rows)
        made = self.decoder(snippets)
        frame_mask = mask.repeat_interleave(SNIPPET, dim=1)
        frames = l1_loss(made[frame_mask], rows[frame_mask])
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

    def forward(self, snippets: Float[Tensor, "batch snippets width"]) -> Rows:
        """Standardised rows."""
        rows: Tensor = self.out(self.layers(snippets.transpose(1, 2)).transpose(1, 2))
        return rows


def whole_snippets(batch: MotionBatch) -> tuple[Float[Tensor, "batch whole numbers"], Lengths]:
    """Rows truncated to whole snippets, and each motion's number of snippets."""
    counts = batch.lengths // SNIPPET
    frames = SNIPPET * int(counts.max())
    return batch.rows[:, :frames], counts


class Recurrent(nn.Module):
    """A GRU cell on embedded inputs, with the time to arrival added."""

    def __init__(self, inputs: int, width: int) -> None:
        super().__init__()
        self.embed = nn.Sequential(nn.Linear(inputs, width), nn.LayerNorm(width), nn.LeakyReLU(SLOPE))
        self.cell = nn.GRUCell(width, width)
        self.width = width

    def forward(
        self, inputs: Float[Tensor, "batch inputs"], left: Int64[Tensor, "batch"], hidden: Float[Tensor, "batch width"]
    ) -> Float[Tensor, "batch width"]:
        """The next hidden state; `left` counts the snippets still to come."""
        state: Tensor = self.cell(self.embed(inputs) + sinusoids(left, self.width), hidden)
        return state


class Gaussian(Recurrent):
    """A recurrent cell that predicts μ and log σ² of its state."""

    def __init__(self, inputs: int, width: int, latent: int) -> None:
        super().__init__(inputs, width)
        self.mean, self.log_variance = nn.Linear(width, latent), nn.Linear(width, latent)

    def of(self, hidden: Float[Tensor, "batch width"]) -> tuple[Tensor, Tensor]:
        """μ and log σ²."""
        return self.mean(hidden), self.log_variance(hidden)


@dataclass
class Hidden:
    """Hidden states of the three cells."""

    prior: Tensor
    posterior: Tensor
    decoder: Tensor


class T2m(PeerNetwork):
    """Snippets under a condition, each from the one before and a latent; the latent's prior is learned with it."""

    def __init__(self, config: T2mNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        autoencoder = inputs.earlier[AUTOENCODER]
        assert isinstance(autoencoder, T2mAutoencoder)
        self.config, width, size = config, config.width, autoencoder.width
        self._autoencoder = (autoencoder,)  # frozen; a copy of its decoder is fine-tuned
        self.frames_out = copy.deepcopy(autoencoder.decoder).requires_grad_(True)
        self.sentence, self.value = ConditionVector(inputs.conditions, width), nn.Linear(width, config.value)
        self.starts = nn.ModuleList(nn.Linear(width, width) for _ in range(3))
        sizes = size + config.value
        self.prior = Gaussian(sizes, width, config.latent)
        self.posterior = Gaussian(sizes + size, width, config.latent)
        self.decoder = Recurrent(sizes + config.latent, width)
        self.snippet_out = nn.Sequential(
            nn.Linear(width, width), nn.LayerNorm(width), nn.LeakyReLU(SLOPE), nn.Linear(width, size)
        )
        self._progress = 1.0

    def begin_step(self, step: int, steps: int) -> None:
        """The curriculum: training progress determines how much of a motion is used."""
        self._progress = step / steps

    def losses(self, batch: MotionBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Smooth L1 of frames and snippets, and KL of posterior and prior, over the snippets of the curriculum."""
        rows, counts = whole_snippets(batch)
        counts = counts.clamp(max=self._curriculum_length())
        with torch.no_grad():
            truth = self._autoencoder[0].encode(rows)[:, : int(counts.max())]
        forced = bool(torch.rand((), generator=generator) < self.config.teacher_forcing)
        condition, hidden = self._begin(batch.conditions)
        previous = self._first(rows)
        made, divergence = [], []
        for step in range(truth.shape[1]):
            left = (counts - step).clamp(min=0)
            noise = torch.randn((len(counts), self.config.latent), generator=generator).to(rows.device)
            snippet, kl = self._step(previous, condition, hidden, left, noise, truth[:, step])
            made.append(snippet)
            divergence.append(kl)
            previous = truth[:, step] if forced else snippet
        mask = frames_within(counts, truth.shape[1])
        snippets = torch.stack(made, dim=1)
        frame_mask = mask.repeat_interleave(SNIPPET, dim=1)
        frames = smooth_l1_loss(self._frames(snippets, counts)[frame_mask], rows[:, : frame_mask.shape[1]][frame_mask])
        matched = smooth_l1_loss(snippets[mask], truth[mask])
        kl = torch.stack(divergence, dim=1)[mask].mean()
        loss = frames + matched + self.config.kl_weight * kl
        return {"loss": loss, "frames": frames, "snippets": matched, "kl": kl}

    def sample(self, batch: SampleBatch, diffusion: DiffusionConfig) -> Rows:
        """Standardised rows, with latents from the prior; the last snippet may be truncated."""
        counts = (batch.lengths + SNIPPET - 1) // SNIPPET
        noise = batch.noise_within(counts, self.config.latent).to(batch.device, torch.float32)
        condition, hidden = self._begin(batch.conditions.to(batch.device))
        counts = counts.to(batch.device)
        previous = self._first(torch.zeros((len(counts), 1, self.frames_out.out.out_features), device=batch.device))
        made = []
        for step in range(noise.shape[1]):
            previous, _ = self._step(previous, condition, hidden, (counts - step).clamp(min=0), noise[:, step], None)
            made.append(previous)
        return self._frames(torch.stack(made, dim=1), counts)[:, : batch.frames]

    def _frames(self, snippets: Float[Tensor, "batch snippets size"], counts: Int64[Tensor, "batch"]) -> Rows:
        """Decoded frames; snippets beyond a motion's length are zeroed."""
        rows: Tensor = self.frames_out(snippets * frames_within(counts, snippets.shape[1])[..., None])
        return rows

    def _step(
        self,
        previous: Float[Tensor, "batch size"],
        condition: Float[Tensor, "batch value"],
        hidden: Hidden,
        left: Int64[Tensor, "batch"],
        noise: Float[Tensor, "batch latent"],
        truth: Float[Tensor, "batch size"] | None,
    ) -> tuple[Float[Tensor, "batch size"], Float[Tensor, "batch"]]:
        """The next snippet, and the posterior's KL where `truth` is given; updates `hidden`."""
        inputs = torch.cat((previous, condition), dim=1)
        hidden.prior = self.prior(inputs, left, hidden.prior)
        mean, log_variance = prior = self.prior.of(hidden.prior)
        if truth is not None:
            hidden.posterior = self.posterior(torch.cat((inputs, truth), dim=1), left, hidden.posterior)
            mean, log_variance = self.posterior.of(hidden.posterior)
        latent = mean + (0.5 * log_variance).exp() * noise
        hidden.decoder = self.decoder(torch.cat((inputs, latent), dim=1), left, hidden.decoder)
        return self.snippet_out(hidden.decoder), kl_between((mean, log_variance), prior).sum(dim=1)

    def _begin(self, conditions: Conditions) -> tuple[Float[Tensor, "batch value"], Hidden]:
        sentence = self.sentence(conditions)
        return self.value(sentence), Hidden(*(start(sentence) for start in self.starts))

    def _first(self, rows: Rows) -> Float[Tensor, "batch size"]:
        """The start token: the snippet of four zero frames."""
        with torch.no_grad():
            return self._autoencoder[0].encode(torch.zeros_like(rows[:, :1]).expand(-1, SNIPPET, -1))[:, 0]

    def _curriculum_length(self) -> int:
        """Number of snippets used at this point of the curriculum."""
        first, last = self.config.first_units, self.config.last_units
        share = min(1.0, self._progress / self.config.curriculum)
        return first + int(share * (last - first))


def kl_between(one: tuple[Tensor, Tensor], other: tuple[Tensor, Tensor]) -> Float[Tensor, "batch latent"]:
    """Elementwise KL divergence of two Gaussians given by μ and log σ²."""
    spread = one[1].exp() + (one[0] - other[0]).square()
    return 0.5 * (other[1] - one[1] + spread / other[1].exp() - 1)


IN_24 = MotionsConfig(seen="stretch", seen_frames=24)
T2M_AUTOENCODER = PeerStage(
    AUTOENCODER,
    "T2M, stage 1: snippets of four frames",
    T2mAutoencoder,
    {
        "nano": {
            "network": T2mAutoencoderNetworkConfig(width=192),
            "motions": IN_24,
            "conditions": UNCONDITIONAL,
            "schedule": cosine(4000, 128, 3e-3),
            "precision": "auto",
        },
        "paper": {
            "network": T2mAutoencoderNetworkConfig(),
            "motions": IN_24,
            "conditions": UNCONDITIONAL,
            "schedule": Schedule(epochs=270, batch_size=128),
        },
    },
    share=0.3,
)
T2M = PeerStage(
    "t2m",
    "T2M, stage 2: a conditional recurrent VAE of snippets",
    T2m,
    {
        "nano": {
            "network": T2mNetworkConfig(width=256, value=128, latent=64),
            "conditions": GIVEN_MINILM,
            "schedule": cosine(1500, 32, 5e-4),
            "optimizer": OptimizerConfig(clip_norm=0.5),
        },
        "paper": {
            "network": T2mNetworkConfig(),
            "conditions": GIVEN,
            "schedule": Schedule(steps=300_000, batch_size=32, learning_rate=2e-4),
            "optimizer": OptimizerConfig(clip_norm=0.5),
        },
    },
    builds_on=(T2M_AUTOENCODER,),
    share=0.7,
)
