"""`motionkit ingest ROOT --index …`: native-framerate HumanML3D and its kin from small trees that the tests write."""

import json
import shutil
from pathlib import Path

import pytest

from motionkit.store import Store
from tests.helpers.humanml3d_checkout import (
    FPS,
    WINDOWS,
    frame_numbers,
    write_amass_tree,
    write_checkout,
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
