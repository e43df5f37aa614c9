"""A field of each convention of pose vectors: trained for seconds, saved, loaded, decoded."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from eval.reconstruction.windows import window_truth
from motionkit.data.corpus import open_frames
from motionkit.fields.motion_field import to_motion
from motionkit.store.reader import Store
from motionkit.store.writer import StoreWriter
from motionkit.training.config import apply_overrides
from motionkit.training.run import RunFolder
from motionkit.training.stage import StageContext
from nerm.field.motion_encoder import encode_windows
from nerm.field.trained import load_field
from nerm.recipes import nano
from nerm.stages.field import train_field
from tests.helpers.analytic import analytic_motion


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
    "field.encoder.kind=fourier",
    "field.windows.max_duration_seconds=4",
    "field.windows.stride_seconds=4",
    "field.decoder.width=48",
    "field.decoder.num_layers=3",
    "field.schedule.steps=120",
    "field.contacts.steps=10",
    "field.schedule.batch_size=4",
    "field.clips.num_poses=16",
    "field.precision=float32",
    "field.windows.mirrored=true",
    # A path of the body is one of positions.
    "field.latents.path_knots=0",
    "field.latents.dimension=720",
)


@pytest.mark.parametrize("name", ["field", "native", "rotations"])
def test_a_field_of_each_convention_trains_saves_and_decodes(store: Store, name: str, tmp_path: Path) -> None:
    config = apply_overrides(nano(), [*TINY, f"field.pose_vectors={name}"])
    train_field(StageContext(store.path, RunFolder(tmp_path / "run"), "nano", device="cpu"), config)
    trained = load_field(tmp_path / "run")
    cache, frames = open_frames(trained.vectors, store, None)
    windows = trained.windows
    times = np.linspace(0.0, 3.5, 36)
    truth = window_truth(cache, windows, 0, Fraction(60))[np.round(times * 60).astype(int)]
    standing = np.linalg.norm(truth - truth.mean(axis=0), axis=-1).mean()
    found = trained.decode(trained.posterior_mean, times, Fraction(60))
    assert found.shape == (len(windows), 36, 22, 3)
    # Not a good field, after seconds; but far better than a body that stands still.
    assert np.linalg.norm(found[0] - truth, axis=-1).mean() < 0.6 * standing
    motion_field = trained.as_motion_field(trained.posterior_mean[0], 3.5)
    assert motion_field.skeleton == trained.skeleton
    poses = motion_field.at_fps(Fraction(60)).query(times[[20, 3]])
    assert (poses.local_rotations is not None) == (name == "rotations")
    np.testing.assert_allclose(poses.joint_positions[:, :22], found[0, [20, 3]], atol=2e-3)
    latents = encode_windows(trained, windows.select(np.array([0])), frames)
    again = trained.decode(latents, times, Fraction(60))[0]
    assert np.linalg.norm(again - truth, axis=-1).mean() < 0.6 * standing
