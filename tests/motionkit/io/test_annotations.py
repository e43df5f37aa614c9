"""Annotation tables: what they state of motions, which of several counts, and rows that cannot be used."""

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from motionkit.io.registry import ReadOptions, SourceItem
from motionkit.io.scan import read, read_document, scan
from tests.helpers.format_samples import bvh_text, write_asfamc
from tests.helpers.refusal import refusal


@pytest.fixture
def source(tmp_path: Path) -> Path:
    folder = tmp_path / "takes"
    write_asfamc(folder / "07")
    (folder / "walk.bvh").write_text(bvh_text())
    (folder / "takes.csv").write_text(
        "file,caption,caption_kit,action,split,fps,performer\n"
        "walk.bvh,a person walks,somebody walks,walk,train,30,Anna\n"
        "07/07_01.amc,,,bend,test,60,\n"
        "gone.bvh,nobody,,,,,\n"
    )
    return folder


def one(folder: Path, table: str, text: str | None = None) -> SourceItem:
    """The item of a folder of one BVH file with a table."""
    (folder / "walk.bvh").write_text(text or bvh_text())
    (folder / "table.csv").write_text(table)
    (item,) = scan([folder]).items
    return item


def test_a_table_beside_the_motions(source: Path) -> None:
    result = scan([source])
    items = {item.sequence_id: item for item in result.items}
    assert set(items) == {"takes/walk", "takes/07/07_01"}
    assert [(problem.reason, problem.line) for problem in result.problems] == [("caption-without-motion", 4)]
    walk = read(items["takes/walk"])
    assert [caption.text for caption in walk.captions] == ["a person walks", "somebody walks"]
    assert (walk.action, walk.split, walk.fps, walk.provenance.subject) == ("walk", "train", Fraction(30), "Anna")
    assert (walk.provenance.source, walk.provenance.source_path) == ("takes", "walk.bvh")
    bend = read(items["takes/07/07_01"])
    assert bend.fps == 60 and bend.provenance.subset == "07"
    assert read(items["takes/07/07_01"], ReadOptions(fps=Fraction(100))).fps == 100


def test_a_single_file_finds_its_row_also_higher_up_and_misses_no_other(source: Path, tmp_path: Path) -> None:
    (tmp_path / "above.csv").write_text("file,style,action\ntakes/walk.bvh,old,run\n")
    result = scan([source / "walk.bvh"])
    (item,) = result.items
    assert (item.captions[0].text, item.style, item.action) == ("a person walks", "old", "walk")
    assert not result.problems and item.sequence_id == "takes/walk"


@pytest.mark.parametrize("place", ["mine.csv", "takes/mine.csv", "takes/07/mine.csv"])
def test_a_given_table_is_joined_to_those_beside_the_files_cell_by_cell(
    source: Path, tmp_path: Path, place: str
) -> None:
    """What it leaves empty stays what the files' own table says, wherever it lies; its paths count from the source."""
    table = tmp_path / place
    table.write_text(
        "file,caption,fps\nwalk.bvh,mine,24\n../takes/walk.bvh,again,\n../../etc/passwd,no,\n/etc/passwd,no,\n"
        "07/07_01.amc,bends,x\n"
    )
    result = scan([source], ReadOptions(captions=table))
    problems = [(problem.line, problem.reason) for problem in result.problems if problem.path == table]
    assert problems == [(3, "duplicate-annotation"), (4, "path"), (5, "path"), (6, "frame-time")]
    assert not result.ignored
    motion = read(next(item for item in result.items if item.format == "bvh"))
    assert ([caption.text for caption in motion.captions], motion.fps) == (["mine"], 24)
    assert (motion.action, motion.split) == ("walk", "train")


@pytest.mark.parametrize(
    ("header", "unread"),
    [
        ("file,caption,fsp", ["'fsp'"]),
        ("file,caption,zzz,Description", ["'zzz'", "'Description'"]),
        ("file,sequence_id,caption,seconds", []),
    ],
)
def test_columns_that_are_not_read_are_reported(tmp_path: Path, header: str, unread: list[str]) -> None:
    one(tmp_path, f"{header}\nwalk.bvh" + ",1" * header.count(",") + "\n")
    found = scan([tmp_path])
    assert (len(found.items), found.problems, len(found.warnings)) == (1, (), bool(unread))
    assert all(column in found.warnings[0].message for column in unread)


@pytest.mark.parametrize(("table", "option", "kept"), [("2", 0, 2), ("", 3, 1), ("2", 3, 2), ("0", 3, 4), ("", 0, 4)])
def test_the_first_frames_are_left_out(tmp_path: Path, table: str, option: int, kept: int) -> None:
    item = one(tmp_path, f"file,skip_frames\nwalk.bvh,{table}\n")
    whole, motion = read(item), read(item, ReadOptions(skip_frames=option))
    assert (motion.num_frames, motion.timegrid.start_seconds) == (kept, 0.0)
    assert np.array_equal(motion.joint_positions[-1], whole.joint_positions[-1])
    assert refusal(read, one(tmp_path, "file,skip_frames\nwalk.bvh,4\n")).path.name == "walk.bvh"


@pytest.mark.parametrize("document", [False, True])
def test_captions_move_with_the_first_frame(tmp_path: Path, document: bool) -> None:
    """Their seconds count from the file's first frame; what is said of the left-out frames alone is dropped."""
    rows = [[0.0, 95.0, 2.0 * frame, *[0.0] * 48] for frame in range(90)]
    captions = [
        "all of it",
        {"text": "before", "start_seconds": 0.2, "end_seconds": 0.9},
        {"text": "across", "start_seconds": 0.5, "end_seconds": 2.0},
        {"text": "from then on", "start_seconds": 2.0},
    ]
    cell = json.dumps(captions).replace('"', '""')
    item = one(tmp_path, f'file,skip_frames,captions\nwalk.bvh,30,"{cell}"\n', bvh_text(rows))
    opened = read_document(item) if document else None
    assert (opened is not None) == document
    motion = read(item) if opened is None else opened.motion
    assert (motion.num_frames, motion.timegrid.start_seconds) == (60, 0.0)
    times = [(caption.text, caption.start_seconds, caption.end_seconds) for caption in motion.captions]
    assert times == [("all of it", 0.0, None), ("across", 0.0, 1.0), ("from then on", 1.0, None)]
