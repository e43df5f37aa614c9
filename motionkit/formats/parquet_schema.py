"""The columns of a Parquet file whose rows are motions, what they mean, and a motion as such a row."""

from dataclasses import astuple
from typing import Any

import numpy as np
import pyarrow as pa

from motionkit.motion import Motion


def _list(kind: Any) -> Any:
    return pa.list_(pa.field("element", kind, nullable=False))


CAPTION = pa.struct(
    [
        pa.field("text", pa.string()),
        pa.field("start_seconds", pa.float64()),
        pa.field("end_seconds", pa.float64()),
        pa.field("tokens", pa.string()),
    ]
)
SCHEMA = pa.schema(
    [
        ("sequence_id", pa.string()),
        ("joint_positions", _list(pa.float32())),
        ("local_rotations", _list(pa.float32())),
        ("root_translation", _list(pa.float32())),
        ("num_frames", pa.int32()),
        ("num_joints", pa.int32()),
        ("fps", pa.float64()),
        ("fps_numerator", pa.int64()),
        ("fps_denominator", pa.int64()),
        ("start_seconds", pa.float64()),
        ("duration_seconds", pa.float64()),
        ("captions", _list(CAPTION)),
        ("action", pa.string()),
        ("style", pa.string()),
        ("split", pa.string()),
        ("subject", pa.string()),
        ("source", pa.string()),
        ("subset", pa.string()),
        ("licence", pa.string()),
        ("stated_fps", pa.string()),
        ("operations", _list(pa.string())),
        ("skeleton", pa.string()),
        ("joint_names", _list(pa.string())),
        ("parents", _list(pa.int32())),
        ("offsets", _list(pa.float32())),
        ("left_right_pairs", _list(pa.int32())),
        ("feet", _list(pa.int32())),
        ("end_site_joints", _list(pa.int32())),
        ("end_site_offsets", _list(pa.float64())),
        ("layout_map", pa.string()),
    ]
)
MOTION_COLUMNS = ("joint_positions", "local_rotations", "root_translation")
MEANING = {
    "joint_positions": "metres, y up; reshape to [num_frames, num_joints, 3]",
    "local_rotations": "unit quaternions (w, x, y, z) relative to the parent; [num_frames, num_joints, 4]; null where "
    "the source has none",
    "root_translation": "metres; [num_frames, 3]; null where the source has none",
    "fps": "framerate; exactly fps_numerator / fps_denominator",
    "start_seconds": "time of the first frame; frame k is at start_seconds + k / fps",
    "captions": "text, start_seconds, end_seconds (null: to the end), tokens (word/POS)",
    "stated_fps": "what the source said of its framerate, verbatim",
    "operations": "what was done to the motion since its source file, oldest first",
    "joint_names": "the skeleton's joints, the root first",
    "parents": "index of each joint's parent, −1 for the root",
    "offsets": "metres; rest position relative to the parent; [num_joints, 3]",
    "left_right_pairs": "[pairs, 2], joints that are mirror images",
    "feet": "left ankle, left toe, right ankle, right toe; empty where they are not known",
    "end_site_offsets": "metres; tips of the joints in end_site_joints; [tips, 3]",
    "layout_map": "the user's own table of how the skeleton becomes the 22 joints of SMPL, as JSON; empty without one",
}


def row_of(motion: Motion) -> dict[str, Any]:
    """A motion as a row of `SCHEMA`."""
    skeleton, provenance = motion.skeleton, motion.provenance
    return {
        "sequence_id": motion.sequence_id,
        "joint_positions": motion.joint_positions.ravel(),
        "local_rotations": None if motion.local_rotations is None else motion.local_rotations.ravel(),
        "root_translation": None if motion.root_translation is None else motion.root_translation.ravel(),
        "num_frames": motion.num_frames,
        "num_joints": skeleton.num_joints,
        "fps": float(motion.fps),
        "fps_numerator": motion.fps.numerator,
        "fps_denominator": motion.fps.denominator,
        "start_seconds": motion.timegrid.start_seconds,
        "duration_seconds": motion.duration_seconds,
        "captions": [
            {name: getattr(caption, name) for name in ("text", "start_seconds", "end_seconds", "tokens")}
            for caption in motion.captions
        ],
        "action": motion.action,
        "style": motion.style,
        "split": motion.split,
        "subject": provenance.subject,
        "source": provenance.source,
        "subset": provenance.subset,
        "licence": provenance.licence,
        "stated_fps": provenance.stated_fps,
        "operations": list(provenance.operations),
        "skeleton": skeleton.name,
        "joint_names": list(skeleton.joint_names),
        "parents": list(skeleton.parents),
        "offsets": np.asarray(skeleton.offsets, np.float32).ravel(),
        "left_right_pairs": [joint for pair in skeleton.left_right_pairs for joint in pair],
        "feet": [] if skeleton.feet is None else list(astuple(skeleton.feet)),
        "end_site_joints": [joint for joint, _ in skeleton.end_sites],
        "end_site_offsets": [value for _, offset in skeleton.end_sites for value in offset],
        "layout_map": skeleton.layout_map,
    }
