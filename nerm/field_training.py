"""Stage `field`: training f_θ with one N(μ, Σ) per window, without an encoder (paper §3.1, Eq. 1, 3 and 4; B.2).

Only the rows of a batch are gathered and updated, with their Adam moments, so a step's cost does not depend on the
number of windows.
"""

import dataclasses
import time
from collections.abc import Iterator, Mapping
from fractions import Fraction
from typing import Any

import numpy as np
import torch
from torch import Tensor

from motionkit.core.errors import UsageError
from motionkit.core.progress import warn
from motionkit.core.shapes import Float, Float32, Float64, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.data.windows import (
    FrameValues,
    WindowPoses,
    Windows,
    chunks,
    cut_windows,
    open_frames,
    rows_by_duration,
    shuffled_batches,
    training_vectors,
)
from motionkit.features.convention import PoseVectors
from motionkit.store.cache import PositionCache
from motionkit.store.reader import Store
from motionkit.training.loop import Learner, load_tensors, prefixed, run_training, seeded_initialisation, step_generator
from motionkit.training.networks import (
    ALONE,
    DealtRows,
    Ranks,
    autocast,
    kl_divergence,
    measure_scaling,
    resolve_device,
    with_precision_of,
)
from motionkit.training.run import RunError, RunFolder, StageContext
from nerm.latents import linear_model
from nerm.model import TrainedField, save_field
from nerm.network import FieldNetwork
from nerm.recipes import FieldConfig, NermConfig

LOG_VARIANCE_RANGE = (-12.0, 4.0)
WARMUP_FPS = Fraction(20)
BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-8
TIMES_PER_WINDOW, WINDOWS_AT_ONCE = 128, 256


class RowAdam:
    """Sparse AdamW (Loshchilov & Hutter 2019) over rows of a table; each row counts its own steps.

    A row updated n times has had exactly n steps of dense AdamW; other rows are unchanged, without weight decay.
    """

    def __init__(self, table: Float32[Tensor, "rows width"], weight_decay: float = 0.0) -> None:
        self.table, self.weight_decay = table, weight_decay
        self.first = torch.zeros_like(table)
        self.second = torch.zeros_like(table)
        self.count = torch.zeros(len(table), 1, device=table.device)

    @torch.no_grad()
    def update(self, rows: Int64[Tensor, "chosen"], gradient: Float32[Tensor, "chosen width"], rate: float) -> None:
        """One step on distinct rows."""
        count = self.count[rows] + 1.0
        first = torch.lerp(self.first[rows], gradient, 1.0 - BETA1)
        second = torch.lerp(self.second[rows], gradient.square(), 1.0 - BETA2)
        step = rate * (first / (1.0 - BETA1**count)) / ((second / (1.0 - BETA2**count)).sqrt() + EPSILON)
        self.table[rows] = (1.0 - rate * self.weight_decay) * self.table[rows] - step
        self.first[rows], self.second[rows], self.count[rows] = first, second, count

    def tensors(self) -> dict[str, Tensor]:
        """Table and moments."""
        return {"table": self.table, "first": self.first, "second": self.second, "count": self.count}


class FieldTraining:
    """A `motionkit.training.loop.Trainable`: θ, {μ_i} and {log Σ_i} with their optimisers.

    Each rank owns the latents of its windows, a contiguous part of the corpus, and steps on its share of a batch; only
    the gradient of θ is reduced between ranks. A row of `latents` is μ_i, then log Σ_i.
    """

    def __init__(
        self,
        poses: WindowPoses,
        config: FieldConfig,
        *,
        codebook: Float[Tensor, "codes dimension"] | None,
        seed: int,
        device: torch.device,
        ranks: Ranks = ALONE,
    ) -> None:
        self.poses, self.config, self.seed, self.device = poses, config, seed, device
        scaling = measure_scaling(
            poses,
            grouped=config.loss.scaling == "group",
            root_weight=config.loss.root_weight,
            centred_path=config.latents.layout == "local",
        )
        self.scaling = scaling.to(device)
        in_corpus = np.argsort(poses.windows.start_row, kind="stable")
        self.own = DealtRows(ranks, poses.windows.duration_seconds, in_corpus)
        with seeded_initialisation(seed, "field"):
            self.network = FieldNetwork(config, len(scaling.mean), codebook).to(device)
        # μ begins as N(0, 1), or as the linear model's fit.
        self.linear_model = None
        if self.network.local is None:
            generator = step_generator(seed, "latents")
            means = torch.randn(len(poses.windows), config.latents.dimension, generator=generator)[self.own.rows]
        else:
            self.linear_model = linear_model(_evenly(poses, np.arange(len(poses.windows))), scaling, self.network.local)
            means = torch.cat([self.linear_model.fit(*each) for each in _evenly(poses, self.own.rows.numpy())])
            self.network.start_as_linear_model(self.linear_model.mean, self.linear_model.inverse())
        # Eq. 9 has no Σ: with this log-variance stage 2 effectively draws μ.
        start = config.latents.initial_log_variance if config.latents.variational else LOG_VARIANCE_RANGE[0]
        self.visits = rows_by_duration(poses.windows, config.clips.seconds_per_visit)
        self.steps = config.schedule.num_steps(len(self.visits))
        decay = config.optimizer.weight_decay
        self.learner = Learner(
            self.network, torch.optim.AdamW(self._parameter_groups(), weight_decay=decay), ranks=ranks
        )
        self.latents = RowAdam(torch.cat((means, torch.full_like(means, start)), dim=1).to(device), weight_decay=decay)

    def _parameter_groups(self) -> list[dict[str, Any]]:
        """θ in two groups: attention (CCA, transformer decoder) diverges at learning rates that suit an MLP."""
        attention = [] if self.network.attention is None else list(self.network.attention.parameters())
        if self.config.decoder.kind == "transformer":
            attention += self.network.layers.parameters()
        ours = {id(parameter) for parameter in attention}
        decoder = [parameter for parameter in self.network.parameters() if id(parameter) not in ours]
        relative = self.config.optimizer.attention_learning_rate / self.config.schedule.learning_rate
        return [{"params": decoder}, {"params": attention, "relative_rate": relative}]

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, Tensor]:
        """One step on θ and on the latents of the batch."""
        config = self.config
        visits = shuffled_batches(len(self.visits), config.schedule.batch_size, step, self.seed)
        windows = torch.from_numpy(self.visits[visits])
        mine = self.own.mine(windows)
        clips = config.clips
        # Poses at one framerate during warm-up, then at all native ones (or at `fixed_fps`).
        warming_up = step < clips.warmup_fraction * self.steps and clips.fixed_fps is None
        batch = self.poses.draw(
            windows.numpy(),
            clips.num_poses,
            lambda *shape: torch.rand(*shape, generator=generator, dtype=torch.float64).numpy(),
            contiguous=clips.contiguous,
            fps=WARMUP_FPS if warming_up else None,
            lowest_fps=clips.lowest_fps,
            rows=mine.numpy(),
        )
        coordinates, fps, vectors = (
            torch.from_numpy(each).to(self.device) for each in (batch.coordinates, batch.fps, batch.vectors)
        )
        distinct, which = torch.unique(windows[mine], return_inverse=True)
        rows = self.own.place(distinct).to(self.device)
        posterior = self.latents.table[rows].requires_grad_()
        mean, log_variance = posterior.chunk(2, dim=1)
        latents = mean[which]
        if config.latents.variational:
            noise = torch.randn(len(windows), latents.shape[1], generator=generator)[mine].to(self.device)
            latents = latents + torch.exp(0.5 * log_variance[which]) * noise  # Eq. 1
        with autocast(config.precision, self.device):
            predicted = self.network(latents, coordinates, fps)
        # This rank's share of means over the whole batch.
        squares = (predicted.float() - self.scaling.apply(vectors)).square()
        reconstruction = squares.sum() / (len(windows) * squares.shape[1:].numel())
        kl = kl_divergence(mean, log_variance).sum() / (mean.shape[1] * len(torch.unique(windows)))  # Eq. 3
        loss = reconstruction + config.loss.kl_weight * kl if config.latents.variational else reconstruction
        factor = config.schedule.factor(step, self.steps)
        self.learner.descend(loss, step, config.schedule.learning_rate * factor)
        assert posterior.grad is not None
        self.latents.update(rows, posterior.grad, config.optimizer.latent_learning_rate * factor)
        self.latents.table[rows, mean.shape[1] :] = self.latents.table[rows, mean.shape[1] :].clamp(*LOG_VARIANCE_RANGE)
        return {"loss": loss, "reconstruction": reconstruction, "kl": kl}

    def posteriors(self) -> tuple[Float32[Tensor, "windows latent"], Float32[Tensor, "windows latent"]]:
        """{μ_i} and {log Σ_i} of all windows, on the CPU of the first rank."""
        mean, log_variance = self.own.gather(self.latents.table).chunk(2, dim=1)
        return mean.contiguous(), log_variance.contiguous()

    def state_tensors(self) -> dict[str, Tensor]:
        """The complete training state; the latents of all ranks are gathered on the first."""
        latents = {name: self.own.gather(table) for name, table in self.latents.tensors().items()}
        return self.learner.state_tensors() | prefixed("latents", latents)

    def load_state_tensors(self, tensors: Mapping[str, Tensor]) -> None:
        """Restore what `state_tensors` returned."""
        self.learner.load_state_tensors(tensors)
        for name, table in self.latents.tensors().items():
            table.copy_(tensors[f"latents.{name}"][self.own.rows])


def _evenly(
    poses: WindowPoses, windows: Int64[np.ndarray, "chosen"]
) -> Iterator[tuple[Float64[Tensor, "some times"], Float32[Tensor, "some times numbers"]]]:
    """Coordinates and vectors of poses spread evenly over each of these windows."""
    for rows in chunks(len(windows), WINDOWS_AT_ONCE):
        batch = poses.evenly(windows[rows], TIMES_PER_WINDOW)
        yield torch.from_numpy(batch.coordinates), torch.from_numpy(batch.vectors)


def training_windows(source: PositionCache, config: FieldConfig) -> Windows:
    """The training windows; with `fixed_fps` slower ones are dropped, as fixed-framerate models do.

    Raises `UsageError` if none remain.
    """
    windows = cut_windows(
        source,
        max_duration_seconds=config.windows.max_duration_seconds,
        stride_seconds=config.windows.stride_seconds,
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


def train_field(context: StageContext, config: NermConfig) -> None:
    """Train f_θ and the posteriors of all windows; write both, with the window table, to model.safetensors."""
    store, device, ranks = context.open_store(), resolve_device(context.device), context.ranks
    settings = with_precision_of(config.field, device)
    config = dataclasses.replace(config, field=settings)
    started = time.perf_counter()
    # All checks come before `begin`, which may remove an earlier run (--overwrite).
    vectors, source, frames = _corpus(store, settings)
    windows = training_windows(source, settings)
    codes = _codes(context.run) if settings.encoder.kind == "codebook" else None
    builds_on = () if codes is None else ("codebook",)
    folder = context.begin("field", config, store_fingerprint=store.fingerprint, builds_on=builds_on)
    if ranks.is_first and settings.clips.fixed_fps is None and len(np.unique(windows.fps)) == 1:
        warn(f"every training sequence has {windows.fps[0]:g} fps: the field cannot learn other framerates")
    poses = WindowPoses(windows, frames, settings.clips.fixed_framerate)
    training = FieldTraining(poses, settings, codebook=codes, seed=context.seed, device=device, ranks=ranks)
    figures = run_training(context, training, folder)
    mean, log_variance = training.posteriors()
    if not ranks.is_first:
        return
    trained = TrainedField(
        network=training.network.eval().requires_grad_(False),
        scaling=training.scaling,
        linear_model=training.linear_model,
        posterior_mean=mean,
        posterior_log_variance=log_variance,
        windows=windows,
        store_fingerprint=store.fingerprint,
        vectors=vectors,
    )
    save_field(folder, trained)
    facts = {
        "windows": len(windows),
        "hours": round(float(windows.duration_seconds.sum()) / 3600, 3),
        "wall_seconds": round(time.perf_counter() - started, 1),
        "parameters": sum(parameter.numel() for parameter in training.network.parameters()),
    }
    folder.finish({**figures, **facts})


def check_field(context: StageContext, config: NermConfig) -> None:
    """Raise early what would stop this stage: no sequence to cut windows from."""
    _, source, _ = _corpus(context.open_store(), config.field)
    training_windows(source, config.field)


def _corpus(store: Store, settings: FieldConfig) -> tuple[PoseVectors, PositionCache, FrameValues]:
    where = settings.where or None
    vectors = training_vectors(settings.pose_vectors, store, where)
    return vectors, *open_frames(vectors, store, where)


def _codes(run: RunFolder) -> Float32[Tensor, "codes dimension"]:
    folder = run.stage("codebook")
    if not folder.is_complete:
        raise RunError(
            f"the time encoding 'codebook' needs the stage codebook of {run.path}: train it first (motionkit train "
            "--stage codebook), or use --set field.encoder.kind=fourier"
        )
    return load_tensors(folder.model_path)[0]["codes"]
