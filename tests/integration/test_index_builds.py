"""`motionkit ingest ROOT --index …`: native-framerate HumanML3D and its kin from small trees that the tests write."""

import json
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.skeleton import SMPL22
from motionkit.store import Store
from motionkit.store import ingest as ingesting
from tests.helpers.humanml3d_checkout import (
    FPS,
    HEADER,
    WINDOWS,
    frame_numbers,
    write_amass_tree,
    write_checkout,
    write_take,
)


@pytest.fixture
def amass(tmp_path: Path) -> Path:
    return write_amass_tree(tmp_path / "AMASS")


@pytest.fixture
def humanml3d(tmp_path: Path) -> Path:
    return write_checkout(tmp_path / "HumanML3D")


def test_clips_at_their_native_framerates(motionkit, amass, humanml3d, tmp_path):
    outcome = motionkit(
        "ingest", amass, "--index", humanml3d / "index.csv", "--texts", humanml3d / "texts", "--store", tmp_path / "s",
        "--workers", 1,
    )  # fmt: skip
    assert outcome.code == 0
    store = Store.open(tmp_path / "s")
    assert set(store.sequences["sequence_id"]) == {f"humanml3d/{name}" for name in WINDOWS}
    for name, (start, stop) in WINDOWS.items():
        motion = store.read(f"humanml3d/{name}")
        assert frame_numbers(store, f"humanml3d/{name}") == list(range(start, stop)), name
        assert (motion.fps, motion.timegrid.start_seconds) == (FPS[name], 0.0)
        said = ["a person stands", *(["then rises"] if name != "009707" else [])]
        assert [caption.text for caption in motion.captions] == said
        if name == "009707":
            continue
        factor = {"000004": 14 / 15, "000005": 0.96}.get(name, 1.0)
        assert motion.captions[1].start_seconds == pytest.approx(0.5 * factor)
        assert motion.captions[1].end_seconds == pytest.approx(factor)
    rows = store.sequences.set_index("sequence_id")
    assert rows["split"].to_dict() == {
        "humanml3d/000000": "train", "humanml3d/000001": "", "humanml3d/000002": "train", "humanml3d/000003": "train",
        "humanml3d/000004": "test", "humanml3d/000005": "test", "humanml3d/009707": "",
    }  # fmt: skip
    assert rows["source_path"]["humanml3d/000004"] == (
        "EyesJapanDataset/yamaoka/tennis-15-first_service-yamaoka_stageii.npy"
    )
    assert rows["subset"]["humanml3d/000005"] == "Transitions_mocap"
    assert set(rows["source"]) == {"humanml3d"}
    log = rows["operations"]["humanml3d/000004"]
    assert "frames [441, 721) of 1000, 2.94 s to 4.80667 s of the file" in log[-2]
    assert log[-1] == "captions' seconds × 0.933333: they were counted at 21.4286 fps called 20"
    assert outcome.stderr.splitlines() == [
        f"warning: {amass}/CMU/CMU/01/01_01_poses.npy: ends 0.15 s before humanml3d/000003 does; 0.817 s of it are kept"
    ]
    assert motionkit("validate", "--store", tmp_path / "s").code == 0


def test_splits_of_another_corpus_are_reported_with_an_example_of_each_side(motionkit, amass, humanml3d, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    (other / "train.txt").write_text("00001\nM00001\n")
    (other / "test.txt").write_text("000004\n")
    (amass / "SFU").symlink_to("/nowhere/SFU")
    outcome = motionkit(
        "ingest", amass, "--index", humanml3d / "index.csv", "--splits", other, "--store", tmp_path / "s"
    )
    warned = [line for line in outcome.stderr.splitlines() if "train.txt" in line or "SFU" in line]
    assert outcome.code == 0 and warned == [
        f"warning: {amass}/SFU: is a link to /nowhere/SFU, which leads nowhere (No such file or directory): fix "
        "the link or remove it",
        f"warning: {other}/train.txt: none of its 2 names is in index.csv: it lists '00001', index.csv has '000000'; "
        "so nothing is of the split train",
    ]
    assert set(Store.open(tmp_path / "s").sequences["split"]) == {"", "test"}


def test_the_published_frames_instead(motionkit, amass, humanml3d, tmp_path):
    motionkit(
        "ingest", amass, "--index", humanml3d / "index.csv", "--compat", "humanml3d-20fps", "--store", tmp_path / "s",
        "--workers", 1,
    )  # fmt: skip
    store = Store.open(tmp_path / "s")
    steps = {"000000": 5, "000001": 1, "000002": 6, "000003": 6, "000004": 7, "009707": 3, "000005": 12}
    for name, step in steps.items():
        start, stop = WINDOWS[name]
        assert frame_numbers(store, f"humanml3d-20fps/{name}") == list(range(start, stop, step)), name
        assert store.read(f"humanml3d-20fps/{name}").fps == 20


def test_mirrored_clips_have_captions_and_splits_of_their_own(motionkit, amass, humanml3d, tmp_path):
    outcome = motionkit(
        "ingest", amass, "--index", humanml3d / "index.csv", "--texts", humanml3d / "texts", "--store", tmp_path / "s",
        "--mirrored", "--workers", 1,
    )  # fmt: skip
    assert outcome.code == 0
    store = Store.open(tmp_path / "s")
    assert len(store.sequences) == 14
    plain, mirrored = store.read("humanml3d/000004"), store.read("humanml3d/M000004")
    left, right = SMPL22.index("left_knee"), SMPL22.index("right_knee")
    assert np.array_equal(mirrored.joint_positions[:, left], plain.joint_positions[:, right] * np.float32([-1, 1, 1]))
    assert (mirrored.split, mirrored.captions[0].text) == ("test", "a mirrored person stands")
    # Clips of one file follow each other, so that it is read once.
    paths = store.sequences["source_path"].tolist()
    assert sum(path != after for path, after in pairwise(paths)) == len(set(paths)) - 1


def test_what_is_missing_is_counted_by_dataset(motionkit, amass, humanml3d, tmp_path):
    shutil.rmtree(amass / "CMU")
    with (humanml3d / "index.csv").open("a") as file:
        file.write("./pose_data/KIT/3/broken_poses.npy,0,10,000006.npy\n")
        file.write("./pose_data/KIT/3/kick_poses.npy,200,240,000007.npy\n")
        file.write("./pose_data/../../x.npy,0,10,000008.npy\n")
    arguments = ("ingest", amass, "--index", humanml3d / "index.csv", "--store", tmp_path / "s", "--workers", 1)
    outcome = motionkit(*arguments, "--json")
    assert outcome.code == 0
    told = json.loads(outcome.stdout)
    assert told["datasets"] == {
        "KIT": {"found": 3, "missing": 0, "failed": 2},
        "CMU": {"found": 0, "missing": 2, "failed": 0},
        "humanact12": {"found": 1, "missing": 0, "failed": 0},
        "Eyes_Japan_Dataset": {"found": 1, "missing": 0, "failed": 0},
        "BioMotionLab_NTroje": {"found": 1, "missing": 0, "failed": 0},
        "Transitions_mocap": {"found": 1, "missing": 0, "failed": 0},
    }
    assert told["failed"] == {"missing-file": 2, "path": 1, "not-what-it-says": 1, "beyond-end": 1}
    assert f"{humanml3d}/index.csv, line 4: 000002: there is no CMU/01/01_01_poses.npy below {amass}" in outcome.stderr
    asked = "the index names [200, 240) of one frame in 5 as 'humanml3d/000007', that is frames [1000, 1200)"
    assert asked in outcome.stderr
    again = motionkit(*arguments)
    assert "already there: 5" in again.stdout
    assert "KIT: 3 found, 0 missing, 2 failed" in again.stdout.splitlines()
    stopped = motionkit(*arguments, "--on-error", "stop", "--overwrite")
    assert stopped.code == 1


def test_captions_that_cannot_be_read_cost_their_sequence(motionkit, amass, humanml3d, tmp_path):
    (humanml3d / "texts/000002.txt").write_text("a person walks#a/DET\n")
    (humanml3d / "texts/000003.txt").unlink()
    outcome = motionkit(
        "ingest", amass, "--index", humanml3d / "index.csv", "--texts", humanml3d / "texts", "--store", tmp_path / "s",
        "--workers", 1, "--json",
    )  # fmt: skip
    told = json.loads(outcome.stdout)
    assert told["failed"] == {"text": 1}
    assert told["warnings"] == {"no-caption": 1, "shortened": 1}
    assert told["datasets"]["CMU"] == {"found": 2, "missing": 0, "failed": 1}
    assert told["stored"] == 6


def test_thousands_of_missing_files_are_reported_once(motionkit, amass, tmp_path):
    rows = "".join(f"KIT/3/none_{number}_poses.npy,0,5,{number:06}.npy\n" for number in range(50))
    (tmp_path / "index.csv").write_text(HEADER + "KIT/3/kick_poses.npy,0,5,a.npy\n" + rows)
    outcome = motionkit("ingest", amass, "--index", tmp_path / "index.csv", "--store", tmp_path / "s", "--workers", 1)
    assert len(outcome.error_lines) == 6
    assert outcome.error_lines[-1] == "more of the kind missing-file: counted at the end, --json names them all"
    assert "failed: 50 (50 missing-file)" in outcome.stdout


def test_only_the_files_that_are_named_are_opened(motionkit, amass, humanml3d, tmp_path):
    for path in (amass / "KIT/3/never_named_poses.npy", amass / "KIT/3/broken_poses.npy"):
        path.unlink()
        path.mkdir()  # which nothing could open
    outcome = motionkit("ingest", amass, "--index", humanml3d / "index.csv", "--store", tmp_path / "s", "--workers", 1)
    assert outcome.code == 0
    assert "failed" not in outcome.stdout.splitlines()[1]


def test_the_source_may_be_one_dataset_and_there_may_be_several(motionkit, amass, humanml3d, tmp_path):
    outcome = motionkit(
        "ingest", amass / "KIT", amass / "BMLrub", "--index", humanml3d / "index.csv", "--store", tmp_path / "s",
        "--workers", 1,
    )  # fmt: skip
    assert outcome.code == 0
    assert set(Store.open(tmp_path / "s").sequences["sequence_id"]) == {"humanml3d/000000", "humanml3d/009707"}


def test_of_two_releases_the_one_that_was_counted_on_is_read(motionkit, amass, tmp_path):
    write_take(amass / "0-smplx/KIT/3/kick_stageii.npy", 300)
    (tmp_path / "index.csv").write_text(HEADER + "KIT/3/kick_poses.npy,0,5,a.npy\n")
    outcome = motionkit("ingest", amass, "--index", tmp_path / "index.csv", "--store", tmp_path / "s", "--workers", 1)
    assert outcome.code == 0
    assert Store.open(tmp_path / "s").sequences["source_path"].tolist() == ["KIT/3/kick_poses.npy"]


def test_a_dataset_may_be_a_link_and_links_in_circles_end(motionkit, amass, humanml3d, tmp_path):
    (amass / "KIT").rename(tmp_path / "elsewhere")
    (amass / "KIT").symlink_to(tmp_path / "elsewhere")
    (amass / "KIT/3/up").symlink_to(amass)
    (amass / "again").symlink_to(amass)
    (amass / "dangling").symlink_to(tmp_path / "nowhere")
    outcome = motionkit("ingest", amass, "--index", humanml3d / "index.csv", "--store", tmp_path / "s", "--workers", 1)
    assert (outcome.code, outcome.error_lines) == (0, [])
    rows = Store.open(tmp_path / "s").sequences.set_index("sequence_id")
    assert len(rows) == 7
    assert rows["source_path"]["humanml3d/000000"] == "KIT/3/kick_poses.npy"


def test_kit_and_babel_in_one_store(motionkit, amass, tmp_path):
    said = [{"seg_id": "00001_0", "text": "A person kicks.", "start": 0.0, "end": 6.0}]
    part = [{"seg_id": "00002_0", "text": "A part.", "start": 1.0, "end": 2.5}]
    kit = {
        "00001": {"path": "KIT/3/kick_poses", "duration": 6.0, "annotations": said},
        "M00001": {"path": "M/KIT/3/kick_poses", "duration": 6.0, "annotations": said},
        "00002": {"path": "CMU/01/01_01_poses", "duration": 6.667, "annotations": part},
    }
    (tmp_path / "kitml.json").write_text(json.dumps(kit))
    babel = {
        "31": {
            "dur": 3.333,
            "feat_p": "BMLrub/BioMotionLab_NTroje/rub110/0001_treadmill_fast_poses.npz",
            "seq_ann": {"labels": [{"raw_label": "runs", "proc_label": "run", "act_cat": ["run"]}]},
            "frame_ann": {"labels": [{"raw_label": "turns", "act_cat": None, "start_t": 1.0, "end_t": 2.0}]},
        }
    }
    (tmp_path / "val.json").write_text(json.dumps(babel))
    outcome = motionkit(
        "ingest", amass, "--index", tmp_path / "kitml.json", "--index", tmp_path / "val.json",
        "--store", tmp_path / "s", "--workers", 1,
    )  # fmt: skip
    assert outcome.code == 0
    assert outcome.stderr.splitlines() == [
        f"warning: {amass}/BMLrub/rub110/0001_treadmill_fast_stageii.npy: lasts 6.667 s at 60 fps, which is not what "
        "the index says of babel/31; its captions' seconds won't fit: is the framerate wrong (--fps-rules)?"
    ]
    store = Store.open(tmp_path / "s")
    assert store.sequences["sequence_id"].tolist() == ["kitml/00001", "kitml/00002", "babel/31"]
    assert frame_numbers(store, "kitml/00001") == list(range(600))
    assert frame_numbers(store, "kitml/00002") == list(range(120, 300))
    run = store.read("babel/31")
    assert (run.num_frames, run.fps, run.action, run.split) == (400, 60, "run", "val")
    assert [(caption.text, caption.start_seconds, caption.end_seconds) for caption in run.captions] == [
        ("runs", 0.0, None),
        ("turns", 1.0, 2.0),
    ]
    mirrored = motionkit(
        "ingest", amass, "--index", tmp_path / "kitml.json", "--mirrored", "--store", tmp_path / "m", "--workers", 1
    )
    assert mirrored.code == 0
    assert Store.open(tmp_path / "m").sequences["sequence_id"].tolist() == [
        "kitml/00001",
        "kitml/M00001",
        "kitml/00002",
    ]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--texts", "."), "give one with --index"),
        (("--compat", "humanml3d-20fps"), "give one with --index"),
        (("--index", "index.csv", "--captions", "x.csv"), "are about whole files"),
        (("--index", "index.csv", "--texts", "nowhere"), "is not a folder of texts"),
        (("--index", "index.csv", "--splits", "texts"), "has none of train.txt"),
        (("--index", "kitml.json", "--compat", "humanml3d-20fps"), "only HumanML3D's index.csv has frames at 20 fps"),
        (("--index", "babel.json", "--mirrored"), "has no mirrored sequences"),
        (("--index", "humanml3d.json", "--compat", "humanml3d-20fps"), "only HumanML3D's index.csv has frames"),
        (("--index", "humanml3d.json", "--mirrored"), "has no mirrored sequences"),
        (("babel.json", "--index", "index.csv"), "babel.json is not a folder"),
        (("nowhere", "--index", "index.csv"), "nowhere is not a folder"),
    ],
)
def test_requests_that_make_no_sense(motionkit, amass, humanml3d, monkeypatch, arguments, message):
    monkeypatch.chdir(humanml3d)
    Path("babel.json").write_text('{"1": {"feat_p": "CMU/CMU/01/01_01_poses.npz"}}')
    for name in ("kitml.json", "humanml3d.json"):
        Path(name).write_text('{"1": {"path": "CMU/01/01_01_poses", "annotations": []}}')
    outcome = motionkit("ingest", amass, *arguments, "--store", "s", "--workers", 1)
    assert outcome.code == 2
    assert message in outcome.stderr
    assert not Path("s").exists()


def test_a_bad_table_beside_the_files_is_reported(motionkit, amass, humanml3d, tmp_path):
    (amass / "notes.csv").write_text("file,fps\nKIT/3/kick_poses.npy,fast\nBMLrub/rub110/x.npy,30\n")
    outcome = motionkit("ingest", amass, "--index", humanml3d / "index.csv", "--store", tmp_path / "s", "--workers", 1)
    assert outcome.code == 0
    assert outcome.error_lines == [
        f"{amass}/notes.csv, line 2: fps 'fast': a framerate is a number such as 120, 59.94 or 30000/1001, not 'fast'"
    ]


def test_humanact12_at_15_fps_by_a_rule(motionkit, amass, humanml3d, tmp_path):
    rules = tmp_path / "rules.toml"
    rules.write_text('[[rule]]\nfiles = "humanact12/**/*.npy"\nfps = 15\n')
    outcome = motionkit(
        "ingest", amass, "--index", humanml3d / "index.csv", "--texts", humanml3d / "texts", "--fps-rules", rules,
        "--store", tmp_path / "s", "--workers", 1,
    )  # fmt: skip
    assert outcome.code == 0
    motion = Store.open(tmp_path / "s").read("humanml3d/000001")
    assert (motion.fps, motion.num_frames, motion.provenance.stated_fps) == (15, 64, "20")
    # Half a published second is 10 frames.
    assert motion.captions[1].start_seconds == pytest.approx(10 / 15)


def test_an_index_that_is_none(motionkit, amass, tmp_path):
    (tmp_path / "index.csv").write_text("file,caption\na,b\n")
    outcome = motionkit("ingest", amass, "--index", tmp_path / "index.csv", "--store", tmp_path / "s")
    assert outcome.code == 1
    assert len(outcome.error_lines) == 1
    assert "expected an index: HumanML3D's index.csv" in outcome.stderr


def test_workers_make_the_same_store(motionkit, amass, humanml3d, tmp_path, monkeypatch):
    monkeypatch.setattr(ingesting, "CHUNK_BYTES", 1)  # each file for itself
    contents = []
    for workers in (1, 2):
        store = tmp_path / f"s{workers}"
        motionkit(
            "ingest", amass, "--index", humanml3d / "index.csv", "--mirrored", "--store", store, "--workers", workers
        )
        contents.append({path.name: path.read_bytes() for path in sorted(store.rglob("*.parquet"))})
    assert contents[0] == contents[1]
    assert len(contents[0]) > 4


def test_the_published_index_on_real_takes_of_the_cmu_database(motionkit, captures, tmp_path):
    """AMC files under CMU's own names: their lengths are what the published frame numbers were counted on."""
    root = tmp_path / "source"
    shutil.copytree(captures / "cmu/asfamc/02", root / "CMU/02")
    (root / "takes.csv").write_text("file,fps\n" + "".join(f"CMU/02/02_{n:02}.amc,120\n" for n in range(1, 11)))
    rows = (captures / "annotations/humanml3d-index.csv").read_text().splitlines()
    wanted = [row for row in rows if "/CMU/02/" in row]
    (tmp_path / "index.csv").write_text("\n".join([rows[0], *wanted]))
    for split in ("train", "val", "test"):
        shutil.copy(captures / f"annotations/humanml3d-{split}.txt", tmp_path / f"{split}.txt")
    outcome = motionkit("ingest", root, "--index", tmp_path / "index.csv", "--store", tmp_path / "s", "--workers", 1)
    assert outcome.code == 0
    sequences = Store.open(tmp_path / "s").sequences
    takes = {path.stem for path in root.rglob("*.amc")}
    present = [row for row in wanted if row.split("/")[4].partition("_poses")[0] in takes]
    assert len(sequences) == len(present) > 5
    assert set(sequences["split"]) <= {"train", "val", "test"}
    lengths = {row.split(",")[3][:-4]: int(row.split(",")[2]) - int(row.split(",")[1]) for row in present}
    for _, sequence in sequences.iterrows():
        published = lengths[sequence["sequence_id"].removeprefix("humanml3d/")]
        assert sequence["fps"] == 120
        # All that was published is there; the last published frame may be the file's last.
        assert 6 * (published - 1) < sequence["num_frames"] <= 6 * published
