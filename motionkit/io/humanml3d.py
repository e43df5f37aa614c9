"""HumanML3D folders (22 joints, 20 fps, metres), and KIT-ML's of the same shape (21 joints, 12.5 fps, 251 numbers).

A folder has `new_joints/ID.npy` [T, J, 3] and/or `new_joint_vecs/ID.npy` [T, 12·J − 1], `texts/ID.txt`, `train.txt`,
`val.txt`, `test.txt`, `Mean.npy` and `Std.npy`. KIT-ML's lengths are thousandths of the body's height.
Source: https://github.com/EricGuo5513/HumanML3D, https://motion-annotation.humanoids.kit.edu.
"""

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.files import naming
from motionkit.core.moments import Moments, merge, moments
from motionkit.core.motion import Caption, Motion
from motionkit.core.shapes import Float, Float32
from motionkit.core.skeleton import KIT21, SMPL22, Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.io import joints_npy, npy, source_file, texts
from motionkit.io.registry import ReadOptions, ScanResult, SourceItem
from motionkit.io.texts import SPLITS, read_splits

JOINTS_FOLDER, VECTORS_FOLDER, TEXTS_FOLDER = "new_joints", "new_joint_vecs", "texts"


@dataclass(frozen=True)
class Layout:
    """One of the two published data sets of this form; `unit_metres` is the length of its files' unit."""

    name: str
    skeleton: Skeleton
    fps: Fraction
    unit_metres: float

    @property
    def num_values(self) -> int:
        """Width of a pose vector, 12·J − 1."""
        return 12 * self.skeleton.num_joints - 1


class VectorLayout(NamedTuple):
    """The 7 slices of a pose vector of 12·J − 1 numbers, inside each of which the published Std is constant.

    `root_yaw_velocity` 1 · `root_velocity` 2 (x, z) · `root_height` 1 · `joint_positions` 3(J − 1) · `joint_rotations`
    6(J − 1) · `joint_velocities` 3J · `contacts` 4 (left ankle, left toe, right ankle, right toe). Source: HumanML3D,
    motion_representation.ipynb.
    """

    root_yaw_velocity: slice
    root_velocity: slice
    root_height: slice
    joint_positions: slice
    joint_rotations: slice
    joint_velocities: slice
    contacts: slice

    @property
    def size(self) -> int:
        """Numbers per pose: 263 for 22 joints, 251 for 21."""
        return int(self.contacts.stop)


def vector_layout(num_joints: int) -> VectorLayout:
    """The slices of the pose vectors of so many joints."""
    widths = (1, 2, 1, 3 * (num_joints - 1), 6 * (num_joints - 1), 3 * num_joints, 4)
    ends = np.cumsum(widths).tolist()
    return VectorLayout(*(slice(end - width, end) for width, end in zip(widths, ends, strict=True)))


HUMANML3D = Layout("humanml3d", SMPL22, Fraction(20), 1.0)
# KIT-ML's files have the root at 560 units on average, the hip height of a body of 1,000; that is taken as 1.7 m.
BODY_HEIGHT_METRES = 1.7
KIT = Layout("kit", KIT21, Fraction(25, 2), BODY_HEIGHT_METRES / 1000.0)
LAYOUTS = {layout.name: layout for layout in (HUMANML3D, KIT)}


def is_humanml3d(folder: Path, layout: Layout = HUMANML3D) -> bool:
    """Whether a folder has this layout, judged by the first array with a valid shape."""
    shapes = {JOINTS_FOLDER: (layout.skeleton.num_joints, 3), VECTORS_FOLDER: (layout.num_values,)}
    for name, shape in shapes.items():
        stated = (npy.peek_shape(path) for path in sorted((folder / name).glob("*.npy")))
        first = next((each for each in stated if each is not None), None)
        if first is not None:
            return first[1:] == shape
    return False


def is_kit(folder: Path) -> bool:
    """Whether a folder has KIT-ML's layout."""
    return is_humanml3d(folder, KIT)


def find(folder: Path, root: Path) -> ScanResult:
    """All sequences of a folder with their splits; captions without motion are problems."""
    # Joints replace the vectors of the same name.
    arrays = [path for name in (VECTORS_FOLDER, JOINTS_FOLDER) for path in (folder / name).glob("*.npy")]
    paths = dict(sorted({path.stem: path for path in arrays}.items()))
    described = {path.stem: path for path in sorted((folder / TEXTS_FOLDER).glob("*.txt"))}
    splits, warnings = read_splits(folder, paths, "the folder")
    place = folder.relative_to(root).as_posix()
    prefix = root.name if place == "." else f"{root.name}/{place}"
    items = tuple(
        SourceItem(
            format=(KIT if is_kit(folder) else HUMANML3D).name,
            path=path,
            root=root,
            sequence_id=f"{prefix}/{key}",
            key=key,
            split=splits.get(key, ""),
            source=root.name,
            subset="" if place == "." else place,
        )
        for key, path in paths.items()
    )
    problems = tuple(
        FormatError(f"there is no {JOINTS_FOLDER}/{key}.npy", path=path, reason="caption-without-motion")
        for key, path in described.items()
        if key not in paths
    )
    return ScanResult(items, problems, tuple(warnings))


def read_humanml3d(item: SourceItem, options: ReadOptions) -> Motion:
    """Read one sequence: joints if the folder has them, else recovered from its pose vectors, in metres.

    The framerate is the published one unless the folder's `motions.json` (motionkit/io/joints_npy.py) or `options`
    gives another. The published 6D rotations lack twist and are not used as rotations. Raises `FormatError`.
    """
    data, layout = source_file.read_bytes(item.path), LAYOUTS[item.format]
    operations: list[str] = []
    if item.path.parent.name == VECTORS_FOLDER:
        vectors = npy.read_npy(item.path, data, (None, layout.num_values))
        positions = recover_positions(vectors, layout.skeleton.num_joints)
        operations.append(f"joint positions recovered from {layout.num_values}-number pose vectors")
    else:
        positions = npy.read_npy(item.path, data, (None, layout.skeleton.num_joints, 3))
    unit = options.unit_metres or layout.unit_metres
    if unit != 1.0:
        positions = positions * np.float32(unit)
        operations.append(f"lengths × {unit:g} to metres ({'given' if options.unit_metres else 'a body 1.7 m tall'})")
    if item.key.startswith("M") and item.key[1:].isdecimal():
        operations.append(f"a mirrored copy of {item.key[1:]}, made by the dataset's authors")
    stated = joints_npy.read_manifest(item.path.parents[1] / joints_npy.MANIFEST).fps or layout.fps
    fps = options.fps or stated
    operations += source_file.replaced_fps(fps, stated, who="the data set")
    described = item.path.parents[1] / TEXTS_FOLDER / f"{item.key}.txt"
    return Motion(
        joint_positions=positions,
        skeleton=layout.skeleton,
        timegrid=TimeGrid(fps, len(positions)),
        captions=texts.read_texts(described) if described.is_file() else (),
        split=item.split,
        sequence_id=item.sequence_id,
        provenance=source_file.provenance(item.path, data, layout.name, operations, stated_fps=str(float(stated))),
    )


def recover_positions(
    vectors: Float[np.ndarray, "frames values"], num_joints: int
) -> Float32[np.ndarray, "frames joints 3"]:
    """Joint positions, in the vectors' own unit, from the first 4 + 3·(J − 1) of 12·J − 1 numbers.

    The yaw rate (half angles per frame) and the root's displacements are integrated from the first frame, so errors
    accumulate; the other joints come from their root-relative positions. Source: HumanML3D, recover_from_ric.
    """
    values = vectors.astype(np.float64)
    angle = np.zeros(len(values))
    angle[1:] = 2.0 * np.cumsum(values[:-1, 0])
    step = np.zeros((len(values), 3))
    step[1:, [0, 2]] = values[:-1, 1:3]
    root = np.cumsum(kinematics.rotate_about_y(step, -angle), axis=0)
    positions = np.empty((len(values), num_joints, 3))
    local = values[:, 4 : 4 + 3 * (num_joints - 1)].reshape(len(values), num_joints - 1, 3)
    positions[:, 1:] = kinematics.rotate_about_y(local, -angle[:, None]) + root[:, None]
    positions[:, 0] = root
    positions[:, 0, 1] = values[:, 3]
    return positions.astype(np.float32)


@dataclass(frozen=True)
class Entry:
    """A sequence to write: joints in the layout's unit, pose vectors if any, captions and split."""

    name: str
    joint_positions: Float32[np.ndarray, "frames joints 3"]
    vectors: Float32[np.ndarray, "rows values"] | None = None
    captions: tuple[Caption, ...] = ()
    split: str = ""


class FolderWriter:
    """Writes a folder of the published form sequence by sequence; owns lists of names and the moments of Mean and Std.

    `layout.fps` gives the sequences' durations, for captions that last to their end.
    """

    def __init__(self, folder: Path, layout: Layout = HUMANML3D) -> None:
        self._folder = folder
        self._layout = layout
        self._members: dict[str, list[str]] = {split: [] for split in ("all", *SPLITS)}
        # Of the training vectors, and of the others.
        self._moments: dict[bool, Moments] = {}
        for name in (JOINTS_FOLDER, VECTORS_FOLDER, TEXTS_FOLDER):
            (folder / name).mkdir(parents=True, exist_ok=True)

    def add(self, entry: Entry) -> None:
        """Write one sequence under its name, which is a plain file name of its own."""
        _save(self._folder / JOINTS_FOLDER / f"{entry.name}.npy", entry.joint_positions)
        if entry.vectors is not None:
            _save(self._folder / VECTORS_FOLDER / f"{entry.name}.npy", entry.vectors)
            if len(entry.vectors):
                is_training, own = entry.split == "train", moments(entry.vectors)
                before = self._moments.get(is_training)
                self._moments[is_training] = own if before is None else merge(before, own)
        if entry.captions:
            lines = texts.format_texts(entry.captions, len(entry.joint_positions) / float(self._layout.fps))
            path = self._folder / TEXTS_FOLDER / f"{entry.name}.txt"
            with naming(path):
                path.write_text(lines, encoding="utf-8")
        self._members["all"].append(entry.name)
        if entry.split in SPLITS:
            self._members[entry.split].append(entry.name)

    def finish(self) -> int:
        """Write the splits, `Mean.npy` and `Std.npy`; returns the number of sequences.

        The statistics (in float64; Std averaged inside each block, as published) are of the training vectors, or of
        all vectors if no sequence is in the training split.
        """
        members = {**self._members, "train_val": [*self._members["train"], *self._members["val"]]}
        for split, names in members.items():
            (self._folder / f"{split}.txt").write_text("".join(f"{name}\n" for name in names), encoding="utf-8")
        training = self._moments.get(True, self._moments.get(False))
        if training is not None:
            std = training.std
            for block in vector_layout(self._layout.skeleton.num_joints):
                std[block] = std[block].mean()
            _save(self._folder / "Mean.npy", training.mean.astype(np.float32))
            _save(self._folder / "Std.npy", std.astype(np.float32))
        return len(self._members["all"])


def _save(path: Path, array: np.ndarray) -> None:
    with naming(path):
        np.save(path, array, allow_pickle=False)
