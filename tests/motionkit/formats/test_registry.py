from fractions import Fraction
from pathlib import Path

import pytest

from motionkit.formats.registry import ReadOptions, read, scan
from tests.motionkit.formats.samples import bvh_text, write_asfamc


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
