"""Finding the sequences of files and folders: what is read, what stands beside it, what is left out and why."""

import os
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.errors import UsageError
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import read, scan
from tests.helpers.amass_samples import smplh_fields, write_amass
from tests.helpers.every_format import SOURCES, bodies
from tests.helpers.format_samples import bvh_text, write_asfamc


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


# Links


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


# Files that are not read


@pytest.mark.parametrize("name", SOURCES)
def test_nothing_is_ignored_of_a_source_as_its_format_has_it(tmp_path: Path, name: str) -> None:
    SOURCES[name](tmp_path)
    (tmp_path / "LICENSE.txt").write_text("MIT")
    assert scan([tmp_path]).ignored == ()


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
