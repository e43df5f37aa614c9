"""What is said of the files of a source that are not read, and of sequences that share an id."""

import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motionkit.io.registry import ReadOptions
from motionkit.io.scan import scan
from tests.helpers.amass_samples import smplh_fields, write_amass
from tests.helpers.every_format import SOURCES, bodies
from tests.helpers.format_samples import bvh_text, write_asfamc


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


def test_tables_are_not_ignored_whether_found_or_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "walk.bvh").write_text(bvh_text())
    for name in ("mine.csv", "theirs.csv"):
        (tmp_path / name).write_text("file,caption\nwalk.bvh,a person walks\n")
    assert ignored(tmp_path) == []
    monkeypatch.chdir(tmp_path)
    assert ignored(tmp_path, ReadOptions(captions=Path("mine.csv"))) == []


def test_of_sequences_of_one_id_the_first_is_read(tmp_path: Path) -> None:
    for name in ("bvh", "c3d", "npz"):
        SOURCES[name](tmp_path)
    found = scan([tmp_path])
    assert [item.path.name for item in found.items] == ["take.bvh"]
    assert [(problem.path.name, problem.reason) for problem in found.problems] == [
        ("take.c3d", "duplicate-id"),
        ("take.npz", "duplicate-id"),
    ]
    assert not found.ignored


@pytest.mark.parametrize(
    ("name", "holds"),
    [
        ("keyed.npz", "an archive of betas, xyz"),
        ("wide.npy", "an array of shape (6, 66)"),
        ("words.txt", "of no known format, expected"),
        ("broken.npz", "of no known format, expected"),
    ],
)
def test_an_unknown_file_is_reported_with_the_arrays_that_it_holds(tmp_path: Path, name: str, holds: str) -> None:
    np.savez(tmp_path / "keyed.npz", betas=np.zeros(10), xyz=bodies(6, 22))
    np.save(tmp_path / "wide.npy", np.zeros((6, 66)))
    (tmp_path / "words.txt").write_text("nothing")
    np.savez(tmp_path / "broken.npz", xyz=bodies(6, 22))
    (tmp_path / "broken.npz").write_bytes((tmp_path / "broken.npz").read_bytes()[:-9])
    if name == "broken.npz":  # what cannot be opened may be motionkit's own: its reader says what is wrong
        assert len(scan([tmp_path / name]).items) == 1
        return
    (problem,) = scan([tmp_path / name]).problems
    assert problem.reason == "unknown-format" and holds in problem.message


@pytest.mark.parametrize("name", [name for name in SOURCES if name not in ("humanml3d", "kit", "parquet")])
def test_a_file_is_opened_once_to_know_its_format(
    tmp_path: Path, name: str, opened: Callable[[Callable[[], object]], Counter[str]]
) -> None:
    path = SOURCES[name](tmp_path)
    options = ReadOptions(skip_derived=True)
    counts = opened(lambda: scan([tmp_path], options))
    once = 2 if path.suffix == ".csv" else 1  # a table might be one of annotations, too
    assert counts[str(path)] <= once


@pytest.fixture(scope="module")
def opened() -> Callable[[Callable[[], object]], Counter[str]]:
    """Counts how often each file is opened in a call."""
    counts: Counter[str] = Counter()
    sys.addaudithook(lambda event, arguments: counts.update([str(arguments[0])] if event == "open" else []))

    def count(call: Callable[[], object]) -> Counter[str]:
        counts.clear()
        call()
        return counts

    return count


def test_a_table_that_cannot_be_read_is_a_problem_and_no_motion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "walk.bvh").write_text(bvh_text())
    table = tmp_path / "captions.csv"
    table.write_text("file,caption\nwalk.bvh,a person walks\n")
    real = Path.open

    def refuse(path: Path, *arguments: Any, **options: Any) -> Any:
        if path == table:
            raise PermissionError(13, "Permission denied", str(path))
        return real(path, *arguments, **options)

    monkeypatch.setattr(Path, "open", refuse)
    found = scan([tmp_path])
    assert [item.path.name for item in found.items] == ["walk.bvh"]
    assert {problem.path for problem in found.problems} == {table}
