"""A folder of HumanML3D's or KIT-ML's form at any framerate: processed joints, pose vectors, texts, splits, Mean, Std.

The published pipeline runs on every clip: resampled (anti-aliased), mapped to the layout, one skeleton, floor, origin,
facing Z+, pose vectors, and joints recovered from them. T poses at the new framerate give T − 1 rows of both, as
published. Source: https://github.com/EricGuo5513/HumanML3D, motion_representation.ipynb.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path, PurePosixPath

import numpy as np

from motionkit.core.files import write_json
from motionkit.core.framerate import format_fps
from motionkit.core.motion import Motion
from motionkit.core.skeletons.mapping import SkeletonMapError, map_joints
from motionkit.edit.export.files import Outcome, Selection, file_names, motion_table, render
from motionkit.features import humanml3d
from motionkit.io import joints_npy
from motionkit.io.humanml3d import HUMANML3D, JOINTS_FOLDER, KIT, LAYOUTS, Entry, FolderWriter, Layout
from motionkit.io.texts import SPLITS

README = "README.md"
MIN_POSES = 2
MISSING = {
    "captions": "without a caption: texts/ has nothing of them, and loaders of texts pass them over; captions come "
    "from a table: 'motionkit ingest SOURCE --captions captions.csv --overwrite --store {store}'",
    "split": "in no split: train.txt, val.txt and test.txt lack them; 'motionkit split --store {store}' makes some",
    "length": "shorter than the usual data loader takes (40 frames, for kit 24): it drops them without a word",
}
"""What motions of such a folder may lack, the consequence, and the remedy."""


@dataclass(frozen=True)
class Kind:
    """A published data set: its layout, the number of its units per unit of the layout's skeleton, and its loader.

    `loader_min_frames` is the minimum of text-to-motion's data loader, which silently drops shorter clips.
    """

    layout: Layout
    units_per_skeleton_unit: float
    loader_min_frames: int

    def at(self, fps: Fraction) -> "Kind":
        """The same at another framerate."""
        return replace(self, layout=replace(self.layout, fps=fps))


# 22 joints in metres and vectors of 263 numbers; 21 joints in thousandths of the body's height and vectors of 251.
HUMANML3D_KIND = Kind(HUMANML3D, 1.0, 40)
KIT_KIND = Kind(KIT, 1000.0, 24)


def export_pose_folder(selection: Selection, folder: Path, kind: Kind) -> Iterator[Outcome]:
    """Write a folder of the published form at the selection's framerate; yields the outcome of each sequence."""
    (fps,) = selection.framerates
    kind = kind.at(fps)
    names = [name.name for name in file_names(selection.sequence_ids)]
    if len(set(names)) < len(names):
        names = list(map(str, file_names(selection.sequence_ids, flat=True)))
    writer = FolderWriter(folder, kind.layout)
    lacks: Counter[str] = Counter()
    with motion_table(folder) as add_row:
        for motion, name in zip(selection.motions(), names, strict=True):
            entry = pose_entry(motion, name, kind)
            if isinstance(entry, Outcome):
                yield entry
                continue
            writer.add(entry)
            add_row(motion, PurePosixPath(JOINTS_FOLDER, f"{name}.npy"))
            is_missing = {
                "captions": not entry.captions,
                "split": entry.split not in SPLITS,
                "length": len(entry.joint_positions) < kind.loader_min_frames,
            }
            outcome = Outcome(motion.sequence_id, lacks=tuple(what for what, missing in is_missing.items() if missing))
            lacks.update(outcome.lacks)
            yield outcome
    num_sequences, layout, published = writer.finish(), kind.layout, LAYOUTS[kind.layout.name].fps
    write_folder_manifest(folder, layout)
    text = render(
        "pose_folder.md.j2",
        layout=layout,
        fps=f"{float(layout.fps):.6g}",
        published_fps=f"{float(published):.6g}",
        is_published=layout.fps == published,
        smoothing_seconds=float(Fraction(humanml3d.SMOOTHING_FRAMES) / layout.fps),
        num_sequences=num_sequences,
        loader_min_frames=kind.loader_min_frames,
        lacks=lacks,
    )
    (folder / README).write_text(text, encoding="utf-8")


def pose_entry(motion: Motion, name: str, kind: Kind) -> Entry | Outcome:
    """A motion's processed joints and pose vectors at its own framerate, T − 1 rows each, or the reason for none."""
    layout = kind.layout.skeleton.name
    if motion.num_frames < MIN_POSES:
        message = f"{motion.num_frames} pose at {format_fps(motion.fps)} fps; pose vectors need at least {MIN_POSES}"
        return Outcome(motion.sequence_id, "too-short", message)
    try:
        joints = map_joints(motion, layout)
    except SkeletonMapError as error:
        return Outcome(motion.sequence_id, "skeleton", str(error))
    target = humanml3d.standard_bone_lengths(layout) * np.float32(kind.units_per_skeleton_unit)
    with np.errstate(divide="ignore", invalid="ignore"):
        vectors = humanml3d.vectors(humanml3d.process(joints, layout, target), layout)
    if not np.isfinite(vectors).all():
        return Outcome(motion.sequence_id, "degenerate", "the legs of frame 0 have no length: nothing says the scale")
    return Entry(name, humanml3d.positions(vectors, layout), vectors, motion.captions, motion.split)


def write_folder_manifest(folder: Path, layout: Layout) -> None:
    """Write motions.json: framerate, layout and unit for readers, the convention and its published framerate."""
    manifest = {
        "fps": format_fps(layout.fps),
        "layout": layout.skeleton.name,
        "unit_metres": layout.unit_metres,
        "vectors": humanml3d.CONVENTION,
        "published_fps": format_fps(LAYOUTS[layout.name].fps),
    }
    write_json(folder / joints_npy.MANIFEST, manifest)
