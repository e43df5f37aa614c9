"""UESTC as used by ACTOR: SMPL poses estimated by VIBE from the videos, 40 actions, 118 subjects, 30 fps.

They are published in one Python pickle, which is not loaded here, because a pickle can run code; docs/formats.md shows
how to convert it to one .npz per sequence, `a1_d2_p003_c2_color.npz`, with `pose` [T, 72] (axis–angle vectors of
SMPL's 24 joints in the camera's frame, y down) and optionally `trans` [T, 3] metres and `betas` [T, 10]. Sources:
https://github.com/Mathux/ACTOR, src/datasets/uestc.py (arrays, view rotations, sets); the README of the UESTC RGB-D
database (names, 30 Hz, sides and views).
"""

import re
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.timegrid import TimeGrid
from motionkit.io import npy, source_file
from motionkit.io.body_frame import log_lines, turn_of
from motionkit.io.registry import FileHead, ReadOptions
from motionkit.io.smpl_body import SMPL, posed_skeleton

FPS = Fraction(30)
NUM_BETAS = 10
NAME = re.compile(r"a(?P<action>\d{1,2})_d(?P<view>\d)_p(?P<subject>\d{1,3})_c(?P<side>\d)(_\w+)?", re.IGNORECASE)
FRONT_SIDE = "1"
MOVING_VIEW = 8
_TABLE = source_file.shipped("io/bodies.toml")["uestc"]
TRAIN_SUBJECTS, ACTIONS = frozenset(_TABLE["train_subjects"]), tuple(_TABLE["actions"])
NUM_SUBJECTS = 118
# The camera's y points down and its z away from it.
FROM_CAMERA = turn_of("-y")


def accepts(head: FileHead) -> bool:
    """Whether a file has UESTC's form of name."""
    return NAME.fullmatch(head.path.stem) is not None


def read_uestc(path: Path, options: ReadOptions = ReadOptions()) -> Motion:
    """Read one converted sequence: true local rotations, positions in metres, y up, rotated to the front view.

    The joints are the 22 of SMPL's mean shape, or with `options.body_models` those of the neutral SMPL model with the
    sequence's mean betas. The pelvis is at `trans`, relative to the first frame; without it the pelvis stays in place.
    Action, subject and ACTOR's split come from the name. Raises `FormatError`.
    """
    name = NAME.fullmatch(path.stem)
    if name is None or int(name["action"]) >= len(ACTIONS):
        message = "expected a name such as a1_d2_p003_c2_color with an action from 0 to 39"
        raise FormatError(message, path=path, reason="name")
    subject, view, is_front = int(name["subject"]), int(name["view"]), name["side"] == FRONT_SIDE
    data = source_file.read_bytes(path)
    archive = npy.open_archive(path, data)
    pose = archive.numbers("pose", (None, 3 * SMPL.num_joints))
    num_frames = len(pose)
    betas = np.zeros(NUM_BETAS, np.float32)
    if options.body_models is not None and "betas" in archive:
        betas = archive.numbers("betas", (num_frames, NUM_BETAS)).mean(axis=0)
    skeleton, operations = posed_skeleton(options.body_models, SMPL, SMPL, "neutral", betas)
    if options.body_models is not None:
        operations.append("betas: their mean over the sequence")
    trans = np.zeros((num_frames, 3), np.float32)
    if "trans" in archive:
        trans = archive.numbers("trans", (num_frames, 3))
    else:
        operations.append("no translation in the file: the pelvis stays in place")
    # Side cameras are at multiples of 45 degrees; views of the front and the moving camera are not turned.
    turn = FROM_CAMERA
    if not is_front and view != MOVING_VIEW:
        half = -view * np.pi / 8
        turn = kinematics.quaternion_multiply(turn, np.array([np.cos(half), 0.0, np.sin(half), 0.0], np.float32))
        operations.append(f"turned by {-45 * view}° about the camera's y to the front view")
    operations += log_lines("-y")
    if not is_front and view == MOVING_VIEW:
        operations.append("the camera moves in this view: the heading is relative to it")
    rotations = kinematics.rotation_vector_to_quaternion(pose[:, : 3 * skeleton.num_joints].reshape(num_frames, -1, 3))
    rotations[:, 0] = kinematics.quaternion_multiply(turn, rotations[:, 0])
    root = kinematics.quaternion_rotate(turn, trans)
    fps, lines = source_file.fps_in_use(options.fps, lambda: FPS, who="the data set")
    # The moving camera's view belongs to neither set.
    split = "train" if subject in TRAIN_SUBJECTS else "test"
    if (view == MOVING_VIEW and not is_front) or not 1 <= subject <= NUM_SUBJECTS:
        split = ""
    return Motion(
        joint_positions=kinematics.forward_kinematics(rotations, root, skeleton),
        skeleton=skeleton,
        timegrid=TimeGrid(fps, num_frames),
        local_rotations=rotations,
        root_translation=root,
        action=ACTIONS[int(name["action"])],
        split=split,
        sequence_id=path.stem,
        provenance=source_file.provenance(
            path, data, "uestc", [*operations, *lines], subject=f"p{subject:03}", stated_fps=str(FPS)
        ),
    )
