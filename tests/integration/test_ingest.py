"""`motionkit ingest`: a clear line for each fault, a store of the good ones alone; and native-framerate HumanML3D."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from motionkit.store import Store
from tests.helpers.every_format import SOURCES
from tests.helpers.format_samples import TWO_JOINTS, bvh_hierarchy, bvh_text
from tests.helpers.humanml3d_checkout import FPS, WINDOWS, frame_numbers, write_amass_tree, write_checkout


def ids(store: Path) -> list[str]:
    return list(Store.open(store).sequences["sequence_id"])


def test_the_first_ingest_makes_a_store_and_the_next_adds_to_it(motionkit, takes, tmp_path):
    store = tmp_path / "store"
    first = motionkit("ingest", takes, "--store", store, "--workers", 1)
    assert (first.code, first.stderr) == (0, "")
    assert first.stdout.startswith("stored 3 sequences (0.5 s, 15 frames) in ")
    assert ids(store) == ["takes/alpha", "takes/beta", "takes/gamma"]
    assert Store.open(store).read("takes/beta").fps == 30
    (takes / "delta.bvh").write_text(bvh_text(7))
    second = motionkit("ingest", takes, "--store", store, "--workers", 1)
    assert (second.code, second.stderr) == (0, "")
    assert second.stdout.startswith("stored 1 sequence (0.2 s, 7 frames) in ")
    assert "already there: 3" in second.stdout
    assert ids(store)[3:] == ["takes/delta"]
    renamed = motionkit("ingest", takes.rename(tmp_path / "again"), "--store", store, "--workers", 1)
    assert renamed.code == 0 and "beta.bvh: now stored twice" in renamed.stderr
    assert motionkit("validate", "--store", store).code == 0


BAD_FILES = {
    "truncated": bvh_text(8)[:-400],
    "channels": bvh_text([[0.0] * 50] * 2),
    "nan": bvh_text().replace("\n0 95 4", "\n0 nan 4"),
    "zero-time": bvh_text(frame_time="0"),
    "no-time": bvh_text().replace("Frame Time: 0.0333333\n", ""),
    "photo": "\x89PNG\r\n\x1a\n",
    "nothing": "",
}


def test_all_of_it_at_once_counted_by_reason(motionkit, takes, tmp_path):
    for name, text in BAD_FILES.items():
        (takes / f"bad-{name}.bvh").write_text(text, encoding="latin-1")
    (takes / "clips.csv").write_text("file,caption\nalpha.bvh,a person slides\nghost.bvh,a ghost slides\n")
    (takes / "rope.bvh").write_text(bvh_text(["0 0 0 0 0 0 0 0 0"], head=bvh_hierarchy(TWO_JOINTS)))
    (tmp_path / "empty").mkdir()
    outcome = motionkit("ingest", takes, tmp_path / "empty", "--store", tmp_path / "store", "--json", "--workers", 1)
    summary = json.loads(outcome.stdout)
    assert outcome.code == 0
    assert summary["stored"] == 4
    assert summary["failed"] == {
        "frame-time": 2,
        "truncated": 1,
        "channel-count": 1,
        "nan": 1,
        "not-what-it-says": 1,
        "empty": 1,
        "caption-without-motion": 1,
        "empty-folder": 1,
    }
    assert summary["warnings"] == {"unmapped-skeleton": 1}
    lines = outcome.stderr.splitlines()
    assert len(lines) - 1 == len(summary["problems"]) == 9
    assert any("ghost.bvh" in line and "line 3" in line for line in lines)
    assert any(line.startswith(f"{tmp_path}/empty: ") for line in lines)
    assert ids(tmp_path / "store") == ["takes/alpha", "takes/beta", "takes/gamma", "takes/rope"]


def test_duplicate_ids(motionkit, takes, tmp_path):
    """The same id in one ingest, and in the store from another file."""
    shutil.copy(takes / "alpha.bvh", takes / "alpha.BVH")
    store = tmp_path / "store"
    first = motionkit("ingest", takes, "--store", store, "--workers", 1)
    assert first.code == 0
    assert "'takes/alpha' is already taken by" in first.stderr
    assert "failed: 1 (1 duplicate-id)" in first.stdout
    other = tmp_path / "other" / "takes"
    other.mkdir(parents=True)
    (other / "beta.bvh").write_text(bvh_text(9))
    second = motionkit("ingest", other, "--store", store, "--workers", 1)
    assert second.code == 1
    assert "already holds a sequence with the id 'takes/beta'" in second.stderr
    assert Store.open(store).read("takes/beta").num_frames == 5


@pytest.fixture
def arrays(tmp_path: Path) -> Path:
    """Ten arrays of which one is a motion."""
    folder = tmp_path / "arrays"
    folder.mkdir()
    np.savez(folder / "motion.npz", joint_positions=np.random.default_rng(0).random((5, 22, 3)), fps=30)
    for number in range(6):
        np.savez(folder / f"unknown-{number}.npz", xyz=np.zeros((5, 22, 3)))
    for number in range(3):
        np.save(folder / f"unknown-{number}.npy", np.zeros((5, 66)))
    return folder


def test_the_last_line_counts_what_was_ignored(motionkit, arrays, tmp_path):
    outcome = motionkit("ingest", arrays, "--store", tmp_path / "store")
    assert outcome.code == 0 and outcome.stdout.startswith("stored 1 sequence")
    (line,) = [line for line in outcome.stdout.splitlines() if line.startswith("ignored")]
    assert line == f"ignored: 9 (6 .npz, 3 .npy; the first: {arrays}/unknown-0.npy)"
    summary = json.loads(motionkit("ingest", arrays, "--store", tmp_path / "store", "--json").stdout)
    assert summary["ignored"] == {".npz": 6, ".npy": 3}
    assert sorted(summary["ignored_paths"]) == sorted(map(str, arrays.glob("unknown*")))


@pytest.mark.parametrize("workers", [1, 2])
def test_of_files_of_one_name_the_first_is_read(motionkit, tmp_path, workers):
    folder = tmp_path / "takes"
    folder.mkdir()
    SOURCES["c3d"](folder)
    SOURCES["npz"](folder)
    (folder / "take.bvh").write_text(bvh_text())
    for code, counted in ((0, "stored 1 sequence"), (1, "already there: 1")):
        outcome = motionkit("ingest", folder, "--store", tmp_path / "store", "--workers", workers)
        assert outcome.code == code
        assert counted in outcome.stdout and "failed: 2 (2 duplicate-id)" in outcome.stdout
        assert list(Store.open(tmp_path / "store").sequences["source_path"]) == ["take.bvh"]
    (folder / "take.bvh").write_text(bvh_text()[:-30])
    outcome = motionkit("ingest", folder, "--store", tmp_path / "other", "--workers", workers)
    assert outcome.code == 1 and "failed: 3 (2 duplicate-id, 1 truncated)" in outcome.stdout


def test_the_real_captures(motionkit, captures, tmp_path):
    """Five tools' BVH files at four framerates keep their framerates."""
    outcome = motionkit("ingest", captures / "mixed-bvh", "--store", tmp_path / "store")
    assert outcome.code == 0
    frame = Store.open(tmp_path / "store").sequences
    assert {f"{n}/{d}" for n, d in zip(frame["fps_numerator"], frame["fps_denominator"], strict=True)} == {
        "30/1",
        "100/1",
        "120000/1001",
        "120/1",
    }
    assert motionkit("validate", "--store", tmp_path / "store").code == 0


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


def test_what_is_missing_is_counted_by_dataset(motionkit, amass, humanml3d, tmp_path):
    shutil.rmtree(amass / "CMU")
    with (humanml3d / "index.csv").open("a") as file:
        file.write("./pose_data/KIT/3/broken_poses.npy,0,10,000006.npy\n")
        file.write("./pose_data/KIT/3/kick_poses.npy,200,240,000007.npy\n")
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
    assert told["failed"] == {"missing-file": 2, "not-what-it-says": 1, "beyond-end": 1}
    assert f"{humanml3d}/index.csv, line 4: 000002" in outcome.stderr and "humanml3d/000007" in outcome.stderr
    again = motionkit(*arguments)
    assert "already there: 5" in again.stdout
    assert "KIT: 3 found, 0 missing, 2 failed" in again.stdout.splitlines()
    stopped = motionkit(*arguments, "--on-error", "stop", "--overwrite")
    assert stopped.code == 1


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
