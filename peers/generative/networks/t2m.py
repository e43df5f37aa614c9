"""T2M's temporal VAE (Guo et al. 2022; EricGuo5513/text-to-motion, networks/modules.py): snippet after snippet."""

import copy
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn
from torch.nn.functional import l1_loss, smooth_l1_loss

from motionkit.training.diffusion.settings import DiffusionConfig
from peers.generative.batches import Conditions, ConditionSizes, MotionBatch, PoseSpace, Wanted, frames_within
from peers.generative.networks.layers import ConditionVector, sinusoids
from peers.generative.settings import T2mAutoencoderNetworkConfig, T2mNetworkConfig

AUTOENCODER = "t2m-autoencoder"
SNIPPET = 4  # frames
CONTACTS = 4  # numbers that end a pose, which the encoder does not see
SLOPE = 0.2


class T2mAutoencoder(nn.Module):
    """Frames ↔ one snippet for every four of them."""

    def __init__(
        self,
        config: T2mAutoencoderNetworkConfig,
        space: PoseSpace,
        sizes: ConditionSizes,
        earlier: Mapping[str, nn.Module],
    ) -> None:
        super().__init__()
        numbers, width = space.num_numbers, config.width
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

    def encode(self, rows: Float[Tensor, "batch frames numbers"]) -> Float[Tensor, "batch snippets width"]:
        """Snippets of whole multiples of four frames."""
        hidden = self.encoder(rows[..., :-CONTACTS].transpose(1, 2)).transpose(1, 2)
        snippets: Tensor = self.encoder_out(hidden)
        return snippets

    def losses(self, batch: MotionBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """L1 of the frames there are, and of snippets' sizes and differences."""
        rows, units = in_units(batch)
        seen = frames_within(units, rows.shape[1] // SNIPPET)
        snippets = self.encode(rows)
        made = self.decoder(snippets)
        of_frames = seen.repeat_interleave(SNIPPET, dim=1)
        frames = l1_loss(made[of_frames], rows[of_frames])
        sizes = snippets[seen].abs().mean()
        pairs = seen[:, 1:]
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

    def forward(self, snippets: Float[Tensor, "batch snippets width"]) -> Float[Tensor, "batch frames numbers"]:
        """Standardised rows."""
        rows: Tensor = self.out(self.layers(snippets.transpose(1, 2)).transpose(1, 2))
        return rows


def in_units(batch: MotionBatch) -> tuple[Float[Tensor, "batch whole numbers"], Int64[Tensor, "batch"]]:
    """Rows up to whole snippets, and how many of these each motion has; what is left of a motion is left out."""
    units = batch.lengths // SNIPPET
    frames = SNIPPET * int(units.max())
    return batch.rows[:, :frames], units


class Recurrent(nn.Module):
    """An embedding of what is known at a step, the time to arrival added, and a recurrent cell."""

    def __init__(self, inputs: int, width: int) -> None:
        super().__init__()
        self.embed = nn.Sequential(nn.Linear(inputs, width), nn.LayerNorm(width), nn.LeakyReLU(SLOPE))
        self.cell = nn.GRUCell(width, width)
        self.width = width

    def forward(
        self, known: Float[Tensor, "batch inputs"], left: Int64[Tensor, "batch"], hidden: Float[Tensor, "batch width"]
    ) -> Float[Tensor, "batch width"]:
        """The next hidden state; `left` are the snippets that are still to come."""
        state: Tensor = self.cell(self.embed(known) + sinusoids(left, self.width), hidden)
        return state


class Gaussian(Recurrent):
    """A recurrent cell whose state says μ and log σ²."""

    def __init__(self, inputs: int, width: int, latent: int) -> None:
        super().__init__(inputs, width)
        self.mean, self.log_variance = nn.Linear(width, latent), nn.Linear(width, latent)

    def of(self, hidden: Float[Tensor, "batch width"]) -> tuple[Tensor, Tensor]:
        """μ and log σ²."""
        return self.mean(hidden), self.log_variance(hidden)


@dataclass
class Hidden:
    """States of the three cells."""

    prior: Tensor
    posterior: Tensor
    decoder: Tensor


class T2m(nn.Module):
    """Snippets of a condition: each from the one before and a latent, whose prior a network knows at training."""

    diffusion: DiffusionConfig | None = None

    def __init__(
        self, config: T2mNetworkConfig, space: PoseSpace, sizes: ConditionSizes, earlier: Mapping[str, nn.Module]
    ) -> None:
        super().__init__()
        autoencoder = earlier[AUTOENCODER]
        assert isinstance(autoencoder, T2mAutoencoder)
        self.config, width, size = config, config.width, autoencoder.width
        self._autoencoder = (autoencoder,)  # its encoder is frozen, its decoder is trained on
        self.frames_out = copy.deepcopy(autoencoder.decoder).requires_grad_(True)
        self.sentence, self.value = ConditionVector(sizes, width), nn.Linear(width, config.value)
        self.starts = nn.ModuleList(nn.Linear(width, width) for _ in range(3))
        told = size + config.value
        self.prior = Gaussian(told, width, config.latent)
        self.posterior = Gaussian(told + size, width, config.latent)
        self.decoder = Recurrent(told + config.latent, width)
        self.snippet_out = nn.Sequential(
            nn.Linear(width, width), nn.LayerNorm(width), nn.LeakyReLU(SLOPE), nn.Linear(width, size)
        )
        self._progress = 1.0

    def begin_step(self, step: int, steps: int) -> None:
        """How far the training is decides how much of a motion is in sight."""
        self._progress = step / steps

    def losses(self, batch: MotionBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Smooth L1 of frames and snippets, and KL of posterior and prior, of as many snippets as are in sight."""
        rows, units = in_units(batch)
        units = units.clamp(max=self._in_sight())
        with torch.no_grad():
            truth = self._autoencoder[0].encode(rows)[:, : int(units.max())]
        forced = bool(torch.rand((), generator=generator) < self.config.teacher_forcing)
        condition, hidden = self._begin(batch.conditions)
        previous = self._first(rows)
        made, divergence = [], []
        for step in range(truth.shape[1]):
            left = (units - step).clamp(min=0)
            noise = torch.randn((len(units), self.config.latent), generator=generator).to(rows.device)
            snippet, kl = self._step(previous, condition, hidden, left, noise, truth[:, step])
            made.append(snippet)
            divergence.append(kl)
            previous = truth[:, step] if forced else snippet
        seen = frames_within(units, truth.shape[1])
        snippets = torch.stack(made, dim=1)
        of_frames = seen.repeat_interleave(SNIPPET, dim=1)
        frames = smooth_l1_loss(self._frames(snippets, units)[of_frames], rows[:, : of_frames.shape[1]][of_frames])
        matched = smooth_l1_loss(snippets[seen], truth[seen])
        kl = torch.stack(divergence, dim=1)[seen].mean()
        loss = frames + matched + self.config.kl_weight * kl
        return {"loss": loss, "frames": frames, "snippets": matched, "kl": kl}

    def sample(self, wanted: Wanted, diffusion: DiffusionConfig) -> Float[Tensor, "batch frames numbers"]:
        """Standardised rows, latents from the prior; a last snippet may be cut."""
        units = (wanted.lengths + SNIPPET - 1) // SNIPPET
        noise = wanted.noise_within(units, self.config.latent).to(wanted.device, torch.float32)
        condition, hidden = self._begin(wanted.conditions.to(wanted.device))
        units = units.to(wanted.device)
        previous = self._first(torch.zeros((len(units), 1, self.frames_out.out.out_features), device=wanted.device))
        made = []
        for step in range(noise.shape[1]):
            previous, _ = self._step(previous, condition, hidden, (units - step).clamp(min=0), noise[:, step], None)
            made.append(previous)
        return self._frames(torch.stack(made, dim=1), units)[:, : wanted.frames]

    def _frames(
        self, snippets: Float[Tensor, "batch snippets size"], units: Int64[Tensor, "batch"]
    ) -> Float[Tensor, "batch frames numbers"]:
        """Frames of snippets; what lies behind a motion's own is zeros, as it is behind the longest's."""
        rows: Tensor = self.frames_out(snippets * frames_within(units, snippets.shape[1])[..., None])
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
        """The next snippet, and KL of the posterior where the truth is known; `hidden` goes on."""
        told = torch.cat((previous, condition), dim=1)
        hidden.prior = self.prior(told, left, hidden.prior)
        mean, log_variance = prior = self.prior.of(hidden.prior)
        if truth is not None:
            hidden.posterior = self.posterior(torch.cat((told, truth), dim=1), left, hidden.posterior)
            mean, log_variance = self.posterior.of(hidden.posterior)
        latent = mean + (0.5 * log_variance).exp() * noise
        hidden.decoder = self.decoder(torch.cat((told, latent), dim=1), left, hidden.decoder)
        return self.snippet_out(hidden.decoder), kl_between((mean, log_variance), prior).sum(dim=1)

    def _begin(self, conditions: Conditions) -> tuple[Float[Tensor, "batch value"], Hidden]:
        sentence = self.sentence(conditions)
        return self.value(sentence), Hidden(*(start(sentence) for start in self.starts))

    def _first(self, rows: Float[Tensor, "batch frames numbers"]) -> Float[Tensor, "batch size"]:
        """What comes before all: the snippet of four frames of zeros."""
        with torch.no_grad():
            return self._autoencoder[0].encode(torch.zeros_like(rows[:, :1]).expand(-1, SNIPPET, -1))[:, 0]

    def _in_sight(self) -> int:
        """How many snippets are learnt now: more and more of them."""
        first, last = self.config.first_units, self.config.last_units
        share = min(1.0, self._progress / self.config.curriculum)
        return first + int(share * (last - first))


def kl_between(one: tuple[Tensor, Tensor], other: tuple[Tensor, Tensor]) -> Float[Tensor, "batch latent"]:
    """Kullback-Leibler divergence of Gaussians given by μ and log σ², number by number."""
    spread = one[1].exp() + (one[0] - other[0]).square()
    return 0.5 * (other[1] - one[1] + spread / other[1].exp() - 1)
