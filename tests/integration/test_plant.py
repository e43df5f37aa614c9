"""`motionkit plant`, file to file, and planting in generate and complete."""

import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.fields.contact.bones import legs_of
from motionkit.io.bvh import read_bvh, write_bvh
from motionkit.io.npz import read_npz, write_npz
from tests.helpers.analytic import capture
from tests.helpers.outcome import Outcome

Run = Callable[..., Outcome]
FPS = Fraction(60)


@pytest.fixture(scope="module")
def standing() -> mk.Motion:
    return replace(capture(FPS, "walk", seconds=4.0), sequence_id="walk")


@pytest.fixture(scope="module")
def sliding(standing: mk.Motion) -> mk.Motion:
    """The same walk on a floor that goes at 0.2 m/s."""
    step = np.zeros((standing.num_frames, 3), np.float32)
    step[:, 2] = 0.2 * standing.timegrid.seconds()
    assert standing.root_translation is not None
    return replace(
        standing,
        joint_positions=standing.joint_positions + step[:, None],
        root_translation=standing.root_translation + step,
    )


def steadiest(motion: mk.Motion) -> float:
    """Mean horizontal speed of the slowest foot joint, m/s: of a walk, one always rests."""
    feet = motion.joint_positions[:, list(legs_of(motion.skeleton).feet)][..., ::2].astype(np.float64)
    return float((np.linalg.norm(np.diff(feet, axis=0), axis=-1).min(axis=1) * float(motion.fps)).mean())


def test_a_bvh_file_whose_feet_slide(motionkit: Run, sliding: mk.Motion, tmp_path: Path) -> None:
    write_bvh(sliding, tmp_path / "walk.bvh")
    outcome = motionkit("plant", tmp_path / "walk.bvh", "--json")
    assert outcome.code == 0, outcome.stderr
    (told,) = json.loads(outcome.stdout)["clips"]
    assert told["file"] == str(tmp_path / "walk.planted.bvh")
    assert told["sliding_before"] > 0.19
    assert told["sliding_after"] < 0.3 * told["sliding_before"]
    assert told["num_contacts"] > 4
    assert told["largest_level_shift"] > 0.1 and not told["has_fixed_bones"]
    assert "left alone" not in motionkit("plant", tmp_path / "walk.bvh", "--overwrite").stderr
    after = read_bvh(tmp_path / "walk.planted.bvh")
    before = read_bvh(tmp_path / "walk.bvh")
    assert steadiest(after) < 0.3 * steadiest(before)
    change = np.linalg.norm(after.joint_positions - before.joint_positions, axis=-1)
    assert change.max() == pytest.approx(told["largest_change"], abs=1e-4)
    # The same hierarchy, with the same channels.
    texts = [(tmp_path / name).read_text() for name in ("walk.bvh", "walk.planted.bvh")]
    assert texts[0].partition("MOTION")[0] == texts[1].partition("MOTION")[0]


def test_frames_that_nothing_moves_stay_to_the_last_digit(motionkit: Run, standing: mk.Motion, tmp_path: Path) -> None:
    """A walk on a floor that begins to go after three seconds."""
    step = np.zeros((standing.num_frames, 3), np.float32)
    step[:, 2] = 0.2 * np.maximum(standing.timegrid.seconds() - 3.0, 0.0)
    late = replace(
        standing,
        joint_positions=standing.joint_positions + step[:, None],
        root_translation=standing.root_translation + step,
    )
    write_bvh(late, tmp_path / "walk.bvh")
    assert motionkit("plant", tmp_path / "walk.bvh").code == 0
    before, after = (tmp_path / name for name in ("walk.bvh", "walk.planted.bvh"))
    same = [a == b for a, b in zip(before.read_text().splitlines(), after.read_text().splitlines(), strict=True)]
    assert 0.3 < np.mean(same) < 1.0


def test_a_folder_a_store_and_arrays(motionkit: Run, sliding: mk.Motion, tmp_path: Path) -> None:
    folder = tmp_path / "clips"
    folder.mkdir()
    bare = replace(sliding, local_rotations=None, root_translation=None)
    write_npz(bare, folder / "a.npz")
    write_npz(bare, folder / "b.npz")
    outcome = motionkit("plant", folder)
    assert outcome.code == 0, outcome.stderr
    assert outcome.stdout.split() == [str(folder / "a.planted.npz"), str(folder / "b.planted.npz")]
    assert steadiest(read_npz(folder / "a.planted.npz")) < 0.3 * steadiest(bare)
    # What it made is not taken for a clip, and nothing is overwritten.
    again = motionkit("plant", folder)
    assert again.code == 1
    assert again.stderr.count("exists") == 2
    store = tmp_path / "store"
    with mk.StoreWriter.create(store) as writer:
        writer.add(sliding)
    outcome = motionkit("plant", "--store", store, "--out", tmp_path / "made")
    assert outcome.code == 0, outcome.stderr
    assert steadiest(read_npz(tmp_path / "made" / "walk.npz")) < 0.3 * steadiest(mk.Store.open(store)["walk"])
    assert motionkit("plant").code == 2
