"""Small fields of analytic motions, whose poses are known at every instant."""

from fractions import Fraction

import numpy as np
import torch

from motionkit.data.windows import FrameValues, WindowPoses, cut_windows
from motionkit.features import field as field_vectors
from motionkit.features.field import FIELD_VECTORS
from motionkit.training.config import ConfigT, apply_overrides
from motionkit.training.loop import step_generator
from nerm.field_training import FieldTraining
from nerm.model import TrainedField
from nerm.recipes import FieldConfig
from tests.helpers.nerm_corpus import analytic_positions, analytic_source


def changed(config: ConfigT, settings: str) -> ConfigT:
    """The configuration with settings as `--set` takes them, between spaces."""
    return apply_overrides(config, settings.split())


SMALL = changed(
    FieldConfig(),
    "windows.max_duration_seconds=4.0 latents.layout=local latents.initial_log_variance=-9.0 "
    "encoder.framerate_scale=0.05 latents.knots=16 latents.knot_numbers=8 latents.path_knots=16 "
    "encoder.kind=fourier encoder.num_frequencies=8 decoder.width=64 decoder.num_layers=4 "
    "decoder.activation=silu loss.scaling=group loss.root_weight=8.0 schedule.epochs=none schedule.steps=300 "
    "schedule.batch_size=4 clips.num_poses=32 clips.contiguous=false clips.warmup_fraction=0.1 "
    "clips.lowest_fps=20.0 schedule.learning_rate=0.005 optimizer.latent_learning_rate=0.02 "
    "schedule.kind=cosine optimizer.weight_decay=0.0",
)


def small_poses(config: FieldConfig = SMALL) -> WindowPoses:
    source = analytic_source()
    windows = cut_windows(source, max_duration_seconds=config.windows.max_duration_seconds)
    return WindowPoses(windows, FrameValues(source.positions, FIELD_VECTORS))


def small_training(config: FieldConfig = SMALL) -> FieldTraining:
    return FieldTraining(small_poses(config), config, codebook=None, seed=3, device=torch.device("cpu"))


def losses_of(training: FieldTraining, steps: int) -> list[float]:
    return [float(training.step(step, step_generator(3, "field", step))["loss"].detach()) for step in range(steps)]


BANKED = changed(
    SMALL,
    "latents.knots=16,8 latents.knot_numbers=6,4 latents.path_knots=8 optimizer.latent_learning_rate=0.01",
)


def finished(training: FieldTraining) -> TrainedField:
    mean, log_variance = training.posteriors()
    return TrainedField(
        network=training.network.eval().requires_grad_(False),
        scaling=training.scaling,
        linear_model=training.linear_model,
        posterior_mean=mean,
        posterior_log_variance=log_variance,
        windows=training.poses.windows,
        store_fingerprint="analytic",
    )


def error_mm(trained: TrainedField, latents: torch.Tensor, window: int, fps: int) -> float:
    times = np.arange(4 * fps + 1) / fps
    truth = analytic_positions(times, window)[None]
    row = slice(window, window + 1)
    vectors = field_vectors.encode(truth, trained.windows.yaw[row], trained.windows.origin[row])
    expected = field_vectors.decode(vectors)[0]
    found = trained.poses(latents, times, Fraction(fps)).joint_positions
    return float(np.linalg.norm(found - expected, axis=-1).mean() * 1000)
