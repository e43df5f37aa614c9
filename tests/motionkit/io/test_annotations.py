"""Sidecar tables: what they say about generated motions."""

import json
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.errors import FormatError
from motionkit.io.annotations import read_annotations, tables_in
from motionkit.io.reading import read, read_document
from motionkit.io.registry import IndexOptions, ReadOptions
from motionkit.io.scan import scan
from tests.helpers.format_samples import bvh_text


def test_a_table_names_the_prompt_and_the_length_of_generated_motions(tmp_path: Path) -> None:
    path = tmp_path / "samples.csv"
    path.write_text("file,group,num_frames\na.npy,7,40\nb.npy,7,\nc.npy,,0\nd.npy,,-3\ne.npy,,many\n")
    ((table,), problems) = tables_in(tmp_path)
    assert table.path == path and not problems and not table.warnings
    rows = {target.name: row for target, row in table.rows.items()}
    assert {name: (row.get("group"), row.get("num_frames")) for name, row in rows.items()} == {
        "a.npy": ("7", 40),
        "b.npy": ("7", None),
    }
    assert [(problem.line, problem.reason) for problem in table.problems] == [
        (4, "annotations"),
        (5, "annotations"),
        (6, "annotations"),
    ]
    assert "expected how many frames are motion" in str(table.problems[0])


@pytest.mark.parametrize(
    ("header", "reported"),
    [
        ("file,caption,fsp", "a column that is not read: 'fsp' (did you mean fps?)"),
        ("file,caption, fps", "a column that is not read: ' fps' (did you mean fps?)"),
        ("file,caption,zzz,Description", "columns that are not read: 'zzz', 'Description' (did you mean caption?)"),
        ("file,caption,a,b,c,d,e,f,g", "columns that are not read: 'a', 'b', 'c', 'd', 'e' and 2 more"),
        ("file,caption,\x1b[31m", "a column that is not read: '\\x1b[31m'"),
        ("file,sequence_id,caption,seconds", None),
        ("file,zzz", None),
        ("name,fsp", None),
    ],
)
def test_columns_that_are_not_read_are_reported(tmp_path: Path, header: str, reported: str | None) -> None:
    (tmp_path / "walk.bvh").write_text(bvh_text())
    (tmp_path / "table.csv").write_text(f"{header}\nwalk.bvh" + ",1" * header.count(",") + "\n")
    found = scan([tmp_path])
    assert (len(found.items), found.problems) == (1, ())
    assert [warning.message for warning in found.warnings if warning.reason == "unknown-column"] == [reported] * bool(
        reported
    )


def test_a_column_performer_says_who_moves(tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_text("file,performer,subject\na.bvh,p1,\nb.bvh,p1,s2\n")
    ((table,), _) = tables_in(tmp_path)
    assert {target.name: row["subject"] for target, row in table.rows.items()} == {"a.bvh": "p1", "b.bvh": "s2"}


@pytest.mark.parametrize(("table", "option", "kept"), [("2", 0, 2), ("", 3, 1), ("2", 3, 2), ("0", 3, 4), ("", 0, 4)])
def test_the_first_frames_are_left_out(tmp_path: Path, table: str, option: int, kept: int) -> None:
    (tmp_path / "walk.bvh").write_text(bvh_text())
    (tmp_path / "table.csv").write_text(f"file,skip_frames\nwalk.bvh,{table}\n")
    options = ReadOptions(skip_frames=option)
    (item,) = scan([tmp_path], options).items
    whole, motion = read(item), read(item, options)
    assert motion.num_frames == kept
    assert motion.timegrid.start_seconds == 0.0
    assert np.array_equal(motion.joint_positions[-1], whole.joint_positions[-1])


@pytest.mark.parametrize("document", [False, True])
def test_captions_move_with_the_first_frame(tmp_path: Path, document: bool) -> None:
    """Their seconds count from the file's first frame; what is said of the left-out frames alone is dropped."""
    rows = [[0.0, 95.0, 2.0 * frame, *[0.0] * 48] for frame in range(90)]
    (tmp_path / "walk.bvh").write_text(bvh_text(rows))
    said = [
        "all of it",
        {"text": "before", "start_seconds": 0.2, "end_seconds": 0.9},
        {"text": "across", "start_seconds": 0.5, "end_seconds": 2.0},
        {"text": "later", "start_seconds": 1.5, "end_seconds": 2.5},
        {"text": "from then on", "start_seconds": 2.0},
    ]
    cell = json.dumps(said).replace('"', '""')
    (tmp_path / "table.csv").write_text(f'file,skip_frames,captions\nwalk.bvh,30,"{cell}"\n')
    (item,) = scan([tmp_path]).items
    opened = read_document(item) if document else None
    assert (opened is not None) == document
    found = read(item) if opened is None else opened.motion
    assert (found.num_frames, found.timegrid.start_seconds) == (60, 0.0)
    times = [(caption.text, caption.start_seconds, caption.end_seconds) for caption in found.captions]
    assert times == [
        ("all of it", 0.0, None),
        ("across", 0.0, 1.0),
        ("later", 0.5, 1.5),
        ("from then on", 1.0, None),
    ]


def test_more_first_frames_than_there_are(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text(bvh_text())
    (item,) = scan([tmp_path]).items
    with pytest.raises(FormatError, match="4 frames, of which the first 4 are to be left out"):
        read(item, ReadOptions(skip_frames=4))


def test_splits_that_no_command_knows_are_reported_once(tmp_path: Path) -> None:
    names = ("train", "training", "Test", "dev", "val", "", "training")
    for number in range(len(names)):
        (tmp_path / f"{number}.bvh").write_text(bvh_text())
    path = tmp_path / "table.csv"
    path.write_text("file,split\n" + "".join(f"{number}.bvh,{name}\n" for number, name in enumerate(names)))
    found = scan([tmp_path])
    assert [item.split for item in found.items] == list(names)  # what is said is kept: --where may ask for it
    (warning,) = found.warnings
    assert (warning.reason, warning.path, warning.line) == ("unknown-split", path, 3)
    assert warning.message == (
        "split 'training' (did you mean train?) in 2 rows, 'Test' (did you mean test?) in 1 row, 'dev' in 1 row; "
        "commands know train, val, test"
    )


def test_a_table_for_several_sources_is_warned_of_once(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / f"{name}.bvh").write_text(bvh_text())
    (tmp_path / "table.csv").write_text("file,caption,fsp\na.bvh,a,60\nb.bvh,b,60\n")
    found = scan([tmp_path / "a", tmp_path / "b"], ReadOptions(captions=tmp_path / "table.csv"))
    assert [warning.reason for warning in found.warnings] == ["unknown-column"]


def test_tables_beside_the_files_of_an_index(tmp_path: Path) -> None:
    (tmp_path / "source").mkdir()
    (tmp_path / "source" / "a.bvh").write_text(bvh_text())
    (tmp_path / "source" / "table.csv").write_text("file,fps,fsp\na.bvh,60,60\nb.bvh,0,\n")
    (tmp_path / "index.csv").write_text("source_path,start_frame,end_frame,new_name\na.npy,0,2,000000\n")
    found = scan([tmp_path / "source"], ReadOptions(index=IndexOptions((tmp_path / "index.csv",))))
    assert [item.fps for item in found.items] == [60]
    assert [warning.reason for warning in found.warnings] == ["unknown-column"]
    assert [problem.reason for problem in found.problems] == ["frame-time"]


def test_problems_of_many_rows_keep_no_frames(tmp_path: Path) -> None:
    """The frames of a traceback for each bad row made tables of many take three times as long."""
    table = tmp_path / "clips.csv"
    table.write_text("file,fps\n" + "../out.npz,30\ntake.npz,walks\n" * 3, encoding="utf-8")
    problems = read_annotations(table).problems
    assert len(problems) == 6
    assert not any(problem.__traceback__ or problem.__context__ for problem in problems)
