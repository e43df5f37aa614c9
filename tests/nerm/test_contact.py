from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float32

from motionkit.core.progress import ignore
from motionkit.core.skeleton import SMPL22
from motionkit.data.windows import cut_windows
from motionkit.fields.motion_field import PredictsContacts
from motionkit.training.config import apply_overrides
from motionkit.training.run import StageFolder
from nerm.field_training import labels_at, train_contacts
from nerm.model import TrainedField, load_field, save_field
from tests.helpers.nerm_corpus import analytic_source
from tests.nerm.small_fields import BANKED, finished, small_training

CONFIG = apply_overrides(BANKED, ["contact_steps=100"])


def swinging_left() -> Float32[np.ndarray, "frames 4"]:
    """Of every frame: the left foot is down while it is left of the root, the right one never."""
    positions = analytic_source().positions
    left = positions[:, (7, 10), 0] > positions[:, :1, 0] + SMPL22.offsets[[1, 4, 7], 0].sum()
    return np.ascontiguousarray(np.concatenate((left, np.zeros_like(left)), axis=1), dtype=np.float32)


@pytest.fixture(scope="module")
def trained() -> TrainedField:
    """A field that begins as its linear model, which knows these motions, with contacts learnt on top."""
    field = finished(small_training(CONFIG))
    contacts, loss = train_contacts(field, swinging_left(), seed=0, on_progress=ignore)
    assert loss < 0.2
    return replace(field, contacts=contacts)


def test_contacts_follow_from_the_latent_at_any_instant(trained: TrainedField) -> None:
    rows, first = swinging_left(), 0
    for window, frames in enumerate(trained.windows.num_frames.tolist()):
        motion = trained.as_motion_field(trained.posterior_mean[window], 4.0)
        assert isinstance(motion, PredictsContacts)
        seconds = np.arange(frames) / trained.windows.fps[window]
        said = motion.contacts(seconds)
        assert said is not None and said.min() >= 0.0 and said.max() <= 1.0
        right = (said.reshape(-1, 4) > 0.5) == (rows[first : first + frames] > 0.5)
        assert right.mean() > 0.95
        first += frames
    between = motion.contacts(np.array([1.0, 1.001]))
    assert between is not None and np.abs(between[1] - between[0]).max() < 0.05
    with pytest.raises(ValueError, match="outside"):
        motion.contacts(np.array([4.5]))


def test_a_mirrored_window_has_them_on_the_other_side() -> None:
    source = analytic_source()
    windows = cut_windows(source, max_duration_seconds=4.0, mirror_pairs=SMPL22.left_right_pairs)
    [plain], [mirrored] = (np.flatnonzero((windows.start_row == 0) & (windows.mirrored == is_it)) for is_it in (0, 1))
    frames = np.arange(100)[None]
    there, here = (labels_at(swinging_left(), windows, np.array([window]), frames)[0] for window in (plain, mirrored))
    assert there[:, :2].any() and not there[:, 2:].any()
    np.testing.assert_array_equal(here, there[:, [2, 3, 0, 1]])


def test_contacts_are_in_the_file_and_older_files_have_none(trained: TrainedField, tmp_path: Path) -> None:
    times = np.linspace(0.0, 4.0, 9)
    for name, field in (("with", trained), ("without", replace(trained, contacts=None))):
        save_field(StageFolder(tmp_path / name / "field"), field)
        loaded = load_field(tmp_path / name)
        motions = (each.as_motion_field(trained.posterior_mean[0], 4.0) for each in (field, loaded))
        said = [motion.contacts(times) for motion in motions]
        assert (said[0] is None) == (said[1] is None) == (name == "without")
        if said[0] is not None:
            np.testing.assert_array_equal(said[0], said[1])
