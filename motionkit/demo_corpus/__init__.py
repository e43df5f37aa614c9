"""The embedded demo corpus: 120 cuts of the CMU motion capture database at 120, 60, 30 and 20 fps.

`corpus.parquet` has a row per sequence, written by `python -m benchmarks.pack_demo_corpus`: its labels, its skeleton,
local rotations as rotation vectors in steps of π / 32,767 rad (int16) and root positions in steps of 0.05 mm (int32).
Both arrays hold all frames of one component after another. NOTICE has the terms and the acknowledgement.
"""

import csv
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core.kinematics import forward_kinematics, rotation_vector_to_quaternion
from motionkit.core.motion import Caption, Motion, Provenance
from motionkit.core.skeleton import Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.io.bvh import write_bvh

FOLDER = Path(__file__).parent
RADIANS_PER_STEP = np.pi / 32767
METRES_PER_STEP = 0.00005
LICENCE = "CMU mocap database: free to use and share, not to resell; acknowledge mocap.cs.cmu.edu, NSF EIA-0196217"


def read_demo_corpus(names: Sequence[str] = ()) -> list[Motion]:
    """All motions in the corpus's order, or those with the given names. Raises `KeyError` for an unknown name."""
    import pyarrow.parquet as pq  # deferred: the import takes a tenth of a second

    table = pq.read_table(FOLDER / "corpus.parquet")
    row_of = {name: row for row, name in enumerate(table["name"].to_pylist())}
    return [_motion({column: table[column][row_of[name]] for column in table.column_names}) for name in names or row_of]


def write_demo_corpus(folder: Path, every: int = 1) -> list[Motion]:
    """Write every n-th motion as a BVH file, with `clips.csv` and `LICENSE` beside them; returns those motions."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "LICENSE").write_text(f"{LICENCE}\n\n{(FOLDER / 'NOTICE').read_text(encoding='utf-8')}", encoding="utf-8")
    motions = read_demo_corpus()[::every]
    with (folder / "clips.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(("file", "fps", "action", "subject", "caption", "split"))
        for motion in motions:
            write_bvh(motion, folder / f"{motion.sequence_id}.bvh")
            labels = (motion.action, motion.provenance.subject, motion.captions[0].text, motion.split)
            table.writerow((f"{motion.sequence_id}.bvh", motion.fps, *labels))
    return motions


def _motion(row: dict[str, Any]) -> Motion:
    name, fps, subject, caption = (row[column].as_py() for column in ("name", "fps", "subject", "caption"))
    parents = tuple(row["parents"].as_py())
    leaves = sorted(set(range(len(parents))) - set(parents))
    tips = row["tips"].values.to_numpy().reshape(-1, 3).tolist()
    skeleton = Skeleton(
        name=subject,
        joint_names=tuple(row["joint_names"].as_py()),
        parents=parents,
        offsets=row["offsets"].values.to_numpy().reshape(-1, 3),
        end_sites=tuple((leaf, tuple(tip)) for leaf, tip in zip(leaves, tips, strict=True)),
    )
    root = (row["root"].values.to_numpy().reshape(3, -1).T * METRES_PER_STEP).astype(np.float32)
    vectors = row["rotations"].values.to_numpy().reshape(len(parents), 3, -1).transpose(2, 0, 1) * RADIANS_PER_STEP
    rotations = rotation_vector_to_quaternion(vectors).astype(np.float32)
    return Motion(
        joint_positions=forward_kinematics(rotations, root, skeleton),
        skeleton=skeleton,
        timegrid=TimeGrid(Fraction(fps), len(root)),
        local_rotations=rotations,
        root_translation=root,
        captions=(Caption(caption),),
        action=row["action"].as_py(),
        split=row["split"].as_py(),
        sequence_id=name,
        provenance=Provenance(
            source="cmu", source_path=row["source_path"].as_py(), licence=LICENCE, subject=subject, stated_fps=str(fps)
        ),
    )
