"""Linked folders: found once, whatever loops the links make."""

import cProfile
import os
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.errors import FormatError, UsageError
from motionkit.io.reading import read
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import scan
from motionkit.store.chunks import read_or_fault
from tests.helpers.format_samples import bvh_text


@pytest.fixture
def source(tmp_path: Path) -> Path:
    root = tmp_path / "takes"
    (root / "b").mkdir(parents=True)
    (root / "b" / "walk.bvh").write_text(bvh_text())
    return root


def ids(root: Path) -> list[str]:
    found = scan([root])
    assert not found.problems
    return [item.sequence_id for item in found.items]


def test_a_linked_folder_is_read_with_what_stands_beside_its_motions(source: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "run.bvh").write_text(bvh_text())
    (elsewhere / "takes.csv").write_text("file,caption,fps\nrun.bvh,a person runs,50\n")
    (elsewhere / "LICENSE").write_text("CC0\n")
    (source / "linked").symlink_to(elsewhere)
    found = scan([source])
    assert not found.problems and not found.warnings
    assert [item.sequence_id for item in found.items] == ["takes/b/walk", "takes/linked/run"]
    motion = read(found.items[1])
    assert (motion.captions[0].text, motion.fps, motion.provenance.licence) == ("a person runs", 50, "CC0")
    assert motion.provenance.source_path == "linked/run.bvh"


def test_loops_end_and_nothing_is_found_twice(source: Path) -> None:
    (source / "a").symlink_to(source / "b")  # there both ways: the real path counts
    (source / "b" / "self").symlink_to(source / "b")
    (source / "b" / "up").symlink_to("..")
    assert ids(source) == ["takes/b/walk"]


def test_links_that_lead_nowhere_are_reported_and_nothing_else_is_lost(source: Path) -> None:
    (source / "c").symlink_to(source / "d")
    (source / "d").symlink_to(source / "c")
    (source / "more").symlink_to("nowhere/at/all")
    (source / "b" / "run.bvh").symlink_to("gone.bvh")
    (source / ".hidden").symlink_to("nowhere")
    found = scan([source])
    assert [item.sequence_id for item in found.items] == ["takes/b/walk"]
    assert {problem.reason for problem in found.problems} == {"dangling-link"}
    assert [problem.path.relative_to(source).as_posix() for problem in found.problems] == [
        "c",
        "d",
        "more",
        "b/run.bvh",
    ]
    assert "is a link to nowhere/at/all, which leads nowhere (No such file" in str(found.problems[2])
    with pytest.raises(UsageError, match=r"is a link to gone\.bvh"):
        scan([source / "b" / "run.bvh"])


def test_an_array_whose_link_is_broken_does_not_hide_its_data_set(tmp_path: Path) -> None:
    joints = tmp_path / "HumanML3D" / "new_joints"
    joints.mkdir(parents=True)
    (joints / "000000.npy").symlink_to(tmp_path / "gone.npy")
    np.save(joints / "000001.npy", np.zeros((5, 22, 3), np.float32))
    found = scan([tmp_path / "HumanML3D"])
    assert [item.format for item in found.items] == ["humanml3d", "humanml3d"]
    with pytest.raises(FormatError, match=r"is a link to .*gone\.npy") as caught:
        read(found.items[0])
    assert caught.value.reason == "dangling-link" and read(found.items[1]).num_frames == 5
    fault = read_or_fault(found.items[0], ReadOptions())
    assert isinstance(fault, FormatError) and fault.reason == "dangling-link"


def test_two_linked_folders_that_link_to_each_other(source: Path, tmp_path: Path) -> None:
    for name, other in (("one", "two"), ("two", "one")):
        folder = tmp_path / "outside" / name
        folder.mkdir(parents=True)
        (folder / f"{name}.bvh").write_text(bvh_text())
        (folder / "other").symlink_to(tmp_path / "outside" / other)
    (source / "x").symlink_to(tmp_path / "outside" / "one")
    assert ids(source) == ["takes/b/walk", "takes/x/one", "takes/x/other/two"]


def test_a_link_to_what_contains_the_source_is_not_followed(source: Path, tmp_path: Path) -> None:
    (tmp_path / "private").mkdir()
    (tmp_path / "private" / "jump.bvh").write_text(bvh_text())
    (source / "root").symlink_to("/")
    (source / "parent").symlink_to(tmp_path)
    assert ids(source) == ["takes/b/walk"]


def test_a_source_that_is_a_link_itself(source: Path, tmp_path: Path) -> None:
    (tmp_path / "alias").symlink_to(source)
    assert ids(tmp_path / "alias") == ["takes/b/walk"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may look everywhere")
def test_what_may_not_be_looked_at_is_reported(source: Path, tmp_path: Path) -> None:
    private = tmp_path / "private"
    private.mkdir()
    (private / "run.bvh").write_text(bvh_text())
    (source / "b" / "run.bvh").symlink_to(private / "run.bvh")
    private.chmod(0)
    try:
        found = scan([source])
    finally:
        private.chmod(0o700)
    assert [item.sequence_id for item in found.items] == ["takes/b/walk"] and len(found.problems) == 1


def test_many_folders_with_a_table_each_cost_no_more_than_their_sum(tmp_path: Path) -> None:
    def calls(num_folders: int) -> int:
        root = tmp_path / str(num_folders)
        for number in range(num_folders):
            folder = root / str(number)
            folder.mkdir(parents=True)
            for name in ("walk", "run"):
                (folder / f"{name}.bvh").touch()
            (folder / "motions.csv").write_text("file,caption\nwalk.bvh,walks\ngone.bvh,no\n")
        profile = cProfile.Profile()
        profile.runcall(scan, [root])
        return sum(entry.callcount for entry in profile.getstats())

    calls(2)
    assert calls(80) < 9 * calls(10)
