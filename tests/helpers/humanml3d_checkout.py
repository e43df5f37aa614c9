"""HumanML3D's checkout and the takes of AMASS that its index names, small: what is read shows which frames it is.

Joints stand still but for their height above the floor, which is the frame's number in millimetres.
"""

import json
from pathlib import Path

import numpy as np

import motionkit as mk
from motionkit.core.skeletons.mapping import rest_positions

HEADER = "source_path,start_frame,end_frame,new_name\n"
TEXT = "a person stands#a/DET person/NOUN stand/VERB#0.0#0.0\nthen rises#then/ADV rise/VERB#0.5#1.0\n"

# Folder, file, framerate, frames: known datasets in the spellings of both releases.
TAKES = (
    ("KIT/3", "kick_poses", "100.0", 600),
    ("CMU/CMU/01", "01_01_poses", "120.0", 800),
    ("EyesJapanDataset/yamaoka", "tennis-15-first_service-yamaoka_stageii", "150.0", 1000),
    ("BMLrub/rub110", "0001_treadmill_fast_stageii", "60.0", 400),
    ("Transitions/mazen_c3d", "crawl_stand_stageii", "250.0", 900),
    ("humanact12/humanact12", "P01G01R01F0001T0064A0201", "20", 64),
)
INDEX = (
    "./pose_data/KIT/3/kick_poses.npy,0,117,000000.npy",
    "./pose_data/humanact12/humanact12/P01G01R01F0001T0064A0201.npy,0,-1,000001.npy",
    "./pose_data/CMU/01/01_01_poses.npy,17,117,000002.npy",
    "./pose_data/CMU/01/01_01_poses.npy,117,137,000003.npy",
    "./pose_data/Eyes_Japan_Dataset/yamaoka/tennis-15-first service-yamaoka_poses.npy,3,43,000004.npy",
    "./pose_data/BioMotionLab_NTroje/rub110/0001_treadmill_fast_poses.npy,0,1,009707.npy",
    "./pose_data/Transitions_mocap/mazen_c3d/crawl_stand_poses.npy,20,60,000005.npy",
)
# First native frame and one past the last, worked out by hand.
WINDOWS = {
    "000000": (0, 585),  # step 5
    "000001": (0, 64),
    "000002": (102, 702),  # step 6
    "000003": (702, 800),  # [702, 822) of 800 frames: 17 of 20 published frames are there
    "000004": (441, 721),  # step 7, after 60
    "009707": (0, 3),  # step 3: one published frame
    "000005": (360, 840),  # step 12, after 10
}
FPS = {"000000": 100, "000001": 20, "000002": 120, "000003": 120, "000004": 150, "009707": 60, "000005": 250}


def write_take(path: Path, num_frames: int, num_joints: int = 22) -> None:
    standing = np.zeros((num_frames, num_joints, 3), dtype=np.float32)
    standing[:, :22] = rest_positions(mk.SMPL22)
    standing[:, :, 1] += 1.0 + 1e-3 * np.arange(num_frames, dtype=np.float32)[:, None]
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, standing)


def write_amass_tree(root: Path) -> Path:
    """Takes of several datasets, one that no index names and one that is no array."""
    for folder, name, fps, num_frames in TAKES:
        write_take(root / folder / f"{name}.npy", num_frames, 24 if "humanact12" in folder else 22)
        (root / folder / "motions.json").write_text(json.dumps({"fps": fps}))
    write_take(root / "KIT/3/never_named_poses.npy", 5)
    (root / "KIT/3/broken_poses.npy").write_bytes(b"not an array")
    return root


def write_checkout(folder: Path) -> Path:
    """A checkout of HumanML3D: index, splits, texts."""
    (folder / "texts").mkdir(parents=True)
    (folder / "index.csv").write_text(HEADER + "".join(f"{row}\n" for row in INDEX))
    (folder / "train.txt").write_text("000000\nM000000\n000002\n000003\n")
    (folder / "test.txt").write_text("000004\nM000004\n000005\n")
    for name, (start, stop) in WINDOWS.items():
        text = TEXT if stop - start > 10 else f"{TEXT.splitlines()[0]}\n"
        (folder / "texts" / f"{name}.txt").write_text(text)
        (folder / "texts" / f"M{name}.txt").write_text(text.replace("person", "mirrored person"))
    return folder


def frame_numbers(store: mk.Store, sequence_id: str) -> list[int]:
    height = store.read(sequence_id).joint_positions[:, 0, 1]
    return np.rint((height - 1.0 - rest_positions(mk.SMPL22)[0, 1]) * 1000).astype(int).tolist()
