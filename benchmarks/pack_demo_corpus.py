"""Pack motionkit/demo_corpus/corpus.parquet from the cuts that pack_demo_corpus.csv lists.

    python -m benchmarks.pack_demo_corpus CAPTURES       # the folder that holds `cmu` and `cmu-more`

A cut is frames [start_frame, stop_frame) of an AMC file, every n-th of them where its `fps` is a part of the file's.
Captions are CMU's descriptions. Fingers are left out. The same captures give the same bytes. Prints the size, and how
far the packed joints are from the captured ones.
"""

import csv
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.command import arguments_parser, print_json
from motionkit.core.kinematics import quaternion_to_rotation_vector
from motionkit.core.motion import Motion
from motionkit.core.skeleton import Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.demo_corpus import FOLDER, METRES_PER_STEP, RADIANS_PER_STEP, read_demo_corpus
from motionkit.io.asfamc import read_asfamc
from motionkit.io.registry import ReadOptions

SCHEMA = pa.schema(
    [
        *((column, pa.string()) for column in ("name", "subject", "action", "caption", "split", "source_path")),
        ("fps", pa.int16()),
        ("joint_names", pa.list_(pa.string())),
        ("parents", pa.list_(pa.int8())),
        ("offsets", pa.list_(pa.float32())),
        ("tips", pa.list_(pa.float32())),
        ("rotations", pa.list_(pa.int16())),
        ("root", pa.list_(pa.int32())),
    ]
)
FINGERS = ("lfingers", "lthumb", "rfingers", "rthumb")


def read_table(path: Path) -> list[dict[str, str]]:
    """The rows of a CSV file."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def decimated(motion: Motion, fps: int) -> Motion:
    """Every n-th frame of a motion. Raises `ValueError` if `fps` is no whole part of the motion's framerate."""
    step = motion.fps / fps
    if step.denominator != 1:
        raise ValueError(f"{motion.sequence_id}: {fps} fps is no whole part of {motion.fps} fps")
    frames = slice(None, None, int(step))
    assert motion.local_rotations is not None and motion.root_translation is not None
    return replace(
        motion,
        joint_positions=motion.joint_positions[frames],
        local_rotations=motion.local_rotations[frames],
        root_translation=motion.root_translation[frames],
        timegrid=TimeGrid(Fraction(fps), len(motion.joint_positions[frames])),
    )


def packed(motion: Motion) -> dict[str, Any]:
    """The columns of a motion's frames and skeleton, without fingers."""
    skeleton, joints = motion.skeleton, body(motion.skeleton)
    assert motion.local_rotations is not None and motion.root_translation is not None
    vectors = quaternion_to_rotation_vector(motion.local_rotations[:, joints].astype(np.float64))
    parents = [skeleton.parents[joint] for joint in joints]
    tips = dict(skeleton.end_sites) | {
        skeleton.parents[joint]: skeleton.offsets[joint] for joint in map(skeleton.index, ("lfingers", "rfingers"))
    }
    leaves = [joint for joint in joints if joint not in parents]
    return {
        "joint_names": [skeleton.joint_names[joint] for joint in joints],
        "parents": [-1, *(joints.index(parent) for parent in parents[1:])],
        "offsets": skeleton.offsets[joints].ravel(),
        "tips": np.array([tips[joint] for joint in leaves], np.float32).ravel(),
        "rotations": np.round(vectors.transpose(1, 2, 0) / RADIANS_PER_STEP).astype(np.int16).ravel(),
        "root": np.round(motion.root_translation.T / METRES_PER_STEP).astype(np.int32).ravel(),
    }


def body(skeleton: Skeleton) -> list[int]:
    """Indices of all joints but the fingers'."""
    return [joint for joint, name in enumerate(skeleton.joint_names) if name not in FINGERS]


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("captures", type=Path)
    captures = parser.parse_args().captures
    cuts = read_table(Path(__file__).with_suffix(".csv"))
    described = {
        f"{corpus}/{row['file']}": row
        for corpus in ("cmu", "cmu-more")
        for row in read_table(captures / corpus / "takes.csv")
    }
    motions = []
    for row in cuts:
        options = ReadOptions(fps=Fraction(described[row["file"]]["fps"]))
        whole = read_asfamc(captures / row["file"], options)
        motions.append(decimated(whole.frames(int(row["start_frame"]), int(row["stop_frame"])), int(row["fps"])))
    rows = [
        {
            "name": row["name"],
            "subject": f"cmu-{motion.skeleton.name}",
            "fps": int(row["fps"]),
            "action": row["action"],
            "caption": described[row["file"]]["caption"],
            "split": row["split"],
            "source_path": f"{Path(row['file']).name}, frames {row['start_frame']} to {row['stop_frame']}",
            **packed(motion),
        }
        for row, motion in zip(cuts, motions, strict=True)
    ]
    path = FOLDER / "corpus.parquet"
    encodings = dict.fromkeys(("rotations.list.element", "root.list.element"), "DELTA_BINARY_PACKED")
    pq.write_table(
        pa.Table.from_pylist(rows, SCHEMA),
        path,
        compression="zstd",
        compression_level=19,
        use_dictionary=["subject", "action", "joint_names.list.element"],
        column_encoding=encodings,
    )
    errors = [
        1000 * np.linalg.norm(read.joint_positions - motion.joint_positions[:, body(motion.skeleton)], axis=-1)
        for motion, read in zip(motions, read_demo_corpus(), strict=True)
    ]
    print_json(
        {
            "bytes": path.stat().st_size,
            "sequences": len(motions),
            "performers": len({motion.skeleton.name for motion in motions}),
            "minutes": sum(motion.duration_seconds for motion in motions) / 60,
            "frames": sum(motion.num_frames for motion in motions),
            "mean_error_mm": float(np.concatenate(errors).mean()),
            "max_error_mm": float(max(error.max() for error in errors)),
        }
    )


if __name__ == "__main__":
    main()
