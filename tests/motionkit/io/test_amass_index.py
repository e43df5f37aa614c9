"""Native-framerate HumanML3D from AMASS files that the tests write: in both generations' layouts, at odd framerates."""

from pathlib import Path

import numpy as np
import pytest

from motionkit.core.kinematics import forward_kinematics
from motionkit.core.motion import Motion
from motionkit.edit.export import Selection, export, export_kinds
from motionkit.features import humanml3d
from motionkit.io.amass import read_amass
from motionkit.io.registry import IndexOptions, ReadOptions, SourceItem
from motionkit.store import Store
from motionkit.store.ingest import ingest
from tests.helpers.amass_samples import smplh_fields, stageii_fields, write_amass

HEADER = "source_path,start_frame,end_frame,new_name\n"
# The store keeps numbers on a grid of 2^-22.
STORED = 2.0**-22
TRIMS = {"Eyes_Japan_Dataset": 60, "MPI_HDM05": 60}

# File below AMASS, frames, what it states, its path in the index, published frames; step and true rate, by hand.
CLIPS = (
    ("KIT/3/kick_poses.npz", 500, 100.0, "KIT/3/kick", (3, 63), 5, 100),
    ("SFU/0005/jog_stageii.npz", 700, 120.00004577636719, "SFU/0005/jog", (10, 60), 6, 120),
    ("BMLrub/rub1/walk_stageii.npz", 300, 59.9999885, "BioMotionLab_NTroje/rub1/walk", (5, 105), 2, 60),
    ("EyesJapanDataset/a/b_c-d_stageii.npz", 700, 59.94, "Eyes_Japan_Dataset/a/b  c-d", (5, 105), 2, "60000/1001"),
    ("MPI_HDM05/mm/x_poses.npz", 1000, 150.0, "MPI_HDM05/mm/x", (7, 27), 7, 150),
)


@pytest.fixture(scope="module")
def amass(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("amass")
    rng = np.random.default_rng(0)
    rows = []
    for number, (name, num_frames, stated, indexed, (start, end), _, _) in enumerate(CLIPS):
        time = np.arange(num_frames)[:, None] / stated
        poses = np.zeros((num_frames, 165 if "stageii" in name else 156))
        poses[:, 0] = np.pi / 2
        poses[:, 3:66] = 0.4 * np.sin(time * rng.uniform(1, 5, 63) + rng.uniform(0, 6, 63))
        trans = np.stack((time[:, 0], 0.3 * time[:, 0], np.ones(num_frames)), axis=1)
        if "stageii" in name:
            parts = {"root_orient": poses[:, :3], "pose_body": poses[:, 3:66], "pose_hand": poses[:, 75:]}
            fields = stageii_fields(num_frames, poses=poses, trans=trans, mocap_frame_rate=np.array(stated), **parts)
        else:
            fields = smplh_fields(num_frames, poses=poses, trans=trans, mocap_framerate=np.array(stated))
        write_amass(root / name, fields)
        rows.append(f"./pose_data/{indexed}_poses.npy,{start},{end},{number:06}.npy\n")
    (root / "index.csv").write_text(HEADER + "".join(rows))
    return root


@pytest.fixture(scope="module")
def stores(amass: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[bool, Store]:
    """Native and published clips, mirrored ones among them."""
    found = {}
    for published in (False, True):
        index = IndexOptions((amass / "index.csv",), mirrored=True, published=published)
        path = tmp_path_factory.mktemp("store") / "s"
        report = ingest([amass], path, options=ReadOptions(index=index), num_workers=1)
        assert (report.problems, report.stored.num_sequences) == ((), 2 * len(CLIPS))
        found[published] = Store.open(path)
    return found


def whole(amass: Path, name: str) -> Motion:
    return read_amass(SourceItem("amass", amass / name, amass, "whole"), ReadOptions())


@pytest.mark.parametrize("number", range(len(CLIPS)))
def test_native_clips_are_the_files_own_frames(amass, stores, number):
    name, _, stated, indexed, (start, end), step, fps = CLIPS[number]
    clip = stores[False].read(f"humanml3d/{number:06}")
    trim = TRIMS.get(indexed.split("/")[0], 0)
    frames = slice((trim + start) * step, (trim + end) * step)
    file = whole(amass, name)
    assert str(clip.fps) == str(fps)
    assert clip.provenance.stated_fps == str(stated)
    for name in ("joint_positions", "local_rotations", "root_translation"):
        np.testing.assert_allclose(getattr(clip, name), getattr(file, name)[frames], rtol=0, atol=STORED)
    assert clip.num_frames == (end - start) * step


def as_published(amass: Path, name: str, dataset: str, start: int, end: int) -> np.ndarray:
    """The steps of raw_pose_processing.ipynb, word by word, on joints as they stand in AMASS: z up."""
    motion = whole(amass, name)
    x, y, z = np.moveaxis(motion.joint_positions, -1, 0)
    z_up = np.stack((x, -z, y), axis=-1)
    joints = z_up[:: int(float(motion.provenance.stated_fps) / 20)]
    joints = joints @ np.float32([[1, 0, 0], [0, 0, 1], [0, 1, 0]])
    joints = joints[TRIMS.get(dataset, 0) :][start:end].copy()
    joints[..., 0] *= -1
    return joints


@pytest.mark.parametrize("number", range(len(CLIPS)))
def test_published_clips_are_the_notebooks_up_to_the_heading_that_processing_removes(amass, stores, number):
    name, _, _, indexed, (start, end), _, _ = CLIPS[number]
    clip = stores[True].read(f"humanml3d-20fps/{number:06}")
    expected = as_published(amass, name, indexed.split("/")[0], start, end)
    assert (clip.fps, clip.num_frames) == (20, end - start)
    # Both are turns of the file's z-up joints, half a turn about y apart; neither swaps left and right.
    np.testing.assert_allclose(clip.joint_positions, expected * np.float32([-1, 1, -1]), atol=1e-6)
    ours, theirs = (humanml3d.process(joints, "smpl22") for joints in (clip.joint_positions, expected))
    np.testing.assert_allclose(ours, theirs, atol=1e-5)
    left_hip = ours[0, 1] - ours[0, 0]
    assert left_hip[0] > 0  # faces Z+ with its left at X+


@pytest.mark.parametrize("number", range(len(CLIPS)))
def test_mirrored_clips_move_by_mirrored_rotations(stores, number):
    plain, mirrored = (stores[False].read(f"humanml3d/{letter}{number:06}") for letter in ("", "M"))
    pairs = plain.skeleton.left_right_pairs
    order = np.arange(22)
    for left, right in pairs:
        order[left], order[right] = right, left
    np.testing.assert_array_equal(mirrored.joint_positions, plain.joint_positions[:, order] * np.float32([-1, 1, 1]))
    again = forward_kinematics(mirrored.local_rotations, mirrored.root_translation, mirrored.skeleton)
    np.testing.assert_allclose(again, mirrored.joint_positions, atol=1e-5)


def test_published_clips_exported_are_the_published_folder(amass, stores, tmp_path):
    """What the notebooks write from the same joints: names, poses, the 263 numbers."""
    export(Selection(stores[True], stores[True].select(None)), tmp_path / "out", export_kinds()["humanml3d"])
    for number, (name, _, _, indexed, (start, end), _, _) in enumerate(CLIPS):
        raw = as_published(amass, name, indexed.split("/")[0], start, end)
        vectors = humanml3d.vectors(humanml3d.process(raw, "smpl22"), "smpl22")
        written = np.load(tmp_path / f"out/new_joint_vecs/{number:06}.npy")
        assert written.shape == (end - start - 1, 263)
        np.testing.assert_allclose(written, vectors, atol=2e-5)
        assert (tmp_path / f"out/new_joints/M{number:06}.npy").is_file()
