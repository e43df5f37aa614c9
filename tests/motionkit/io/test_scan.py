import concurrent.futures
import multiprocessing
import os
from fractions import Fraction
from pathlib import Path

import pytest

from motionkit.core.errors import FormatError, UsageError
from motionkit.io.reading import read
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import scan
from tests.helpers.format_samples import bvh_text, write_asfamc


@pytest.fixture
def source(tmp_path: Path) -> Path:
    folder = tmp_path / "takes"
    write_asfamc(folder / "07")
    (folder / "walk.bvh").write_text(bvh_text())
    (folder / "notes.txt").write_text("nothing to see")
    (folder / "takes.csv").write_text(
        "file,caption,caption_kit,action,split,fps\n"
        "walk.bvh,a person walks,somebody walks,walk,train,30\n"
        "07/07_01.amc,,,bend,test,60\n"
        "gone.bvh,nobody,,,,\n"
    )
    return folder


def test_scan_and_read_with_annotations(source: Path) -> None:
    result = scan([source])
    items = {item.sequence_id: item for item in result.items}
    assert set(items) == {"takes/walk", "takes/07/07_01"}
    assert [(problem.reason, problem.line) for problem in result.problems] == [("caption-without-motion", 4)]
    assert [warning.reason for warning in result.warnings] == ["no-caption"]
    walk = read(items["takes/walk"])
    assert [caption.text for caption in walk.captions] == ["a person walks", "somebody walks"]
    assert (walk.action, walk.split, walk.fps) == ("walk", "train", Fraction(30))
    assert (walk.provenance.source, walk.provenance.source_path) == ("takes", "walk.bvh")
    bend = read(items["takes/07/07_01"])
    assert bend.fps == 60 and bend.provenance.subset == "07"
    assert read(items["takes/07/07_01"], ReadOptions(fps=Fraction(100))).fps == 100


def test_an_empty_folder_and_a_repeated_id_are_problems(source: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    assert [problem.reason for problem in scan([tmp_path / "empty"]).problems] == ["empty-folder"]
    again = scan([source, source])
    assert [problem.reason for problem in again.problems].count("duplicate-id") == 2
    assert len(again.items) == 2


def test_the_real_pack_is_found_whole(captures: Path) -> None:
    result = scan([captures / "cmu", captures / "bandai-namco", captures / "mixed-bvh"])
    assert len(result.items) == 159 + 3064 + 14
    assert not result.problems


def test_a_single_file_is_known_by_its_content(tmp_path: Path) -> None:
    (tmp_path / "take").write_text(bvh_text())
    (tmp_path / "readme").write_text("nothing")
    (item,) = scan([tmp_path / "take"]).items
    assert item.format == "bvh" and read(item).num_frames == 4
    assert [problem.reason for problem in scan([tmp_path / "readme"]).problems] == ["unknown-format"]
    assert [problem.reason for problem in scan([tmp_path]).problems] == ["empty-folder"]


def test_a_file_that_is_not_what_its_name_says(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text(":FULLY-SPECIFIED\n:DEGREES\n1\nroot 0 0 0\n")
    (item,) = scan([tmp_path]).items
    with pytest.raises(FormatError, match="looks like an AMC file") as caught:
        read(item)
    assert caught.value.reason == "not-what-it-says"


def test_an_explicit_format_and_requests_that_make_no_sense(source: Path) -> None:
    assert [item.format for item in scan([source], ReadOptions(format="asfamc")).items] == ["asfamc"]
    with pytest.raises(UsageError, match="expected auto or one of"):
        scan([source], ReadOptions(format="fbx"))
    with pytest.raises(UsageError, match="does not exist"):
        scan([source / "gone"])


def test_given_annotations_go_before_those_found_column_by_column_and_paths_stay_inside(
    source: Path, tmp_path: Path
) -> None:
    table = tmp_path / "mine.csv"
    table.write_text(
        "file,caption,fps\nwalk.bvh,mine,24\n../takes/walk.bvh,again,\n../../etc/passwd,no,\n/etc/passwd,no,\n"
        "07/07_01.amc,bends,x\n"
    )
    result = scan([source], ReadOptions(captions=table))
    assert [(problem.reason, problem.line) for problem in result.problems if problem.path == table] == [
        ("duplicate-annotation", 3),
        ("path", 4),
        ("path", 5),
        ("frame-time", 6),
    ]
    walk = next(item for item in result.items if item.format == "bvh")
    motion = read(walk)
    assert ([caption.text for caption in motion.captions], motion.fps) == (["mine"], 24)
    assert (motion.action, motion.split) == ("walk", "train")
    assert motion.provenance.operations[0] == "framerate set to 24; the file says 30"


def test_licences_are_found(source: Path) -> None:
    (source / "LICENSE").write_text("\n  MIT License\n\nCopyright\n")
    (source / "07" / "LICENSE-data").write_text("CC BY-NC 4.0\n")
    licences = {item.sequence_id: read(item).provenance.licence for item in scan([source]).items}
    assert licences == {"takes/walk": "MIT License", "takes/07/07_01": "CC BY-NC 4.0"}


def test_scan_results_travel_between_processes(source: Path) -> None:
    with concurrent.futures.ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        result = pool.submit(scan, [source]).result()
    assert result.items == scan([source]).items
    assert str(result.problems[0]) == str(scan([source]).problems[0])


def test_given_captions_may_describe_several_sources(source: Path, tmp_path: Path) -> None:
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "run.bvh").write_text(bvh_text())
    table = tmp_path / "mine.csv"
    table.write_text("file,caption\nwalk.bvh,walks\nrun.bvh,runs\n07/07_01.amc,bends\ngone.bvh,nobody\n")
    result = scan([source, tmp_path / "more"], ReadOptions(captions=table))
    assert sorted(item.captions[0].text for item in result.items) == ["bends", "runs", "walks"]
    problems = [problem for problem in result.problems if problem.path == table]
    assert [(problem.reason, problem.line) for problem in problems] == [("caption-without-motion", 5)]
    assert not result.warnings


@pytest.mark.parametrize("place", ["mine.csv", "takes/mine.csv", "takes/07/mine.csv"])
def test_a_given_table_is_joined_to_the_one_beside_the_files_cell_by_cell(tmp_path: Path, place: str) -> None:
    """What it leaves empty stays what the files' own table says, wherever it lies; its paths count from the source."""
    folder = tmp_path / "takes"
    (folder / "07").mkdir(parents=True)
    for name in ("walk", "07/run"):
        (folder / f"{name}.bvh").write_text(bvh_text())
    (folder / "table.csv").write_text(
        "file,fps,action,caption,skip_frames\nwalk.bvh,60,walk,theirs,1\n07/run.bvh,24,run,runs,\n"
    )
    (tmp_path / place).write_text("file,caption,split,action\nwalk.bvh,mine,test,\n")
    result = scan([folder], ReadOptions(captions=tmp_path / place))
    assert (result.problems, result.warnings, result.ignored) == ((), (), ())
    found = {item.path.stem: item for item in result.items}
    walk, run = found["walk"], found["run"]
    assert ([caption.text for caption in walk.captions], walk.split, walk.action) == (["mine"], "test", "walk")
    assert (walk.fps, walk.skip_frames) == (60, 1)
    assert ([caption.text for caption in run.captions], run.fps, run.action) == (["runs"], 24, "run")


def test_a_single_file_finds_its_row_and_misses_no_other(source: Path) -> None:
    result = scan([source / "walk.bvh"])
    assert [item.captions[0].text for item in result.items] == ["a person walks"]
    assert not result.problems and result.items[0].sequence_id == "takes/walk"


def test_a_linked_take_keeps_its_annotation(source: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere.bvh").write_text(bvh_text())
    (source / "walk.bvh").unlink()
    (source / "walk.bvh").symlink_to(tmp_path / "elsewhere.bvh")
    walk = next(item for item in scan([source]).items if item.format == "bvh")
    assert walk.captions and read(walk).num_frames == 4
    assert scan([source / "walk.bvh"]).items == (walk,)


def test_a_table_whose_captions_are_all_empty_asks_for_none(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text(bvh_text())
    (tmp_path / "clips.csv").write_text("file,caption,split\nwalk.bvh,,train\n")
    result = scan([tmp_path])
    assert (len(result.items), result.problems, result.warnings) == (1, (), ())


def test_a_pipe_is_no_source(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.bvh")
    with pytest.raises(UsageError, match="neither a file nor a folder"):
        scan([tmp_path / "pipe.bvh"])


def test_a_folder_of_nothing_known_says_what_it_has_in_one_line(tmp_path: Path) -> None:
    for name in ("walk.glb", "run.GLB"):
        (tmp_path / name).write_bytes(b"glTF")
    (tmp_path / "motions.csv").write_text("file,caption\nwalk.glb,a person walks\nrun.GLB,a person runs\n")
    (problem,) = scan([tmp_path]).problems
    assert problem.reason == "empty-folder"
    assert "(it has 2 .glb, 1 .csv, the first: motions.csv), expected lafan1" in problem.message
