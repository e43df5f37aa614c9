"""The sequences of files and folders: what is found, read, left out and why; and `read`, `read_all`, `write`."""

import os
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.core.errors import UsageError
from motionkit.fields.motion_field import to_motion
from motionkit.io.registry import ReadOptions, writers
from motionkit.io.scan import read, scan
from tests.helpers.amass_samples import smplh_fields, write_amass
from tests.helpers.analytic import analytic_motion
from tests.helpers.every_format import bodies
from tests.helpers.format_samples import bvh_text, write_asfamc
from tests.helpers.refusal import refusal


@pytest.fixture
def source(tmp_path: Path) -> Path:
    folder = tmp_path / "takes"
    write_asfamc(folder / "07")
    (folder / "walk.bvh").write_text(bvh_text())
    (folder / "notes.txt").write_text("nothing to see")
    return folder


def test_the_real_captures_are_found_whole(captures: Path) -> None:
    result = scan([captures / "cmu", captures / "mixed-bvh"])
    assert len(result.items) == 159 + 14
    assert not result.problems


def test_sources_that_cannot_be_scanned(source: Path, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.bvh")
    (source / "gone.bvh").symlink_to("nowhere.bvh")
    for path in (source / "absent", source / "gone.bvh", tmp_path / "pipe.bvh"):
        with pytest.raises(UsageError, match=path.name):
            scan([path])
    with pytest.raises(UsageError, match="bvh"):
        scan([source], ReadOptions(format="fbx"))
    assert [item.format for item in scan([source], ReadOptions(format="asfamc")).items] == ["asfamc"]


def test_a_given_format_reads_a_file_of_any_name(tmp_path: Path) -> None:
    (tmp_path / "take").write_text(bvh_text())
    (item,) = scan([tmp_path / "take"], ReadOptions(format="bvh")).items
    assert item.format == "bvh" and read(item).num_frames == 4


@pytest.mark.parametrize(
    ("name", "reason"), [("words.txt", "unknown-format"), ("walk.fbx", "unknown-format"), ("", "empty-folder")]
)
def test_what_holds_no_motion(tmp_path: Path, name: str, reason: str) -> None:
    np.savez(tmp_path / "keyed.npz", betas=np.zeros(10), xyz=bodies(6, 22))
    for empty in ("words.txt", "walk.fbx"):
        (tmp_path / empty).write_text("nothing")
    (problem,) = scan([tmp_path / name]).problems
    assert (problem.path, problem.reason) == (tmp_path / name, reason)


def test_licences_are_found(source: Path) -> None:
    (source / "LICENSE").write_text("\n  MIT License\n\nCopyright\n")
    (source / "07" / "LICENSE-data").write_text("CC BY-NC 4.0\n")
    assert {item.sequence_id: item.licence for item in scan([source]).items} == {
        "takes/walk": "MIT License",
        "takes/07/07_01": "CC BY-NC 4.0",
    }


def test_loops_end_and_nothing_is_found_twice(tmp_path: Path) -> None:
    source, outside = tmp_path / "takes", tmp_path / "outside"
    for folder in (source / "b", outside / "one", outside / "two"):
        folder.mkdir(parents=True)
        (folder / f"{folder.name}.bvh").write_text(bvh_text())
    (source / "a").symlink_to(source / "b")  # there both ways: the real path counts
    (source / "b" / "self").symlink_to(source / "b")
    (source / "b" / "up").symlink_to("..")
    (source / "root").symlink_to("/")
    (source / "parent").symlink_to(tmp_path)
    (source / "x").symlink_to(outside / "one")
    (outside / "one" / "other").symlink_to(outside / "two")
    (outside / "two" / "other").symlink_to(outside / "one")
    (tmp_path / "alias").symlink_to(source)
    expected = ["takes/b/b", "takes/x/one", "takes/x/other/two"]
    for given in (source, tmp_path / "alias"):
        found = scan([given])
        assert ([item.sequence_id for item in found.items], found.problems) == (expected, ())


def test_links_that_lead_nowhere_are_reported_and_nothing_else_is_lost(source: Path) -> None:
    (source / "c").symlink_to(source / "d")
    (source / "d").symlink_to(source / "c")
    (source / "07" / "run.bvh").symlink_to("gone.bvh")
    (source / ".hidden").symlink_to("nowhere")
    found = scan([source])
    assert len(found.items) == 2
    assert [problem.path.name for problem in found.problems] == ["c", "d", "run.bvh"]
    assert {problem.reason for problem in found.problems} == {"unreadable"}


def test_files_that_nothing_is_done_with_are_ignored(source: Path) -> None:
    (source / "07" / "video.mpg").write_bytes(b"")
    (source / "notes.csv").write_text("file,caption\nwalk.bvh,a person walks\ngone.bvh,nobody\n")
    (source / "prices.csv").write_text("a,b\n1,2\n")
    np.savez(source / "unknown.npz", xyz=bodies(4, 22))
    np.save(source / "unknown.npy", np.zeros((4, 66)))
    write_amass(source / "s1" / "take_poses.npz", smplh_fields())
    write_amass(source / "s1" / "shape.npz", {"betas": np.zeros(10)})
    (source / ".DS_Store").write_bytes(b"")
    ignored = [path.relative_to(source.resolve()).as_posix() for path in scan([source, source]).ignored]
    assert ignored == ["notes.txt", "prices.csv", "unknown.npy", "unknown.npz", "07/video.mpg"]
    assert scan([source / "walk.bvh"]).ignored == ()


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
    for reader, name in ((mk.read, "walk.bvh"), (mk.read_all, "nothing"), (mk.read, "store")):
        with pytest.raises(mk.UsageError, match=name):
            reader(tmp_path / name)
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
