"""The training of any temporal network, and its file: one loss and one corpus for all (Eq. 8 to 10)."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from motionkit.core.shapes import Float32
from motionkit.core.skeleton import Feet, Skeleton
from motionkit.data.rotation_sequences import open_rotation_sequences
from motionkit.training.config import from_plain, to_plain
from motionkit.training.devices import autocast, resolve_device
from motionkit.training.loop import (
    CheckpointError,
    Learner,
    dropout_from,
    load_tensors,
    prefixed,
    rebuilding,
    save_tensors,
    seeded_initialisation,
    unprefixed,
)
from motionkit.training.pose_vectors import VectorScaling
from motionkit.training.run import RunFolder, StageContext
from pahires.temporal.base_curves import interpolated
from pahires.temporal.prediction import Predictor
from pahires.temporal.settings import Distance, TemporalConfig, TemporalSettings
from pahires.temporal.windows import TrainingBatch, WindowSampler

_Rows = Float32[torch.Tensor, "batch queries numbers"]
FORMAT, FORMAT_VERSION = "temporal-network", 2


class TemporalTraining:
    """A `motionkit.training.loop.Trainable`: a network with its optimiser."""

    def __init__(
        self,
        network: torch.nn.Module,
        sampler: WindowSampler,
        *,
        seed: int,
        device: torch.device,
    ) -> None:
        self.sampler, self.settings, self.device = sampler, sampler.settings, device
        self.network = network.to(device)
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0x5CA1E,)))
        self.scaling = sampler.measure(rng)
        settings = self.settings
        # Networks expect standardised rows; see `base_curves`.
        self.predictor = Predictor(network, self.scaling.to(device), settings.answer)
        optimizer = torch.optim.Adam(network.parameters(), lr=settings.schedule.learning_rate)
        self.learner = Learner(network, optimizer, settings.ema_decay)
        self.state_tensors, self.load_state_tensors = self.learner.state_tensors, self.learner.load_state_tensors
        seconds = float(sampler.takes.num_frames.sum()) / float(settings.framerate)
        self.steps = settings.schedule.num_steps(seconds)

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, torch.Tensor]:
        """One step on a batch of one task."""
        settings = self.settings
        rng = np.random.default_rng(int(torch.randint(2**62, (), generator=generator)))
        batch = self.sampler.batch(rng, self.scaling)
        with dropout_from(generator, self.device), autocast(settings.precision, self.device):
            predicted = self.predictor(batch.window.to(self.device))
        targets = batch.targets.to(self.device)
        loss = (self._weights(batch).to(self.device) * self._loss(predicted, targets)).mean()
        rate = settings.schedule.factor(step, self.steps) * settings.schedule.learning_rate
        self.learner.descend(loss, step, rate)
        mse, velocity = losses(predicted.detach(), targets, "squared")
        return {"loss": loss, "mse": mse.mean(), "velocity": velocity.mean()}

    def _weights(self, batch: TrainingBatch) -> Float32[torch.Tensor, "batch"]:
        """Weights of windows: 1, or if `balanced` the inverse of the interpolation's error."""
        if not self.settings.loss.balanced:
            return torch.ones(len(batch.targets))
        curve = interpolated(batch.window, self.settings.answer.base, self.scaling)
        missed = self._loss(curve, batch.targets)
        return 1.0 / (missed + self.settings.loss.balance_floor * missed.mean() + 1e-9)

    def _loss(self, predicted: _Rows, targets: _Rows) -> Float32[torch.Tensor, "batch"]:
        rows, differences = losses(predicted, targets, self.settings.loss.distance)
        return rows + self.settings.loss.velocity_weight * differences


def losses(
    predicted: _Rows, targets: _Rows, distance: Distance
) -> tuple[Float32[torch.Tensor, "batch"], Float32[torch.Tensor, "batch"]]:
    """Mean errors of each window's rows (Eq. 8) and of their differences from frame to frame (Eq. 9)."""
    error = predicted - targets
    measure = torch.square if distance == "squared" else torch.abs
    return measure(error).mean(dim=(1, 2)), measure(error.diff(dim=1)).mean(dim=(1, 2))


@dataclass(frozen=True, eq=False)
class TrainedNetwork:
    """A trained network with everything needed for inference: scaling, form of the output, the skeleton's joints."""

    name: str
    predictor: Predictor
    settings: TemporalSettings
    skeleton: Skeleton
    store_fingerprint: str

    @property
    def spacing_seconds(self) -> float:
        """Spacing of the queried frames in training, in seconds: the networks' target spacing."""
        return 1.0 / float(self.settings.framerate)

    @property
    def reach_seconds(self) -> float:
        """The longest extrapolation in training; 0 without extrapolation."""
        tasks = self.settings.tasks
        return tasks.longest_reach * self.spacing_seconds if tasks.extend > 0 else 0.0

    @property
    def longest_gap_seconds(self) -> float:
        """The longest time between neighbouring observed frames in training."""
        tasks = self.settings.tasks
        longest = max(np.ceil(tasks.largest_factor), tasks.longest_gap + 1 if tasks.gap > 0 else 0)
        return float(longest) * self.spacing_seconds


# (configuration, numbers per row) → network, initialised by torch's global generator.
NetworkMaker = Callable[[Any, int], torch.nn.Module]


def train_network(context: StageContext, stage: str, config: TemporalConfig, make: NetworkMaker) -> None:
    """Train the network built by `make` on the context's store; write RUN/STAGE/model.safetensors for `load_network`.

    Raises what `open_rotation_sequences` and `train_loop` raise.
    """
    started, settings = time.perf_counter(), config.training
    store, device = context.open_store(), resolve_device(context.device)
    takes = open_rotation_sequences(store, settings.framerate, where=settings.where or None, layout=settings.layout)
    folder = context.begin(stage, config, store_fingerprint=store.fingerprint)
    with seeded_initialisation(context.seed, stage):
        network = make(config, takes.num_features)
    training = TemporalTraining(network, WindowSampler(takes, settings), seed=context.seed, device=device)
    figures = context.train(training, folder, settings.precision)
    tensors = prefixed("network", training.learner.trained_tensors()) | prefixed(
        "scaling", {"mean": training.scaling.mean, "scale": training.scaling.scale}
    )
    description = {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        "stage": stage,
        "config": to_plain(config),
        "skeleton": _described(takes.skeleton),
        "store_fingerprint": store.fingerprint,
    }
    save_tensors(
        folder.model_path, tensors | {"skeleton.offsets": torch.from_numpy(takes.skeleton.offsets)}, description
    )
    hours = float(takes.num_frames.sum()) / float(settings.framerate) / 3600
    facts = {"takes": len(takes.num_frames), "takes_skipped": takes.skipped, "hours": round(hours, 3)}
    folder.finish({**figures, **facts, "wall_seconds": round(time.perf_counter() - started, 1)})


def load_network(
    run: RunFolder | Path,
    stage: str,
    config_type: type[TemporalConfig],
    make: NetworkMaker,
    *,
    name: str | None = None,
    device: str = "cpu",
) -> TrainedNetwork:
    """Load a stage's trained network; raises `RunError` or `CheckpointError` if there is none of this kind."""
    folder = (run if isinstance(run, RunFolder) else RunFolder(run)).stage(stage)
    if not folder.model_path.is_file():
        folder.read_summary()
    tensors, description = load_tensors(folder.model_path)
    again = f"train it again (motionkit train --stage {stage} --overwrite)"
    found = tuple(description.get(key) for key in ("format", "version", "stage"))
    if found != (FORMAT, FORMAT_VERSION, stage):
        raise CheckpointError(f"{folder.model_path} is {found}, expected {(FORMAT, FORMAT_VERSION, stage)}: {again}")
    where = resolve_device(device)
    with rebuilding(folder.model_path, stage, tensors):
        config = from_plain(config_type, description["config"])
        scaling = VectorScaling(tensors["scaling.mean"], tensors["scaling.scale"])
        network = make(config, len(scaling.mean))
        network.load_state_dict(unprefixed("network", tensors))
        skeleton = _restored(description["skeleton"], tensors["skeleton.offsets"].numpy())
    network = network.to(where).eval().requires_grad_(False)
    return TrainedNetwork(
        name=name or stage,
        predictor=Predictor(network, scaling.to(where), config.training.answer),
        settings=config.training,
        skeleton=skeleton,
        store_fingerprint=str(description["store_fingerprint"]),
    )


def _described(skeleton: Skeleton) -> dict[str, Any]:
    feet = skeleton.feet
    return {
        "name": skeleton.name,
        "joint_names": list(skeleton.joint_names),
        "parents": list(skeleton.parents),
        "left_right_pairs": [list(pair) for pair in skeleton.left_right_pairs],
        "feet": None if feet is None else [feet.left_ankle, feet.left_toe, feet.right_ankle, feet.right_toe],
    }


def _restored(described: dict[str, Any], offsets: np.ndarray) -> Skeleton:
    feet = described["feet"]
    return Skeleton(
        name=str(described["name"]),
        joint_names=tuple(map(str, described["joint_names"])),
        parents=tuple(map(int, described["parents"])),
        offsets=offsets,
        left_right_pairs=tuple((int(left), int(right)) for left, right in described["left_right_pairs"]),
        feet=None if feet is None else Feet(*map(int, feet)),
    )
