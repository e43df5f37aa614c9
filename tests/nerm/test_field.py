"""Training a motion field, and what it decodes after training, saving and loading."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.distributions import Normal

from eval.tables.nerm.reconstruction import window_truth
from motionkit.core.skeleton import SMPL22
from motionkit.data.windows import open_frames
from motionkit.fields.motion_field import to_motion
from motionkit.store.reader import Store
from motionkit.store.writer import StoreWriter
from motionkit.training.config import apply_overrides
from motionkit.training.networks import kl_divergence
from motionkit.training.run import RunFolder, StageContext, StageFolder
from nerm.encoding import NermEncoder
from nerm.field_training import RowAdam, train_field
from nerm.model import LatentMotionField, TrainedField, load_field, save_field
from nerm.recipes import nano
from tests.helpers.analytic import analytic_motion
from tests.helpers.nerm_corpus import FPS
from tests.nerm.small_fields import SMALL, error_mm, finished, losses_of, small_training


@pytest.mark.parametrize("fps", [20, 40, 60, 100, 120])
def test_a_small_field_learns_analytic_motions_to_millimetres_at_every_framerate(
    small_field: TrainedField, fps: int
) -> None:
    errors = [error_mm(small_field, small_field.posterior_mean[window], window, fps) for window in range(4)]
    assert max(errors) < 5.0, errors


def test_what_is_loaded_decodes_as_what_was_saved(small_field: TrainedField, tmp_path: Path) -> None:
    save_field(StageFolder(tmp_path / "field"), small_field)
    loaded = load_field(tmp_path)
    times = np.linspace(0.0, 4.0, 17)
    for latent in loaded.posterior_mean:
        found, expected = (each.poses(latent, times, FPS[2]) for each in (loaded, small_field))
        np.testing.assert_array_equal(found.joint_positions, expected.joint_positions)
    assert loaded.config == small_field.config and loaded.max_training_fps == 120


def test_a_latent_is_a_motion_field(small_field: TrainedField) -> None:
    motion = small_field.as_motion_field(small_field.posterior_mean[1], 2.5)
    assert (motion.start_seconds, motion.end_seconds, motion.skeleton) == (0.0, 2.5, SMPL22)
    times = np.array([2.5, 0.0, 1.0])
    expected = small_field.poses(small_field.posterior_mean[1], times, FPS[4]).joint_positions
    np.testing.assert_array_equal(motion.query(times).joint_positions, expected)
    with pytest.raises(ValueError, match="1 of 1 times lie outside"):
        motion.query(np.array([2.6]))


def test_a_transformer_decoders_motion_is_a_function_of_time(monkeypatch: pytest.MonkeyPatch) -> None:
    training = small_training(
        apply_overrides(SMALL, ["decoder.kind=transformer", "optimizer.attention_learning_rate=0.001"])
    )
    losses_of(training, 3)
    field = finished(training)
    motion = field.as_motion_field(field.posterior_mean[1], 3.0)
    times = np.arange(181) / 60
    fast = motion.query(times).joint_positions
    # Other framerates, single instants and smaller portions are the same motion; decoded bare they were not.
    np.testing.assert_allclose(motion.query(times[::2]).joint_positions, fast[::2], atol=2e-5)
    for row in (0, 17, 180):
        np.testing.assert_allclose(motion.query(times[row : row + 1]).joint_positions[0], fast[row], atol=2e-5)
    monkeypatch.setattr("nerm.model.POSES_IN_CONTEXT_AT_ONCE", 50)
    np.testing.assert_allclose(motion.query(times).joint_positions, fast, atol=2e-5)
    alone = field.poses(field.posterior_mean[1], times[17:18], motion.fps).joint_positions[0]
    assert np.abs(alone - fast[17]).max() > 1e-3


@pytest.mark.parametrize("weight_decay", [0.0, 0.5])
def test_rows_that_are_touched_follow_dense_adamw_and_others_stay(weight_decay: float) -> None:
    generator = torch.Generator().manual_seed(0)
    table = torch.randn(10, 4, generator=generator)
    touched = torch.tensor([1, 4, 7])
    dense = table[touched].clone().requires_grad_()
    reference = torch.optim.AdamW([dense], lr=0.03, weight_decay=weight_decay)
    sparse = RowAdam(table.clone(), weight_decay=weight_decay)
    for _ in range(25):
        gradient = torch.randn(3, 4, generator=generator)
        dense.grad = gradient.clone()
        reference.step()
        sparse.update(touched, gradient, 0.03)
    torch.testing.assert_close(sparse.table[touched], dense.detach(), atol=1e-6, rtol=1e-5)
    others = torch.tensor([0, 2, 3, 5, 6, 8, 9])
    assert torch.equal(sparse.table[others], table[others])
    assert sparse.count.squeeze(1).tolist() == [25.0 if row in (1, 4, 7) else 0.0 for row in range(10)]


def test_kl_is_that_of_normal_distributions() -> None:
    mean, log_variance = torch.randn(5, 7), torch.randn(5, 7)
    expected = torch.distributions.kl_divergence(Normal(mean, torch.exp(0.5 * log_variance)), Normal(0.0, 1.0)).mean()
    torch.testing.assert_close(kl_divergence(mean, log_variance).mean(), expected)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """One body with rotations at three framerates."""
    path = tmp_path_factory.mktemp("vectors") / "store"
    with StoreWriter.create(path) as writer:
        for index, rate in enumerate((60, 30, 120)):
            motion = to_motion(analytic_motion("walk", 4.0), Fraction(rate))
            writer.add(replace(motion, sequence_id=f"m{index}", split="train"))
    return Store.open(path)


TINY = (
    "field.encoder.kind=fourier field.windows.max_duration_seconds=4 field.windows.stride_seconds=4 "
    "field.decoder.width=48 field.decoder.num_layers=3 field.schedule.steps=120 "
    "field.schedule.batch_size=4 field.clips.num_poses=16 field.precision=float32 field.windows.mirrored=true"
)


@pytest.mark.parametrize("name", ["field", "native", "rotations"])
def test_a_field_of_each_convention_trains_saves_and_decodes(store: Store, name: str, tmp_path: Path) -> None:
    layout = () if name == "field" else ("field.latents.layout=global", "field.optimizer.latent_learning_rate=0.1")
    config = apply_overrides(nano(), [*TINY.split(), *layout, f"field.pose_vectors={name}"])
    train_field(StageContext(store.path, RunFolder(tmp_path / "run"), "nano", device="cpu"), config)
    trained = load_field(tmp_path / "run")
    cache, _ = open_frames(trained.vectors, store, None)
    windows = trained.windows
    times = np.linspace(0.0, 3.5, 36)
    truth = window_truth(cache, windows, 0, Fraction(60))[np.round(times * 60).astype(int)]
    standing = np.linalg.norm(truth - truth.mean(axis=0), axis=-1).mean()
    found = trained.poses(trained.posterior_mean[0], times, Fraction(60)).joint_positions[:, :22]
    # Not a good field, after seconds; but far better than a body that stands still.
    assert np.linalg.norm(found - truth, axis=-1).mean() < 0.6 * standing
    motion_field = trained.as_motion_field(trained.posterior_mean[0], 3.5)
    assert motion_field.skeleton == trained.skeleton
    poses = motion_field.at_fps(Fraction(60)).query(times[[20, 3]])
    assert (poses.local_rotations is not None) == (name == "rotations")
    np.testing.assert_allclose(poses.joint_positions[:, :22], found[[20, 3]], atol=2e-3)
    (encoded,) = NermEncoder(trained).other_windows(store, None).fields(np.array([0]))
    assert isinstance(encoded, LatentMotionField)
    again = trained.poses(encoded.latent, times, Fraction(60)).joint_positions[:, :22]
    assert np.linalg.norm(again - truth, axis=-1).mean() < 0.6 * standing
