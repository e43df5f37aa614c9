"""BVH (BioVision Hierarchy): a text file of joints with offsets and channels, then one line of numbers per frame.

Channels are degrees and file units; a joint's rotation is the product of its rotation channels in the order in which
they are listed; position channels replace the joint's OFFSET. Source: M. Meredith and S. Maddock, "Motion Capture File
Formats Explained", University of Sheffield CS-01-11, 2001.

`read_bvh` reads a file at once, in one pass. `read_document` indexes it and reads frames on demand, so that memory does
not grow with the file's length; it also keeps the file's text. Both find the same skeleton, frames and clock, by
`_find_body` and `BvhBody.poses`.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain
from pathlib import Path

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.motion import Caption, Motion, Provenance
from motionkit.core.shapes import Bool, Float32, Float64, Int64
from motionkit.core.skeleton import Skeleton
from motionkit.core.skeletons.families import with_layout_map
from motionkit.core.skeletons.mapping import SkeletonMapError, body_axis, rest_positions
from motionkit.core.timegrid import TimeGrid
from motionkit.fields.motion_field import Poses
from motionkit.io.bvh import channels
from motionkit.io.bvh.channels import ChannelPose
from motionkit.io.bvh.frame_lines import FrameLines, checked_seen, find_frame_lines, read_tables
from motionkit.io.bvh.text import BvhHierarchy, BvhText, read_head, stated_fps
from motionkit.io.registry import ReadOptions
from motionkit.io.source import body_frame, clock
from motionkit.io.source.source_file import FileParts, check_size
from motionkit.io.up import from_y_up, infer_up, log_lines, sampled_frames, skeleton_to_y_up, to_y_up, turn_of

# Smaller changes of a bone are noise of printed digits; a bone with larger ones is not rigid.
RIGID_METRES = 1e-3
# The log line by which readers of data sets know that frame numbers are shifted by one.
T_POSE_DROPPED = "frame 0 dropped: a T-pose (root unturned, all angles whole degrees, root where frame 1 is)"
# A file up to this size is read at once, a larger one piece by piece.
HELD_BYTES = 8 << 20

Pieces = Callable[[], Iterator[ChannelPose]]


@dataclass(frozen=True, eq=False)
class BvhBody:
    """How a file's channels become poses: its bones in metres along the file's axes, of which `up` points up.

    `moving` are the joints that move relative to their parents. `rests_along_up` is whether the rest pose has the same
    up axis as the motion; if not, it is y up.
    """

    skeleton: Skeleton
    moving: tuple[int, ...]
    unit_metres: float
    up: str = "y"
    rests_along_up: bool = True

    def poses(self, pose: ChannelPose) -> Poses:
        """Poses in metres, y up, with rotations and the root's translation."""
        root = (pose.root * self.unit_metres).astype(np.float32)
        offsets = None
        if self.moving:
            offsets = np.repeat(self.skeleton.offsets[None], len(root), axis=0)
            offsets[:, list(self.moving)] = pose.places_of(self.moving) * self.unit_metres
        positions = kinematics.forward_kinematics(pose.rotations, root, self.skeleton, offsets)
        rotations = np.ascontiguousarray(pose.rotations)
        if self.up == "y":
            return Poses(positions, rotations, root)
        rotations = rotations.copy()
        if self.rests_along_up:
            rotations[..., 1:] = to_y_up(rotations[..., 1:], self.up)
        else:
            rotations[:, 0] = kinematics.quaternion_multiply(turn_of(self.up), rotations[:, 0])
        return Poses(to_y_up(positions, self.up), rotations, to_y_up(root, self.up))

    def file_axes(
        self, rotations: Float64[np.ndarray, "times joints 4"], positions: Float64[np.ndarray, "times joints 3"]
    ) -> tuple[Float64[np.ndarray, "times joints 4"], Float64[np.ndarray, "times joints 3"]]:
        """Rotations and positions of `poses` along the file's axes again."""
        if self.up == "y":
            return rotations, positions
        rotations = rotations.copy()
        if self.rests_along_up:
            rotations[..., 1:] = from_y_up(rotations[..., 1:], self.up)
        else:
            back = kinematics.quaternion_conjugate(turn_of(self.up).astype(np.float64))
            rotations[:, 0] = kinematics.quaternion_multiply(back, rotations[:, 0])
        return rotations, from_y_up(positions, self.up)

    def motion(self, pieces: Iterable[ChannelPose], num_frames: int, fps: Fraction) -> Motion:
        """All frames; without rotations if bones move."""
        joints = self.skeleton.num_joints
        positions = np.empty((num_frames, joints, 3), np.float32)
        rotations = None if self.moving else np.empty((num_frames, joints, 4), np.float32)
        root = None if self.moving else np.empty((num_frames, 3), np.float32)
        start = 0
        for piece in pieces:
            poses, part = self.poses(piece), slice(start, start + len(piece.root))
            positions[part] = poses.joint_positions
            if rotations is not None and root is not None:
                rotations[part], root[part] = poses.local_rotations, poses.root_translation
            start = part.stop
        return Motion(positions, self.y_up, TimeGrid(fps, num_frames), rotations, root)

    @property
    def y_up(self) -> Skeleton:
        """The skeleton of the poses."""
        if self.up == "y" or not self.rests_along_up:
            return self.skeleton
        return skeleton_to_y_up(self.skeleton, self.up)


@dataclass(frozen=True, eq=False)
class BvhDocument:
    """A file's text, and the location of the motion's frames in it.

    `lines` are its frames as written and their numbers (file units, degrees). `reference` is the T-pose line that some
    conversions begin with, which is not a frame. The other fields are as `read_bvh` reads them.
    """

    head: BvhText
    lines: FrameLines
    reference: tuple[bytes, ...]
    body: BvhBody
    timegrid: TimeGrid
    skeleton: Skeleton
    sequence_id: str
    provenance: Provenance
    captions: tuple[Caption, ...] = ()
    action: str = ""
    style: str = ""
    split: str = ""

    @property
    def fps(self) -> Fraction:
        """The framerate."""
        return self.timegrid.fps

    @property
    def num_frames(self) -> int:
        """The number of frames."""
        return self.timegrid.num_frames

    @property
    def seen(self) -> Bool[np.ndarray, "frames"]:
        """Mask of the frames whose numbers are all finite; the others repeat a neighbour."""
        return self.lines.seen

    def poses(self, frames: Int64[np.ndarray, "rows"]) -> Poses:
        """The poses of some frames, with rotations and the root's translation."""
        return self.body.poses(_decoded(self.lines.table(frames), self.head.hierarchy, self.body.skeleton.name))

    def motion(self) -> Motion:
        """The whole motion, in memory; raises `FormatError` (`too-large`)."""
        check_size(self.num_frames, self.skeleton.num_joints, self.lines.file.path)
        pieces = (_decoded(table, self.head.hierarchy, self.body.skeleton.name) for table in self.lines.tables())
        made = self.body.motion(pieces, self.num_frames, self.fps)
        return self.annotated(replace(made, skeleton=self.skeleton, timegrid=self.timegrid))

    def annotated(self, motion: Motion) -> Motion:
        """A motion with the document's id, captions, labels and provenance."""
        return replace(
            motion,
            sequence_id=self.sequence_id,
            captions=self.captions,
            action=self.action,
            style=self.style,
            split=self.split,
            provenance=self.provenance,
        )

    def frames(self, start: int, stop: int) -> "BvhDocument":
        """Frames [start, stop), at their own times."""
        grid = TimeGrid(self.fps, stop - start, self.timegrid.start_seconds + float(start / self.fps))
        return replace(self, lines=self.lines.frames(start, stop), timegrid=grid)

    def logged(self, operation: str) -> "BvhDocument":
        """The same with a line added to its operation log."""
        return replace(self, provenance=replace(self.provenance, operations=(*self.provenance.operations, operation)))

    def heading(self, num_frames: int, fps: Fraction) -> bytes:
        """Everything before the first frame, for another number of frames and framerate."""
        frame_time = self.head.frame_time if fps == self.fps else repr(float(1 / fps))
        clock_lines = f"\nFrames: {num_frames + len(self.reference)}\nFrame Time: {frame_time}\n"
        head = self.head.head.rstrip().replace(b"\r\n", b"\n")
        return head + clock_lines.encode() + b"".join(line + b"\n" for line in self.reference)


def read_bvh(path: Path, options: ReadOptions | None = None) -> Motion:
    """Read one BVH file: positions in metres, y up, true local rotations, at the stated framerate.

    The unit is `options.unit_metres` or inferred (`body_frame.infer_unit`); a T-pose in frame 0, as B. Hahne's
    conversions of the CMU database have it, is dropped; a motion that is not y up (`formats.up`) is turned. All of this
    is in the operation log. Raises `FormatError` with a reason, the line and the frame.
    """
    options = options or ReadOptions()
    file = FileParts.of(path, held_bytes=HELD_BYTES)
    head = read_head(file)
    fps, operations = clock.fps_in_use(options.fps, lambda: stated_fps(head, path))
    tables = read_tables(file, head)
    first, num_frames = next(tables), head.num_frames
    if channels.starts_with_t_pose(first, head.hierarchy):
        first, num_frames = first[1:], num_frames - 1
        operations.append(T_POSE_DROPPED)
    decoded = (_decoded(table, head.hierarchy, path.stem) for table in chain([first], tables))
    pose = channels.join(decoded, num_frames)
    body, found = _find_body(pose.parts, options, path)
    pose = replace(pose, placed_joints=body.moving, places=pose.places_of(body.moving))
    motion = body.motion(pose.parts(), num_frames, fps)
    body = _with_up(body, motion.joint_positions[sampled_frames(num_frames)], options.up)
    if body.up != "y":
        del motion  # before the memory of another is taken
        motion = body.motion(pose.parts(), num_frames, fps)
    operations += [*found, *log_lines(body.up, options.up)]
    return replace(motion, sequence_id=path.stem, provenance=_provenance(file, head, operations))


def read_document(path: Path, options: ReadOptions | None = None) -> BvhDocument:
    """Open a BVH file to be written again; raises `FormatError` as `read_bvh` does, with two exceptions.

    Frames with `nan` are not `seen`, and a skeleton that is not a human body in any unit is accepted.
    """
    options = options or ReadOptions()
    file = FileParts.of(path)
    head = read_head(file)
    fps, operations = clock.fps_in_use(options.fps, lambda: stated_fps(head, path))
    lines = find_frame_lines(file, head)
    reference: tuple[bytes, ...] = ()
    if channels.starts_with_t_pose(lines.table(np.arange(min(2, len(lines)))), head.hierarchy):
        reference, lines = (lines.line(0),), lines.frames(1, len(lines))
        checked_seen(lines.seen, path)
        operations.append(T_POSE_DROPPED)
    body, found = _find_body(
        lambda: (_decoded(table, head.hierarchy, path.stem) for table in lines.tables()), options, path, any_size=True
    )
    sample = _decoded(lines.table(sampled_frames(len(lines))), head.hierarchy, path.stem)
    body = _with_up(body, body.poses(sample).joint_positions, options.up)
    operations += [*found, *log_lines(body.up, options.up)]
    return BvhDocument(
        head=head,
        lines=lines,
        reference=reference,
        body=body,
        timegrid=TimeGrid(fps, len(lines)),
        skeleton=body.y_up,
        sequence_id=path.stem,
        provenance=_provenance(file, head, operations),
    )


def _decoded(table: Float64[np.ndarray, "frames channels"], hierarchy: BvhHierarchy, name: str) -> ChannelPose:
    return channels.fold_reference(channels.read_channels(table, hierarchy, name))


def _provenance(file: FileParts, head: BvhText, operations: Sequence[str]) -> Provenance:
    return Provenance(
        source_path=file.path.name,
        source_sha256=file.sha256(),
        source_format="bvh",
        stated_fps=f"Frame Time: {head.frame_time}",
        operations=tuple(operations),
    )


def _find_body(
    pieces: Pieces, options: ReadOptions, path: Path, *, any_size: bool = False
) -> tuple[BvhBody, tuple[str, ...]]:
    """The body of all frames, over which each call of `pieces` iterates; and log lines of how it was found."""
    first = next(pieces())
    first = replace(first, skeleton=with_layout_map(first.skeleton, options.skeleton_maps))
    unit, reason = _unit(first, options, path, any_size)
    skeleton, moving = channels.settle_offsets(first, pieces, RIGID_METRES / unit)
    body = BvhBody(skeleton.scaled(unit), moving, unit)
    operations = [*first.operations, f"lengths × {unit:.6g} to metres ({reason})"]
    if moving:
        names = ", ".join(skeleton.joint_names[joint] for joint in moving)
        operations.append(f"positions only: these bones change their length or place ({names})")
    return body, tuple(operations)


def _unit(pose: ChannelPose, options: ReadOptions, path: Path, any_size: bool) -> tuple[float, str]:
    if options.unit_metres is not None:
        return options.unit_metres, "given"
    unit = body_frame.infer_unit(channels.first_skeleton(pose))
    if unit is not None:
        return unit.metres, unit.reason
    if any_size:
        return 1.0, "in no unit the size of a human body"
    raise FormatError(
        "in none of m, cm, mm, inch and the CMU database's unit is this skeleton the size of a human body; "
        "say how long a unit is with --unit-metres",
        path=path,
        reason="unit",
    )


def _with_up(body: BvhBody, positions: Float32[np.ndarray, "frames joints 3"], given: str) -> BvhBody:
    """The body with the axis that is given, else inferred from positions along the file's axes.

    The rest pose's axis is the expected one: whole files are along z or x, or only their motion.
    """
    try:
        x, y, z = body_axis(body.skeleton, rest_positions(body.skeleton)[None])[0].tolist()
    except SkeletonMapError:
        return replace(body, up=given or "y")
    rest = "z" if z > 2.0 * abs(y) else "x" if x > 2.0 * abs(y) else "y"
    up = given or infer_up(body.skeleton, positions, ("z", "y") if rest == "z" else ("y", "z"))
    return replace(body, up=up, rests_along_up=up == rest)
