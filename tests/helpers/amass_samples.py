"""AMASS files as published, written by the tests: poses of a body that stands, z up, and turns its head to +x."""

from pathlib import Path

import numpy as np

from motionkit.core.motion import Motion
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import read, scan
from motionkit.io.smpl_body import PoseLayout

WIDTHS = {"smpl": 72, "smplh": 156, "smplx": 165}


def standing_poses(num_frames: int = 4, width: int = 156) -> np.ndarray:
    """Upright and facing −y in z-up coordinates, as SMPL's y-up rest pose is after a quarter turn about x."""
    poses = np.zeros((num_frames, width))
    poses[:, 0] = np.pi / 2
    return poses


def smplh_fields(num_frames: int = 4, width: int = 156, **changes: object) -> dict[str, object]:
    """Arrays of the first generation: X_poses.npz."""
    fields: dict[str, object] = {
        "trans": np.tile([0.5, 2.0, 1.2], (num_frames, 1)),
        "gender": np.array("female"),
        "mocap_framerate": np.array(120.0),
        "betas": np.linspace(-1, 1, 16),
        "dmpls": np.zeros((num_frames, 8)),
        "poses": standing_poses(num_frames, width),
    }
    return _changed(fields, changes)


def stageii_fields(num_frames: int = 4, **changes: object) -> dict[str, object]:
    """Arrays of the second generation: X_stageii.npz."""
    poses = standing_poses(num_frames, 165)
    fields: dict[str, object] = {
        "gender": np.array("neutral"),
        "surface_model_type": np.array("smplx"),
        "mocap_frame_rate": np.array(120.00004577636719),
        "mocap_time_length": np.array(num_frames / 120.0),
        "markers_latent": np.zeros((53, 3)),
        "latent_labels": np.array(["ARIEL", "C7"]),
        "markers_latent_vids": np.array({"ARIEL": 411, "C7": 2877}, dtype=object),
        "trans": np.tile([0.5, 2.0, 1.2], (num_frames, 1)),
        "poses": poses,
        "betas": np.linspace(-1, 1, 16),
        "num_betas": np.array(16),
        "root_orient": poses[:, :3],
        "pose_body": poses[:, 3:66],
        "pose_hand": poses[:, 75:],
        "pose_jaw": poses[:, 66:69],
        "pose_eye": poses[:, 69:75],
    }
    return _changed(fields, changes)


def _changed(fields: dict[str, object], changes: dict[str, object]) -> dict[str, object]:
    return {key: value for key, value in (fields | changes).items() if value is not None}


def write_amass(path: Path, fields: dict[str, object], *, compressed: bool = False) -> Path:
    """An .npz file of these arrays; objects are pickled, as in the published files."""
    path.parent.mkdir(parents=True, exist_ok=True)
    (np.savez_compressed if compressed else np.savez)(path, **fields, allow_pickle=True)  # type: ignore[arg-type]
    return path


def read_one(folder: Path, options: ReadOptions | None = None) -> Motion:
    """The one motion of a folder."""
    found = scan([folder], options)
    assert not found.problems
    (item,) = found.items
    return read(item, options)


NUM_VERTICES = {"smplh": 6890, "smplx": 10475}
NUM_DIRECTIONS = {"smplh": 300, "smplx": 400}


def write_body_model(path: Path, layout: PoseLayout, seed: int = 0, **changes: object) -> Path:
    """A body of random vertices that has what `smplx` asks for; its joints are means of a few vertices."""
    rng = np.random.default_rng(seed)
    vertices, joints = NUM_VERTICES.get(layout.family, 40), layout.num_joints
    regressor = np.zeros((joints, vertices), np.float32)
    for row in regressor:
        row[rng.choice(vertices, 6, replace=False)] = 1 / 6
    fields: dict[str, object] = {
        "v_template": rng.normal(0, 0.5, (vertices, 3)),
        "shapedirs": rng.normal(0, 0.05, (vertices, 3, NUM_DIRECTIONS.get(layout.family, 10))).astype(np.float32),
        "J_regressor": regressor,
        "kintree_table": np.stack((np.array([2**32 - 1, *layout.parents[1:]]), np.arange(joints))).astype(np.uint32),
        "f": np.zeros((1, 3), np.uint32),
        "posedirs": np.zeros((vertices, 3, 9 * (joints - 1)), np.float16),
        "weights": np.full((vertices, joints), 1 / joints, np.float32),
        "lmk_faces_idx": np.zeros(51, np.int64),
        "lmk_bary_coords": np.zeros((51, 3)),
    }
    for side in "lr":
        fields |= {f"hands_mean{side}": np.zeros(45), f"hands_components{side}": np.eye(45)}
    return write_amass(path, fields | changes)
