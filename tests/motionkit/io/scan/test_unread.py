"""What is said of the files of a source that are not read, and of sequences that share an id."""

from pathlib import Path

import numpy as np
import pytest

from motionkit.io.scan.items import ReadOptions
from motionkit.io.scan.reading import read
from motionkit.io.scan.scanner import scan
from tests.helpers.amass_samples import smplh_fields, write_amass
from tests.helpers.every_format import SOURCES, bodies
from tests.helpers.format_samples import bvh_text, write_asfamc
from tests.helpers.vector_samples import interhuman_rows, walk


def ignored(source: Path, options: ReadOptions | None = None) -> list[str]:
    return [path.relative_to(source.resolve()).as_posix() for path in scan([source], options).ignored]


@pytest.mark.parametrize("name", SOURCES)
def test_nothing_is_ignored_of_a_source_as_its_format_has_it(tmp_path: Path, name: str) -> None:
    SOURCES[name](tmp_path)
    (tmp_path / "LICENSE.txt").write_text("MIT")
    assert ignored(tmp_path) == []


def test_all_files_that_nothing_is_done_with_are_ignored(tmp_path: Path) -> None:
    write_asfamc(tmp_path / "07")
    (tmp_path / "07" / "video.mpg").write_bytes(b"")
    (tmp_path / "walk.bvh").write_text(bvh_text())
    (tmp_path / "notes.csv").write_text("file,caption\nwalk.bvh,a person walks\ngone.bvh,nobody\n")
    (tmp_path / "prices.csv").write_text("a,b\n1,2\n")
    np.savez(tmp_path / "unknown.npz", xyz=bodies(4, 22))
    np.save(tmp_path / "unknown.npy", np.zeros((4, 66)))
    write_amass(tmp_path / "s1" / "take_poses.npz", smplh_fields())
    write_amass(tmp_path / "s1" / "shape.npz", {"betas": np.zeros(10)})
    (tmp_path / ".DS_Store").write_bytes(b"")
    assert ignored(tmp_path) == ["prices.csv", "unknown.npy", "unknown.npz", "07/video.mpg"]
    assert scan([tmp_path / "walk.bvh"]).ignored == ()
    assert scan([tmp_path, tmp_path]).ignored == scan([tmp_path]).ignored


def test_of_formats_that_were_not_asked_for_all_is_ignored(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text(bvh_text())
    (tmp_path / "more").mkdir()
    SOURCES["humanml3d"](tmp_path / "more")
    assert ignored(tmp_path) == []
    files = ["new_joints/000001.npy", *(f"{name}.txt" for name in ("all", "test", "train", "train_val", "val"))]
    assert set(ignored(tmp_path, ReadOptions(format="bvh"))) == {f"more/{file}" for file in files}


def test_a_data_set_s_folder_has_files_that_are_ignored(tmp_path: Path) -> None:
    SOURCES["humanml3d"](tmp_path)
    np.save(tmp_path / "Mean.npy", np.zeros(263))
    np.save(tmp_path / "new_joint_vecs" / "000001.npy", np.zeros((11, 263)))
    (tmp_path / "animations").mkdir()
    (tmp_path / "animations" / "000001.mp4").write_bytes(b"")
    assert ignored(tmp_path) == ["animations/000001.mp4"]


def test_tables_beside_the_motions_are_read_where_another_is_given(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text(bvh_text())
    for name in ("mine.csv", "theirs.csv"):
        (tmp_path / name).write_text("file,caption\nwalk.bvh,a person walks\n")
    assert ignored(tmp_path) == ignored(tmp_path, ReadOptions(captions=tmp_path / "mine.csv")) == []


def test_sequences_of_one_id_are_spares_of_the_first(tmp_path: Path) -> None:
    for name in ("bvh", "c3d", "npz"):
        SOURCES[name](tmp_path)
    found = scan([tmp_path])
    assert [item.path.name for item in found.items] == ["take.bvh"]
    assert [spare.item.path.name for spare in found.spares] == ["take.c3d", "take.npz"]
    assert found.problems == tuple(spare.problem for spare in found.spares) and not found.ignored
    assert "is already taken by take.bvh" in str(found.problems[0])


def problem_of(path: Path, options: ReadOptions | None = None) -> str:
    (problem,) = scan([path], options).problems
    assert problem.reason == "unknown-format"
    return problem.message


def test_an_unknown_array_is_reported_with_what_it_holds(tmp_path: Path) -> None:
    many = {f"array{number}": np.zeros(number) for number in range(12)}
    np.savez(tmp_path / "many.npz", **many)
    assert "it holds array0 (0,) float64, array1 (1,) float64, " in problem_of(tmp_path / "many.npz")
    assert "array5 (5,) float64, 4 more; write one" in problem_of(tmp_path / "many.npz")
    np.savez(tmp_path / "kinds.npz", words=np.array(["walk"]), flag=np.array([True]), thing=np.array({}, dtype=object))
    assert "it holds flag (1,) bool, thing () Python objects, words (1,) text; " in problem_of(tmp_path / "kinds.npz")
    assert "of no known format, expected bvh" in problem_of(tmp_path / "many.npz", ReadOptions(format="bvh"))


@pytest.mark.parametrize(
    ("name", "arrays"),
    [
        ("keyed.npz", {"betas": np.zeros(10), "xyz": bodies(6, 22).astype(np.float64)}),
        ("wide.npy", {"": np.zeros((6, 66))}),
        ("thing.npz", {"result": np.array({"motion": 1}, dtype=object)}),
        ("vectors.npz", {"motion": interhuman_rows(walk(30, 2.0))[:6], "length": np.array(6)}),
    ],
)
def test_the_suggested_line_writes_a_readable_file(tmp_path: Path, name: str, arrays: dict[str, np.ndarray]) -> None:
    path = tmp_path / "in" / name
    path.parent.mkdir()
    np.savez(path, **arrays) if path.suffix == ".npz" else np.save(path, arrays[""])
    message = problem_of(path)
    line = message.partition(" with ")[2].rpartition(", joints being" if "joints being" in message else ", if these")[0]
    exec(f"import os\nimport numpy as np\n{line}", {"joints": bodies(6, 22)})
    path.unlink()
    (item,) = scan([tmp_path / "in"]).items
    assert read(item).num_frames == 6


def test_a_damaged_array_is_reported(tmp_path: Path) -> None:
    np.savez(tmp_path / "whole.npz", xyz=bodies(6, 22))
    content = (tmp_path / "whole.npz").read_bytes()
    (tmp_path / "whole.npz").write_bytes(content.replace(b"\x93NUMPY", b"\x93NUMPX"))
    assert "expected lafan1" in problem_of(tmp_path / "whole.npz")
