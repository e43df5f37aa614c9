"""One motion into one file by its suffix: every format can be read back, and a file is whole or not there."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.fields.motion_field import to_motion
from motionkit.io import gltf
from motionkit.io.registry import writers
from tests.helpers.analytic import analytic_motion


@pytest.fixture(scope="module")
def motion() -> mk.Motion:
    """Half a second of a walk at 30000/1001 fps, with rotations."""
    return to_motion(analytic_motion("walk", 2.0), Fraction(30000, 1001))


@pytest.mark.parametrize("suffix", [each.suffixes[0] for each in writers().values() if each.read is not None])
def test_what_is_written_is_read_back(motion: mk.Motion, tmp_path: Path, suffix: str) -> None:
    path = str(tmp_path / "new" / f"walk{suffix}")
    mk.write(motion, path)
    again = mk.read(path, unit_metres=0.01 if suffix == ".bvh" else None)
    assert again.fps == motion.fps and again.num_frames == motion.num_frames
    order = [motion.skeleton.index(name) for name in again.skeleton.joint_names]
    np.testing.assert_allclose(again.joint_positions, motion.joint_positions[:, order], atol=2e-4)
    extra = ["motions.json"] if suffix == ".npy" else []
    assert sorted(each.name for each in Path(path).parent.iterdir()) == [*extra, f"walk{suffix}"]


@pytest.mark.parametrize("name", ["walk.fbx", "walk", "walk.bvh.gz"])
def test_another_suffix_is_refused_with_those_there_are(motion: mk.Motion, tmp_path: Path, name: str) -> None:
    with pytest.raises(mk.UsageError, match=r"\.bvh"):
        mk.write(motion, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_what_fails_leaves_the_former_file(motion: mk.Motion, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "walk.glb"
    mk.write(motion, path)
    former = path.read_bytes()

    def full(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(gltf.GlbBuffer, "write", full)
    with pytest.raises(OSError, match="No space"):
        mk.write(motion, path)
    assert path.read_bytes() == former and list(tmp_path.iterdir()) == [path]


def test_joints_of_another_skeleton_become_the_22(motion: mk.Motion, tmp_path: Path) -> None:
    mk.write(motion, tmp_path / "walk.bvh")
    own = mk.read(tmp_path / "walk.bvh", unit_metres=0.01)
    assert own.skeleton != mk.SMPL22
    mk.write(own, tmp_path / "walk.npy")
    assert np.load(tmp_path / "walk.npy").shape == (motion.num_frames, 22, 3)
    with pytest.raises(ValueError, match=r"motions\.json"):
        mk.write(own.resample(20), tmp_path / "slow.npy")
