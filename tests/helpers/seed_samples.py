"""BONES-SEED as it is published, generated: folders, names, columns, labels, splits, SOMA's BVH files.

A file's zero pose has every bone along an axis of its parent's frame, the root is a wrapper at the origin, leaves have
no End Site, units are cm and 120 fps are 0.008333 s (github.com/bones-studio/seed-viewer, nv-tlabs/kimodo's exporter).
"""

import csv
import json
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from motionkit.core.skeleton import Skeleton
from motionkit.io.kimodo import SKELETONS

SOMA = SKELETONS[77]
# Bones of a person in T-pose who looks along z, metres; * is the left, x to the left.
BONES = {
    "Spine1": (0, 0.08, 0), "Spine2": (0, 0.1, 0), "Chest": (0, 0.12, 0), "Neck1": (0, 0.22, 0), "Neck2": (0, 0.05, 0),
    "Head": (0, 0.05, 0), "HeadEnd": (0, 0.18, 0), "Jaw": (0, 0.02, 0.06), "*Eye": (0.03, 0.07, 0.09),
    "*Shoulder": (0.03, 0.16, 0), "*Arm": (0.14, 0.02, 0), "*ForeArm": (0.28, 0, 0), "*Hand": (0.25, 0, 0),
    "*Leg": (0.09, -0.06, 0), "*Shin": (0, -0.42, 0), "*Foot": (0, -0.41, 0), "*ToeBase": (0, -0.07, 0.13),
    "*ToeEnd": (0, 0, 0.07),
}  # fmt: skip
DESCRIPTIONS = (*(f"content_natural_desc_{number}" for number in "1234"), "content_technical_description")
COLUMNS = (
    *("move_name", "filename", "move_duration_frames", "package", "category", "is_neutral", "is_mirror"),
    *("move_soma_uniform_path", "move_soma_uniform_shape_path", "move_soma_proportional_path", "move_g1_path"),
    *("take_date", "content_name", *DESCRIPTIONS, "content_short_description", "content_short_description_2"),
    *("content_uniform_style", "content_type_of_movement", "actor_uid"),
)


def rest_offsets(skeleton: Skeleton = SOMA) -> np.ndarray:
    """[77, 3] bones of the T-pose in metres; fingers are 3 cm a bone."""
    offsets = np.zeros((skeleton.num_joints, 3))
    for joint, name in enumerate(skeleton.joint_names):
        side = -1 if name.startswith("Right") else 1
        plain = name.replace("Left", "*").replace("Right", "*")
        bone = BONES.get(plain, (0.03, 0.0, 0.01 * (len(plain) % 4)) if joint else (0.0, 0.0, 0.0))
        offsets[joint] = np.multiply(bone, (side, 1, 1))
    return offsets


def soma_motion(num_frames: int = 48, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Root [T, 3], world rotations [T, 77, 3, 3] and joints [T, 77, 3] of a person who sways and turns, metres."""
    rng, share = np.random.default_rng(seed), np.linspace(0, 1, num_frames)[:, None]
    offsets, world, joints = rest_offsets(), np.zeros((num_frames, 77, 3, 3)), np.zeros((num_frames, 77, 3))
    joints[:, 0] = np.concatenate([2 * share, 0.95 + 0 * share, share], axis=1)
    world[:, 0] = Rotation.from_rotvec(share * [0, 1, 0]).as_matrix()
    for joint, above in enumerate(SOMA.parents[1:], start=1):
        turns = Rotation.from_rotvec(0.2 * np.sin(6 * share) * rng.uniform(-1, 1, 3)).as_matrix()
        world[:, joint] = world[:, above] @ turns
        joints[:, joint] = joints[:, above] + world[:, above] @ offsets[joint]
    return joints[:, 0], world, joints


def _turn_of_y(bone: np.ndarray) -> np.ndarray:
    across = np.cross([0.0, 1.0, 0.0], bone)
    angle = np.arctan2(np.linalg.norm(across), bone[1])
    axis = across / np.linalg.norm(across) if across.any() else np.array([0.0, 0.0, 1.0])
    return Rotation.from_rotvec(angle * axis).as_matrix()


def soma_bvh(root: np.ndarray, world: np.ndarray) -> str:
    """The file of root positions [T, 3], metres, and world rotations [T, 77, 3, 3] relative to the T-pose."""
    offsets, parents = rest_offsets(), SOMA.parents
    children = [[child for child, parent in enumerate(parents) if parent == joint] for joint in range(len(parents))]
    # A joint's own axes: y along its first bone.
    axes = [_turn_of_y(offsets[below[0]]) if below else np.eye(3) for below in children]
    own = world @ np.array(axes)
    lines, columns = (
        ["HIERARCHY", "ROOT Root", "{", "OFFSET 0 0 0", f"CHANNELS 6 {PLACE} {TURN}"],
        [np.zeros((len(root), 6))],
    )

    def joint_lines(joint: int) -> None:
        above = parents[joint]
        offset = 100 * (axes[above].T @ offsets[joint] if joint else np.array([0.0, 95.0, 0.0]) / 100)
        channels = f"6 {PLACE} {TURN}" if joint == 0 else f"3 {TURN}"
        lines.extend(
            (f"JOINT {SOMA.joint_names[joint]}", "{", "OFFSET " + " ".join(f"{value:.6f}" for value in offset),
             f"CHANNELS {channels}")
        )  # fmt: skip
        local = own[:, joint] if joint == 0 else own[:, above].swapaxes(-1, -2) @ own[:, joint]
        columns.extend([100 * root] if joint == 0 else [])
        columns.append(Rotation.from_matrix(local).as_euler("ZYX", degrees=True))
        for child in children[joint]:
            joint_lines(child)
        lines.append("}")

    joint_lines(0)
    rows = np.concatenate(columns, axis=1)
    lines += ["}", "MOTION", f"Frames: {len(root)}", "Frame Time: 0.008333"]
    lines += [" ".join(f"{value:.6f}" for value in row) for row in rows]
    return "\n".join(lines) + "\n"


PLACE, TURN = "Xposition Yposition Zposition", "Zrotation Yrotation Xrotation"


def seed_row(name: str, **cells: object) -> dict[str, object]:
    """A row of the metadata; mirrored if the name ends in _M."""
    return {
        "move_name": name, "filename": name, "is_mirror": name.endswith("_M"), "package": "Locomotion",
        "category": "Basic Locomotion Neutral", "take_date": "240101", "actor_uid": "A001",
        "move_soma_uniform_path": f"soma_uniform/bvh/240101/{name}.bvh",
        "move_soma_proportional_path": f"soma_proportional/bvh/240101/{name}.bvh",
        "move_g1_path": f"g1/csv/240101/{name}.csv", "content_natural_desc_1": "A person walks forward.",
        "content_natural_desc_2": "Someone strolls ahead, relaxed.", "content_short_description": "walk forward",
        "content_uniform_style": "neutral", "content_type_of_movement": "walking", **cells,
    }  # fmt: skip


def write_seed(folder: Path, rows: list[dict[str, object]], events: dict[str, list[dict[str, object]]]) -> Path:
    """The metadata, labels and Kimodo's splits; a row's `split` says in which of them it is. Returns the metadata."""
    (folder / "metadata").mkdir(parents=True)
    (folder / "splits").mkdir()
    path = folder / "metadata" / "seed_metadata_v004.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    labels = folder / "metadata" / "seed_metadata_v002_temporal_labels.jsonl"
    lines = (json.dumps({"filename": name, "events": of_name}) for name, of_name in events.items())
    labels.write_text("".join(f"{line}\n" for line in lines))
    for split in ("train", "test_content", "test_repetition"):
        names = [f"{row['take_date']}/{row['filename']}\n" for row in rows if row.get("split") == split]
        (folder / "splits" / f"{split}_split_paths.txt").write_text("".join(names))
    return path


# A robot that stands for 40 frames, as Kimodo writes it.
G1_STANDS = f"{','.join(['0,0,0.79,1', *'0' * 32])}\n" * 40
