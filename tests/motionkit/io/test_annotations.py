"""What tables and rules state of files: captions, framerates, frames to leave out; rows that cannot be used."""

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.io.registry import ReadOptions, SourceItem
from motionkit.io.scan import parse_rules, read, read_document, read_rules, scan
from tests.helpers.amass_samples import smplh_fields, stageii_fields, write_amass
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
def test_a_given_table_is_joined_to_those_beside_the_files_cell_by_cell(source, tmp_path, place):
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


def read_file(root: Path, path: Path, options: ReadOptions | None = None) -> mk.Motion:
    (item,) = (item for item in scan([root], options).items if item.path == path.resolve())
    return read(item, options)


@pytest.mark.parametrize(
    ("path", "stated", "used"),
    [
        ("TotalCapture/s1/walking1_stageii.npz", 120.0, 60),
        ("TotalCapture/s1/walking1_stageii.npz", 60.0, 60),
        ("TotalCapture/s1/walking1_poses.npz", 120.0, 120),
        ("SSM_synced/20160930_50032/jumping_poses.npz", 120.0, 60),
        ("SSM_synced/20160330_03333/jumping_poses.npz", 120.0, 120),
        ("KIT/3/walk_stageii.npz", 120.0, 100),
        ("DFaust/DFaust_67/50002/jiggles_stageii.npz", 120.0, 60),
        ("MoSh/50021/hips_stageii.npz", 120.0, 100),
        ("MoSh/50007/hips_stageii.npz", 120.0, 120),
        ("TCDHands/ExperimentDatabase/Flute05_A_stageii.npz", 120.0, 150),
        ("TCDHands/ExperimentDatabase/TypingA_stageii.npz", 120.0, 120),
        ("EyesJapanDataset/Eyes_Japan_Dataset/kudo/jump-01-normal-kudo_stageii.npz", 120.0, 250),
        ("EyesJapanDataset/Eyes_Japan_Dataset/kudo/gesture_etc-18-eat-kudo_stageii.npz", 120.0, 120),
        ("CMU/CMU/80/80_63_stageii.npz", 120.0, 60),
        ("CMU/63/63_01_stageii.npz", 120.0, 120),
        ("CMU/74/74_10_stageii.npz", 120.0, 60),
        ("CMU/84/84_09_stageii.npz", 120.0, 120),
        ("CMU/77/77_28_stageii.npz", 120.0, 120),
        ("CMU/139/139_21_stageii.npz", 120.0, 120),
        ("CMU/139/139_31_stageii.npz", 120.0, 60),
    ],
)
def test_shipped_rules_correct_what_they_name_and_nothing_else(tmp_path, path, stated, used):
    fields = smplh_fields(mocap_framerate=None) | {"mocap_frame_rate": stated}
    file = write_amass(tmp_path / "AMASS" / path, fields)
    for root in (tmp_path / "AMASS", tmp_path / "AMASS" / Path(path).parts[0]):
        motion = read_file(root, file)
        assert motion.fps == used and motion.provenance.stated_fps == str(stated)
        assert any("rule" in line for line in motion.provenance.operations) == (used != round(stated))


def test_the_users_rules_win_and_explicit_framerates_win_over_rules(tmp_path: Path) -> None:
    file = write_amass(tmp_path / "KIT" / "3" / "walk_stageii.npz", stageii_fields())
    rules = tmp_path / "rules.toml"
    rules.write_text(
        '[[rule]]\nfiles = "*_run_*.npz"\nfps = 24\n\n'
        '[[rule]]\nfiles = ["3/*.npz"]\nfps = "30000/1001"\nstated = 120\nsource = "me"\n'
    )
    own = ReadOptions(fps_rules=read_rules(rules))
    motion = read_file(tmp_path / "KIT", file, own)
    assert motion.fps == Fraction(30000, 1001) and "rules.toml, rule 2, me" in motion.provenance.operations[-1]
    assert read_file(tmp_path / "KIT", file, ReadOptions(fps=Fraction(50), fps_rules=own.fps_rules)).fps == 50
    (tmp_path / "KIT" / "clips.csv").write_text("file,fps\n3/walk_stageii.npz,48\n")
    assert read_file(tmp_path / "KIT", file, own).fps == 48


def test_rules_hold_for_every_format(tmp_path: Path) -> None:
    bvh = tmp_path / "data" / "062" / "62_11.bvh"
    bvh.parent.mkdir(parents=True)
    for frame_time, has_rule in ((".0083333", True), (".0166667", False)):
        bvh.write_text(bvh_text(frame_time=frame_time))
        motion = read_file(tmp_path / "data", bvh)
        assert motion.fps == 60 and any("rule" in line for line in motion.provenance.operations) == has_rule
    amc = write_asfamc(tmp_path / "data")
    rules = parse_rules('[[rule]]\nfiles = "*.amc"\nfps = 120', "mine")
    motion = read_file(tmp_path / "data", amc, ReadOptions(fps_rules=rules))
    assert motion.fps == 120 and "mine, rule 1" in motion.provenance.operations[-1]


@pytest.mark.parametrize("value", [-1.0, np.nan, 1e9, "fast", None])
def test_a_rule_replaces_a_framerate_that_is_none(tmp_path: Path, value: object) -> None:
    file = write_amass(tmp_path / "a_poses.npz", smplh_fields(mocap_framerate=value))
    assert refusal(read_file, tmp_path, file).reason == ("no-framerate" if value is None else "framerate")
    rules = parse_rules('[[rule]]\nfiles = "*.npz"\nfps = 100', "mine")
    assert read_file(tmp_path, file, ReadOptions(fps_rules=rules)).fps == 100


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("rule = ", "f.toml"),
        ("[[rule]]\nfps = 60", "rule 1"),
        ('[[rule]]\nfiles = "a"\nfps = 60\nframerate = 3', "framerate"),
        ("[[rule]]\nfiles = [7]\nfps = 60", "files"),
        ('[[rule]]\nfiles = "a"\nfps = 60\n[[rule]]\nfiles = "b"\nfps = nan', "rule 2"),
    ],
)
def test_bad_rules_are_reported_by_their_number(tmp_path: Path, text: str, place: str) -> None:
    (tmp_path / "f.toml").write_text(text)
    with pytest.raises(mk.UsageError, match=place):
        read_rules(tmp_path / "f.toml")
