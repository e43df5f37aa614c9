"""A BVH file that is to be written again: its hierarchy and its lines as they stand, and new frames between them.

`read_bvh` makes a motion of a file and forgets how it was written. Here nothing is forgotten: joints, channels, units
and axes stay the file's, given frames stay its own lines (`channel_lines` turns poses back into its channels). And
nothing is held: frames are read where they are needed, so a file of any length needs the memory of a short one.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64, Int64

from motionkit import kinematics
from motionkit.errors import FormatError
from motionkit.formats import body_frame, clock
from motionkit.formats.bvh import channels as bvh_channels
from motionkit.formats.bvh.frame_lines import FrameLines, checked_seen, find_frame_lines
from motionkit.formats.bvh.hierarchy import BvhHierarchy
from motionkit.formats.bvh.text import read_head, stated_fps
from motionkit.formats.file_parts import FileParts
from motionkit.formats.items import ReadOptions
from motionkit.motion import Motion, Provenance
from motionkit.motionfield import Poses
from motionkit.skeleton import Skeleton
from motionkit.skeletons.families import with_layout_map
from motionkit.timegrid import TimeGrid


@dataclass(frozen=True, eq=False)
class BvhDocument:
    """A file's text, and where in it the frames are of the motion that it describes.

    `frames` are its lines and their numbers (file units, degrees). The motion has every joint of the file, metres and y
    up; a body that the file has along z is `turned`. `reference` is the T-pose line that some conversions begin with,
    no frame.
    """

    path: Path
    head: bytes
    frame_time: str
    hierarchy: BvhHierarchy
    frames: FrameLines
    timegrid: TimeGrid
    skeleton: Skeleton
    unit_metres: float
    turned: bool
    reference: tuple[bytes, ...]
    provenance: Provenance

    @property
    def seen(self) -> Bool[np.ndarray, "frames"]:
        """Which frames have numbers that are all finite; the others repeat a neighbour."""
        return self.frames.seen

    def poses(self, frames: Int64[np.ndarray, "rows"]) -> Poses:
        """The poses of some frames, with rotations and the root's translation."""
        return _poses(self.frames.table(frames), self.hierarchy, self.skeleton, self.unit_metres, self.turned)

    def motion(self) -> Motion:
        """All of it, in memory."""
        poses = self.poses(np.arange(len(self.frames)))
        return replace(poses.at(self.timegrid, self.skeleton, self.provenance), sequence_id=self.path.stem)

    def heading(self, num_frames: int, fps: Fraction) -> bytes:
        """Everything before the first frame, for another number of frames and framerate."""
        frame_time = self.frame_time if fps == self.timegrid.fps else repr(float(1 / fps))
        told = f"\nFrames: {num_frames + len(self.reference)}\nFrame Time: {frame_time}\n"
        return (
            self.head.rstrip().replace(b"\r\n", b"\n")
            + told.encode()
            + b"".join(line + b"\n" for line in self.reference)
        )


def read_document(path: Path, options: ReadOptions | None = None) -> BvhDocument:
    """Look through a BVH file that is to be written again; raises `FormatError` as `read_bvh` does, but for two things.

    Frames that hold `nan` are not `seen`, and a skeleton that is no human body in any unit is taken as it is.
    """
    options = options or ReadOptions()
    file = FileParts.of(path)
    head = read_head(file)
    fps, operations = clock.fps_in_use(options.fps, lambda: stated_fps(head, path))
    _check_orders(head.hierarchy, path)
    frames = find_frame_lines(file, head)
    reference: tuple[bytes, ...] = ()
    if bvh_channels.starts_with_t_pose(frames.table(np.arange(min(2, len(frames)))), head.hierarchy):
        reference, frames = (frames.line(0),), frames.without_first()
        checked_seen(frames.seen, path)
        operations.append("frame 0 is a T-pose: kept in front, no part of the motion")
    skeleton, unit = _skeleton(frames, head.hierarchy, options, path)
    turned = _is_along_z(frames, head.hierarchy, skeleton, unit)
    return BvhDocument(
        path=path,
        head=head.head,
        frame_time=head.frame_time,
        hierarchy=head.hierarchy,
        frames=frames,
        timegrid=TimeGrid(fps, len(frames)),
        skeleton=body_frame.skeleton_to_y_up(skeleton) if turned else skeleton,
        unit_metres=unit,
        turned=turned,
        reference=reference,
        provenance=Provenance(
            source_path=path.name,
            source_sha256=file.sha256(),
            source_format="bvh",
            stated_fps=f"Frame Time: {head.frame_time}",
            operations=tuple(operations),
        ),
    )


def _check_orders(hierarchy: BvhHierarchy, path: Path) -> None:
    for joint in hierarchy.joints:
        if any(first == second for first, second in pairwise(joint.order)):
            message = (
                f"joint {joint.name!r} turns twice in a row about one axis ({joint.order}): its angles are not unique"
            )
            raise FormatError(message, path=path, reason="channels")


def _skeleton(frames: FrameLines, hierarchy: BvhHierarchy, options: ReadOptions, path: Path) -> tuple[Skeleton, float]:
    # In metres, along the file's axes; bones as in the first frame say which unit it is.
    pose = bvh_channels.read_channels(frames.table(np.arange(1)), hierarchy, path.stem)
    skeleton = with_layout_map(pose.skeleton, options.skeleton_maps)
    inferred = body_frame.infer_unit(bvh_channels.first_skeleton(replace(pose, skeleton=skeleton)))
    unit = options.unit_metres or (inferred.metres if inferred else 1.0)
    return skeleton.scaled(unit), unit


def _is_along_z(frames: FrameLines, hierarchy: BvhHierarchy, skeleton: Skeleton, unit: float) -> bool:
    # Few rest poses lie along z: only for those all frames are asked.
    if not body_frame.rests_along_z(skeleton):
        return False
    total = np.zeros((skeleton.num_joints, 3))
    for table in frames.tables():
        total += _poses(table, hierarchy, skeleton, unit, turned=False).joint_positions.sum(axis=0, dtype=np.float64)
    return body_frame.stands_along_z(skeleton, (total / len(frames)).astype(np.float32))


def _poses(
    table: Float64[np.ndarray, "frames channels"],
    hierarchy: BvhHierarchy,
    skeleton: Skeleton,
    unit: float,
    turned: bool,
) -> Poses:
    pose = bvh_channels.read_channels(table, hierarchy, skeleton.name)
    rotations, root = np.ascontiguousarray(pose.rotations), (pose.root * unit).astype(np.float32)
    written = pose.skeleton.scaled(unit)
    offsets = np.repeat(written.offsets[None], len(root), axis=0)
    offsets[:, list(pose.placed_joints)] = pose.places * unit
    positions = kinematics.forward_kinematics(rotations, root, written, offsets)
    if turned:
        _, positions, rotations, root = body_frame.z_up_to_y_up(written, positions, rotations, root)
    return Poses(positions, rotations, root)
