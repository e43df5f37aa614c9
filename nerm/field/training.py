"""Training the motion field and the posterior latents together (paper §3.1, Eq. 3 and 4, progressive training)."""

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import numpy as np
import torch

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float, Float32, Float64, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.data.poses import WindowPoses
from motionkit.data.windows import PositionSource, Windows, cut_windows, rows_by_duration, shuffled_batches
from motionkit.training.devices import ALONE, DealtRows, Ranks, autocast, compile_each
from motionkit.training.loop import scale_rates, seeded_initialisation, step_generator
from motionkit.training.pose_vectors import PoseTensors, VectorScaling, measure_scaling, uniform_of
from motionkit.training.tensors import load_training_tensors, prefixed, training_tensors
from nerm.field.network import FieldNetwork
from nerm.latents.linear_fit import LinearModel, fit_windows, measure_components
from nerm.latents.local import local_latents
from nerm.latents.posterior import LOG_VARIANCE_RANGE, RowAdam, kl_divergence, sample_posterior
from nerm.settings import FieldConfig


def linear_model(poses: WindowPoses, scaling: VectorScaling, config: FieldConfig) -> LinearModel | None:
    """The linear model of the windows' poses that local latents are fitted with; None for the global layout."""
    banks = local_latents(config)
    if banks is None:
        return None
    ridge = config.latents.ridge
    return LinearModel(banks, scaling, measure_components(poses, banks, scaling, ridge), ridge)


def initial_means(
    poses: WindowPoses,
    model: LinearModel | None,
    config: FieldConfig,
    seed: int,
    windows: Int64[torch.Tensor, "chosen"],
) -> Float32[torch.Tensor, "chosen latent"]:
    """μ of some windows before training: N(0, 1), or the linear model's fit."""
    if config.latents.initialisation == "ridge" and model is not None:
        return fit_windows(poses, model, windows.numpy())
    return torch.randn(len(poses.windows), config.latents.dimension, generator=step_generator(seed, "latents"))[windows]


class FieldTraining:
    """A `motionkit.training.loop.Trainable`: θ, {μ_i} and {log Σ_i} with their optimisers.

    Each rank owns the latents of its windows, a contiguous part of the corpus, and steps on its share of a batch; only
    the gradient of θ is reduced between ranks.
    """

    def __init__(
        self,
        poses: WindowPoses,
        config: FieldConfig,
        *,
        codebook: Float[torch.Tensor, "codes dimension"] | None,
        seed: int,
        device: torch.device,
        ranks: Ranks = ALONE,
    ) -> None:
        self.poses, self.config, self.seed, self.device = poses, config, seed, device
        self.scaling = measure_scaling(
            poses,
            grouped=config.loss.scaling == "group",
            root_weight=config.loss.root_weight,
            centred_path=config.latents.has_path,
        )
        model = linear_model(poses, self.scaling, config)
        self.components = None if model is None else model.components
        self.ranks = ranks
        in_corpus = np.argsort(poses.windows.start_row, kind="stable")
        self.own = DealtRows(ranks, poses.windows.duration_seconds, in_corpus)
        means = initial_means(poses, model, config, seed, self.own.rows)
        num_features = len(self.scaling.mean)
        self.scaling = self.scaling.to(device)
        with seeded_initialisation(seed, "field"):
            self.network = FieldNetwork(config, num_features, codebook).to(device)
        if self.network.linear is not None and self.components is not None:
            self.network.start_linear_path(self.components.mean, self.components.inverse())
        if config.compile:
            compile_each(self.network.layers)
        self.visits = rows_by_duration(poses.windows, config.clips.seconds_per_visit)
        self.steps = config.schedule.num_steps(len(self.visits))
        self.optimizer = torch.optim.AdamW(self._parameter_groups(), weight_decay=config.optimizer.weight_decay)
        self.mean = RowAdam(means.to(device), weight_decay=config.optimizer.weight_decay)
        # Eq. 9 has no Σ: with this log-variance stage 2 effectively draws μ.
        start = config.latents.initial_log_variance if config.latents.variational else LOG_VARIANCE_RANGE[0]
        self.log_variance = RowAdam(torch.full_like(self.mean.table, start), weight_decay=config.optimizer.weight_decay)

    def _parameter_groups(self) -> list[dict[str, Any]]:
        """θ in two groups: attention (CCA, transformer decoder) diverges at learning rates that suit an MLP."""
        attention = [] if self.network.attention is None else list(self.network.attention.parameters())
        if self.config.decoder.kind == "transformer":
            attention += self.network.layers.parameters()
        ours = {id(parameter) for parameter in attention}
        decoder = [parameter for parameter in self.network.parameters() if id(parameter) not in ours]
        rate = self.config.schedule.learning_rate
        groups: list[dict[str, Any]] = [{"params": decoder, "lr": rate, "base_lr": rate}]
        if attention:
            rate = self.config.optimizer.attention_learning_rate
            groups.append({"params": attention, "lr": rate, "base_lr": rate})
        return groups

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, torch.Tensor]:
        """One step on θ and on the latents of the batch."""
        config = self.config
        visits = shuffled_batches(len(self.visits), config.schedule.batch_size, step, self.seed)
        windows = torch.from_numpy(self.visits[visits])
        mine = self.own.mine(windows)
        batch = self._draw(step, windows, mine, generator)
        distinct, which = torch.unique(windows[mine], return_inverse=True)
        rows = self.own.place(distinct).to(self.device)
        mean = self.mean.table[rows].requires_grad_()
        log_variance = self.log_variance.table[rows].requires_grad_()
        latents = mean[which]
        if config.latents.variational:
            noise = torch.randn(len(windows), latents.shape[1], generator=generator)[mine].to(self.device)
            latents = sample_posterior(latents, log_variance[which], noise)
        with autocast(config.precision, self.device):
            predicted = self.network(latents, batch.coordinates, batch.fps)
        # This rank's share of means over the whole batch.
        squares = (predicted.float() - self.scaling.apply(batch.vectors)).square()
        reconstruction = squares.sum() / (len(windows) * squares.shape[1:].numel())
        kl = kl_divergence(mean, log_variance, len(torch.unique(windows)))
        loss = reconstruction + config.loss.kl_weight * kl if config.latents.variational else reconstruction
        self.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        self._update(step, rows, mean, log_variance)
        return {"loss": loss, "reconstruction": reconstruction, "kl": kl}

    def _draw(
        self,
        step: int,
        windows: Int64[torch.Tensor, "batch"],
        mine: Int64[torch.Tensor, "mine"],
        generator: torch.Generator,
    ) -> PoseTensors:
        """The clips of a step: at one fixed framerate during warm-up, then at all native ones (or at `fixed_fps`)."""
        clips = self.config.clips
        warming_up = step < clips.warmup_fraction * self.steps and clips.fixed_fps is None
        batch = self.poses.draw(
            windows.numpy(),
            clips.num_poses,
            uniform_of(generator),
            contiguous=clips.contiguous,
            fps=Fraction(clips.warmup_fps) if warming_up else None,
            lowest_fps=clips.lowest_fps,
            rows=mine.numpy(),
        )
        return PoseTensors.of(batch).to(self.device)

    def _update(
        self, step: int, rows: Int64[torch.Tensor, "rows"], mean: torch.Tensor, log_variance: torch.Tensor
    ) -> None:
        config = self.config
        factor = config.schedule.factor(step, self.steps)
        scale_rates(self.optimizer, factor)
        self.ranks.add_up_gradients(self.network.parameters())
        self.optimizer.step()
        assert mean.grad is not None
        self.mean.update(rows, mean.grad, config.optimizer.latent_learning_rate * factor)
        if log_variance.grad is not None:
            self.log_variance.update(rows, log_variance.grad, config.optimizer.latent_learning_rate * factor)
            self.log_variance.table[rows] = self.log_variance.table[rows].clamp(*LOG_VARIANCE_RANGE)

    def state_tensors(self) -> dict[str, torch.Tensor]:
        """The complete training state; the latents of all ranks are gathered on the first."""
        latents = {name: self.own.gather(table) for name, table in self._tables().items()}
        return training_tensors("network", self.network, self.optimizer) | latents

    def posteriors(self) -> tuple[Float32[torch.Tensor, "windows latent"], Float32[torch.Tensor, "windows latent"]]:
        """{μ_i} and {log Σ_i} of all windows, on the CPU of the first rank."""
        return self.own.gather(self.mean.table), self.own.gather(self.log_variance.table)

    def load_state_tensors(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Restore what `state_tensors` returned."""
        load_training_tensors("network", self.network, self.optimizer, tensors)
        for name, table in self._tables().items():
            table.copy_(tensors[name][self.own.rows])

    def _tables(self) -> dict[str, torch.Tensor]:
        return prefixed("mean", self.mean.tensors()) | prefixed("log_variance", self.log_variance.tensors())


def training_windows(source: PositionSource, config: FieldConfig) -> Windows:
    """The training windows; with `fixed_fps` slower ones are dropped, as fixed-framerate models do.

    Raises `UsageError` if none remain.
    """
    windows = cut_windows(
        source,
        max_duration_seconds=config.windows.max_duration_seconds,
        stride_seconds=config.windows.stride_seconds,
        min_duration_seconds=config.windows.min_duration_seconds,
        mirror_pairs=SMPL22.left_right_pairs if config.windows.mirrored else None,
    )
    fixed = config.clips.fixed_framerate
    if fixed is None:
        return windows
    fast = windows.fps >= float(fixed) - 1e-6
    if not fast.any():
        raise UsageError(
            f"no training sequence has {float(fixed):g} fps (field.clips.fixed_fps); the fastest has "
            f"{windows.fps.max():g}"
        )
    return windows.select(fast)


def remarks(source: PositionSource, windows: Windows, config: FieldConfig) -> list[str]:
    """Warnings about training on these windows, a sentence each."""
    found, clips = [], config.clips
    fps = source.fps_numerator / source.fps_denominator
    if clips.fixed_framerate is not None:
        slow = int((fps < float(clips.fixed_framerate) - 1e-6).sum())
        if slow:
            found.append(f"{slow} of {len(fps)} sequences are slower than field.clips.fixed_fps and are left out")
    elif len(np.unique(windows.fps)) == 1:
        found.append(f"every training sequence has {windows.fps[0]:g} fps: the field cannot learn other framerates")
    if clips.fixed_framerate is None:
        found += _rate_remarks(windows, config)
    short = windows.duration_seconds * _slowest_rate(windows, config) + 1 < clips.num_poses - 1e-6
    if clips.contiguous and short.any():
        found.append(
            f"{int(short.sum())} of {len(windows)} windows are shorter than a clip of field.clips.num_poses="
            f"{clips.num_poses} poses; their last pose is repeated"
        )
    return found


def _rate_remarks(windows: Windows, config: FieldConfig) -> list[str]:
    """Warnings about framerates in the settings that the windows do not have."""
    found, clips = [], config.clips
    slower = int((windows.fps < clips.warmup_fps - 1e-6).sum())
    if clips.warmup_fraction > 0 and slower:
        found.append(
            f"{slower} of {len(windows)} windows are slower than field.clips.warmup_fps={clips.warmup_fps}: during "
            "the warm-up their poses are interpolated between their own"
        )
    if clips.lowest_fps is not None and clips.lowest_fps > windows.fps.max() + 1e-6:
        found.append(
            f"field.clips.lowest_fps={clips.lowest_fps:g} has no effect: the fastest training sequence has "
            f"{windows.fps.max():g} fps, and each is drawn at its own"
        )
    return found


def _slowest_rate(windows: Windows, config: FieldConfig) -> Float64[np.ndarray, "windows"]:
    """The lowest framerate at which clips of each window are drawn."""
    clips = config.clips
    if clips.fixed_framerate is not None:
        return np.full(len(windows), float(clips.fixed_framerate))
    slowest = clips.warmup_fps if clips.warmup_fraction > 0 else np.inf
    return np.asarray(np.minimum(windows.fps, slowest))
