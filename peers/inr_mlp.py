"""INR-MLP (Cervantes et al. 2022; PACerv/ImplicitMotion, models): an MLP of time and a per-motion latent code."""

import warnings
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from scipy.spatial.distance import cdist
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture
from torch import Tensor, nn

from motionkit.core.shapes import Float, Float64, Int64
from motionkit.training.config import Schedule
from motionkit.training.networks import NO_ACTION, kl_divergence, reparameterized
from peers.generating import GIVEN_ACTION, GIVEN_MINILM, PeerConfig, PeerStage, cosine
from peers.layers import ConditionVector, Latents, NetworkInputs, PeerNetwork, sinusoids
from peers.motions import MotionBatch, MotionsConfig, Rows, SampleBatch

INITIAL_LOG_VARIANCE = 1.0
# The root's position in `field` vectors.
ROOT = slice(0, 3)


@dataclass(frozen=True)
class InrMlpNetworkConfig:
    """INR-MLP: size of the codes and widths of the MLP; `reseeds` is how often a mixture that copies training motions
    is fitted again."""

    code: int = 128
    time_features: int = 256
    hidden: tuple[int, ...] = (1000, 500, 500, 200, 100)
    kl_weight: float = 1e-5
    reseeds: int = 10


class InrMlp(PeerNetwork):
    """INR-MLP: a pose at a frame index, from a motion code and a condition code, each N(μ, σ²).

    An auto-decoder: the codes of training motions are optimised alternately with the network.
    """

    def __init__(self, config: InrMlpNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        self.config = config
        self.mean = nn.Parameter(torch.zeros(inputs.num_windows, config.code))
        self.log_variance = nn.Parameter(torch.full((inputs.num_windows, config.code), INITIAL_LOG_VARIANCE))
        self.condition_mean = ConditionVector(inputs.conditions, config.code)
        self.condition_log_variance = ConditionVector(inputs.conditions, config.code)
        for vector, start in ((self.condition_mean, 0.0), (self.condition_log_variance, INITIAL_LOG_VARIANCE)):
            if vector.actions is not None:
                nn.init.constant_(vector.actions.weight, start)
        widths = (2 * config.code + config.time_features, *config.hidden)
        layers = [layer for pair in pairwise(widths) for layer in (nn.Linear(*pair), nn.ELU())]
        self.layers = nn.Sequential(*layers, nn.Linear(widths[-1], inputs.space.num_features))
        # Length and action of the motion that each code stands for.
        self.register_buffer("frames_of", torch.zeros(inputs.num_windows, dtype=torch.int64))
        self.register_buffer("action_of", torch.full((inputs.num_windows,), NO_ACTION))
        self.frames_of: Tensor
        self.action_of: Tensor
        self._mixtures: dict[tuple[int, int], CodeMixture] = {}

    def forward(self, frames: Int64[Tensor, "batch frames"], code: Latents, condition_code: Latents) -> Rows:
        """Standardised poses at these frame indices."""
        time = sinusoids(frames.flatten(), self.config.time_features).view(*frames.shape, -1)
        codes = torch.cat((code, condition_code), dim=1)[:, None].expand(-1, frames.shape[1], -1)
        rows: Tensor = self.layers(torch.cat((codes, time), dim=-1))
        return rows

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Squared errors of poses and of the root, and KL of both codes; every other step trains the codes alone."""
        conditions, trains_codes = batch.conditions, batch.step % 2 == 0
        self.frames_of.scatter_reduce_(0, batch.window, batch.frames.amax(dim=1) + 1, "amax")
        self.action_of[batch.window] = torch.where(conditions.given, conditions.action, self.action_of[batch.window])
        pairs = [
            (self.mean[batch.window], self.log_variance[batch.window]),
            (self.condition_mean(conditions), self.condition_log_variance(conditions)),
        ]
        if not trains_codes:
            pairs = [(mean.detach(), log_variance.detach()) for mean, log_variance in pairs]
        self.layers.requires_grad_(not trains_codes)
        predicted = self(batch.frames, *(reparameterized(*pair, batch.generator) for pair in pairs))
        self.layers.requires_grad_(True)
        errors = (predicted - batch.rows).square()[batch.mask]
        pose, root = errors.mean(), errors[:, ROOT].mean()
        kl = torch.stack([kl_divergence(*pair).sum(dim=1).mean() for pair in pairs]).sum()
        return {"loss": pose + root + self.config.kl_weight * kl, "pose": pose, "root": root, "kl": kl}

    def sample(self, batch: SampleBatch) -> Rows:
        """Standardised rows from codes of the mixture for the action and the length."""
        mean, log_variance = self.condition_mean(batch.conditions), self.condition_log_variance(batch.conditions)
        each = zip(batch.conditions.action.tolist(), batch.lengths.tolist(), batch.generators, strict=True)
        codes = [self.mixture(action, length).draw(generator) for action, length, generator in each]
        noise = [torch.randn(self.config.code, generator=generator) for generator in batch.generators]
        own = torch.stack(codes).to(batch.device, torch.float32)
        condition = mean + (0.5 * log_variance).exp() * torch.stack(noise).to(batch.device)
        frames = torch.arange(batch.frames, device=batch.device).expand(len(own), -1)
        poses: Tensor = self(frames, own, condition)
        return poses

    def mixture(self, action: int, length: int) -> "CodeMixture":
        """The mixture over codes of motions with this action (`NO_ACTION`: any) and lengths nearest to this one."""
        known = (self.frames_of > 0) & ((self.action_of == action) | (action == NO_ACTION))
        windows = np.flatnonzero((known if known.any() else self.frames_of > 0).cpu().numpy())
        lengths = self.frames_of.cpu().numpy()[windows]
        intervals = length_intervals(lengths)
        nearest = int(np.argmin([abs(lengths[rows].mean() - length) for rows in intervals]))
        if (action, nearest) not in self._mixtures:
            rows = torch.from_numpy(windows[intervals[nearest]])
            mean, log_variance = (each.detach().cpu()[rows].double().numpy() for each in (self.mean, self.log_variance))
            self._mixtures[action, nearest] = fit_mixture(mean, np.exp(0.5 * log_variance), self.config.reseeds)
        return self._mixtures[action, nearest]


LEAST_CODES, LEAST_FRAMES = 50, 10


def length_intervals(lengths: Int64[np.ndarray, "motions"]) -> list[Int64[np.ndarray, "some"]]:
    """Bin motions by length; each bin has at least `LEAST_CODES` motions and spans `LEAST_FRAMES` frames."""
    order = np.argsort(lengths, kind="stable")
    cuts, first = [], 0
    for place in range(1, len(order)):
        shortest, before, here = (lengths[order[each]] for each in (first, place - 1, place))
        enough = min(place - first, len(order) - place) >= LEAST_CODES
        if enough and here > before and here - shortest >= LEAST_FRAMES:
            cuts.append(place)
            first = place
    return np.split(order, cuts)


@dataclass(frozen=True, eq=False)
class CodeMixture:
    """A Gaussian mixture over codes; `factors` are the Cholesky factors of its covariances."""

    weights: Float64[np.ndarray, "parts"]
    means: Float64[np.ndarray, "parts code"]
    factors: Float64[np.ndarray, "parts code code"]

    def draw(self, generator: torch.Generator) -> Float[Tensor, "code"]:
        """A code, float64."""
        u = float(torch.rand((), generator=generator, dtype=torch.float64))
        component = min(int(np.searchsorted(np.cumsum(self.weights), u)), len(self.weights) - 1)
        noise = torch.randn(self.means.shape[1], generator=generator, dtype=torch.float64).numpy()
        return torch.from_numpy(self.means[component] + self.factors[component] @ noise)


COMPONENTS, DRAWS, MOST_DRAWS = 15, 50, 10_000
# A component whose mean is nearer to a training code than this share of the codes' mean norm copies that motion.
COPY_SHARE = 0.1


def fit_mixture(
    mean: Float64[np.ndarray, "codes code"], deviation: Float64[np.ndarray, "codes code"], reseeds: int
) -> CodeMixture:
    """Fit a mixture to samples of every code; refit if a component copies a training code, at last drop such."""
    count = int(np.clip(MOST_DRAWS // len(mean), 2, DRAWS))
    rng = np.random.default_rng(0)
    draws = (mean + deviation * rng.standard_normal((count, *mean.shape))).reshape(-1, mean.shape[1])
    least = COPY_SHARE * np.linalg.norm(mean, axis=1).mean()
    for seed in range(reseeds + 1):
        fitted = GaussianMixture(min(COMPONENTS, len(mean)), covariance_type="full", random_state=seed)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            fitted.fit(draws)
        away = cdist(fitted.means_, mean).min(axis=1) >= least
        if away.all():
            break
    kept = away if away.any() else np.ones_like(away)
    weights = fitted.weights_[kept] / fitted.weights_[kept].sum()
    return CodeMixture(weights, fitted.means_[kept], np.linalg.cholesky(fitted.covariances_[kept]))


# Whole windows, of which a step sees five frames.
WHOLE_IN_5 = MotionsConfig(pose_vectors="field", crops="scattered", sampled_frames=5)
SIZES, PUBLISHED = InrMlpNetworkConfig(reseeds=2), Schedule(epochs=10_000, batch_size=512, learning_rate=1e-3)
NANO = PeerConfig(SIZES, cosine(12_000, 256, 1e-3), GIVEN_MINILM, WHOLE_IN_5, precision="auto", clip_norm=2.0)
PAPER = PeerConfig(InrMlpNetworkConfig(), PUBLISHED, GIVEN_ACTION, WHOLE_IN_5, clip_norm=2.0)
INR_MLP = PeerStage("inr-mlp", InrMlp, NANO, PAPER)
