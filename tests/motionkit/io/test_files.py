"""`read`, `read_all` and `write`: one motion of a file or of many, and one motion into a file by its suffix."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.fields.motion_field import to_motion
from motionkit.io.registry import writers
from tests.helpers.analytic import analytic_motion
from tests.helpers.format_samples import bvh_text
from tests.helpers.refusal import refusal


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    """A folder of three BVH files, one of them in a folder of its own, with a table of captions."""
    folder = tmp_path / "takes"
    for name, frames in (("alpha", 4), ("beta", 5), ("more/gamma", 6)):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.bvh").write_text(bvh_text(frames))
    (folder / "clips.csv").write_text("file,caption,action\nalpha.bvh,a person walks,walk\n")
    return folder


@pytest.mark.parametrize("kind", [str, Path])
def test_a_file_with_what_stands_beside_it(takes: Path, kind: type) -> None:
    motion = mk.read(kind(takes / "alpha.bvh"))
    assert motion.num_frames == 4 and motion.sequence_id == "takes/alpha"
    assert motion.captions == (mk.Caption("a person walks"),) and motion.action == "walk"
    assert mk.read(takes / "alpha.bvh", fps="59.94").fps == Fraction(60000, 1001)


def test_one_of_several_by_its_id_or_the_end_of_it(takes: Path) -> None:
    assert mk.read(takes, sequence="takes/beta").num_frames == 5
    assert mk.read(str(takes), sequence="gamma").num_frames == 6
    assert mk.read(takes / "more").num_frames == 6
    with pytest.raises(mk.UsageError, match="takes/alpha"):
        mk.read(takes)
    with pytest.raises(mk.UsageError, match="'amma'"):
        mk.read(takes, sequence="amma")


def test_all_of_a_folder_one_at_a_time(takes: Path) -> None:
    assert [motion.num_frames for motion in mk.read_all(str(takes))] == [4, 5, 6]
    (takes / "more" / "gamma.bvh").write_text("HIERARCHY\n")
    reading = mk.read_all(takes)
    assert next(reading).num_frames == 4  # the bad file's turn has not come
    with pytest.raises(mk.FormatError, match=r"gamma\.bvh"):
        list(reading)
    with pytest.warns(UserWarning, match=r"gamma\.bvh"):
        assert [motion.num_frames for motion in mk.read_all(takes, on_error="skip")] == [4, 5]


def test_what_leads_nowhere_or_holds_no_motion(takes: Path, tmp_path: Path) -> None:
    with mk.StoreWriter.create(tmp_path / "store") as writer:
        writer.add(mk.read(takes / "alpha.bvh"))
    for read, name in ((mk.read, "walk.bvh"), (mk.read_all, "nothing"), (mk.read, "store")):
        with pytest.raises(mk.UsageError, match=name):
            read(tmp_path / name)
    (tmp_path / "empty").mkdir()
    (tmp_path / "walk.xyz").write_bytes(b"3 atoms")
    assert refusal(mk.read, tmp_path / "empty", sequence="walk").reason == "empty-folder"
    assert refusal(mk.read, tmp_path / "walk.xyz").reason == "unknown-format"


@pytest.mark.parametrize("unit_metres", [100, 1.0, 1e-4])
def test_a_unit_that_makes_giants_or_dwarfs_is_refused(tmp_path: Path, unit_metres: float) -> None:
    (tmp_path / "walk.bvh").write_text(bvh_text())
    assert mk.read(tmp_path / "walk.bvh", unit_metres=0.02).num_frames == 4  # a giant, on purpose
    assert refusal(mk.read, tmp_path / "walk.bvh", unit_metres=unit_metres).reason == "unit"
    for wrong in ({"fps": "fast"}, {"unit_metres": -1.0}):
        with pytest.raises(ValueError):
            mk.read(tmp_path / "walk.bvh", **wrong)


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
