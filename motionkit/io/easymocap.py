"""EasyMocap's folders: one JSON a frame, `000000.json`, with a record for each person and its `id`.

`keypoints3d` has OpenPose's 25 joints (x, y, z, confidence; further ones are hands and face), a fit of SMPL has `Rh`,
`Th`, `poses` (72 numbers, the first three 0, or 69 without them) and `shapes`. The body turns by Rh about the origin,
not about the pelvis, and moves by Th. Source: https://github.com/zju3dv/EasyMocap, easymocap/mytools/file_utils.py.
"""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.files import parse_json
from motionkit.core.motion import Motion
from motionkit.core.timegrid import TimeGrid
from motionkit.io import markers, source_file
from motionkit.io.body_frame import upright
from motionkit.io.registry import ReadOptions, ScanResult, SourceItem
from motionkit.io.smpl import neutral_body
from motionkit.io.smpl_body import posed_motion

OPENPOSE_NAMES = (
    "Nose Neck RShoulder RElbow RWrist LShoulder LElbow LWrist MidHip RHip RKnee RAnkle LHip LKnee LAnkle REye LEye "
    "REar LEar LBigToe LSmallToe LHeel RBigToe RSmallToe RHeel"
)
BODY_25 = tuple(OPENPOSE_NAMES.split())
POINTS, FIT = "keypoints3d", ("Rh", "Th", "poses", "shapes")


def _records(path: Path) -> list[dict[str, Any]]:
    try:
        found = parse_json(source_file.decode(source_file.read_bytes(path), path))
    except ValueError as error:
        raise FormatError(f"not JSON ({error})", path=path, reason="not-what-it-says") from None
    found = found.get("annots") if isinstance(found, dict) else found
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise FormatError("expected a list of persons", path=path, reason="not-what-it-says")
    return found


def _frames(folder: Path) -> tuple[list[dict[str, Any]], ...]:
    return _read_frames(tuple((path, path.stat().st_mtime_ns) for path in sorted(folder.glob("[0-9]*.json"))))


@lru_cache(maxsize=1)  # the persons of a folder are read one after the other
def _read_frames(files: tuple[tuple[Path, int], ...]) -> tuple[list[dict[str, Any]], ...]:
    return tuple(_records(path) for path, _ in files)


def _person(record: dict[str, Any]) -> str:
    return str(record.get("id", record.get("personID", 0)))


def claims(folder: Path) -> bool:
    """Whether a folder's first frame with anybody has EasyMocap's keys."""
    try:
        first = next((each[0] for path in sorted(folder.glob("[0-9]*.json")) if (each := _records(path))), {})
    except FormatError:
        return False
    return POINTS in first or set(FIT) <= set(first)


def find(folder: Path, root: Path) -> ScanResult:
    """One sequence a person; raises no error for a broken frame, which is a problem."""
    try:
        persons = sorted({_person(record) for frame in _frames(folder) for record in frame})
    except FormatError as problem:
        return ScanResult((), (problem,))
    place, first = "/".join((root.name, *folder.relative_to(root).parts)), min(folder.glob("[0-9]*.json"))
    return ScanResult(tuple(SourceItem("easymocap", first, root, f"{place}/{key}", key=key) for key in persons))


def read_easymocap(item: SourceItem, options: ReadOptions) -> Motion:
    """Read one person from its first frame to its last: true rotations of a fit, or 25 points with gaps as in C3D."""
    path, fps = item.path, options.fps
    if fps is None:
        message = "nothing says the framerate of the cameras; give --fps"
        raise FormatError(message, path=path, reason="no-framerate")
    rows = [next((each for each in frame if _person(each) == item.key), None) for frame in _frames(path.parent)]
    there = [index for index, row in enumerate(rows) if row is not None]
    rows = rows[there[0] : there[-1] + 1]
    seen = [row for row in rows if row is not None]
    provenance = source_file.provenance(path, repr(seen).encode(), "easymocap", [f"frames from {there[0]}"])
    try:
        if not set(FIT) <= set(seen[0]):
            points = np.full((len(rows), len(BODY_25), 3), np.nan)
            for frame, row in enumerate(rows):
                joints = np.array(row[POINTS], np.float64)[: len(BODY_25)] if row else np.zeros((25, 4))
                points[frame] = np.where(joints[:, 3:].all(axis=1, keepdims=True), joints[:, :3], np.nan)
            found = markers.without_gaps(markers.Markers(BODY_25, points, ()), fps, path)
            skeleton = markers.marker_skeleton(found.names)
            positions, lines = upright(skeleton, found.positions.astype(np.float32), options.up)
            source = replace(provenance, operations=(*provenance.operations, *found.operations, *lines))
            return Motion(positions, skeleton, TimeGrid(fps, len(positions)), provenance=source)
        if len(seen) < len(rows):
            raise FormatError(f"person {item.key} is not in every frame", path=path, reason="gaps")
        turn, move, poses, shapes = (np.array([np.ravel(row[key]) for row in seen], np.float32) for key in FIT)
    except (KeyError, ValueError, TypeError, IndexError) as error:
        raise FormatError(f"person {item.key}: {error}", path=path, reason="channel-count") from None
    if poses.shape[1] not in (69, 72):
        message = f"poses of {poses.shape[1]} numbers, expected SMPL's 69 or 72"
        raise FormatError(message, path=path, reason="channel-count")
    body = poses[:, poses.shape[1] - 69 :][:, :63]
    vectors = np.concatenate((turn, body), axis=1).reshape(len(poses), -1, 3)
    rotations = kinematics.rotation_vector_to_quaternion(vectors)
    smpl_body = neutral_body(rotations.shape[1], shapes[0], options)
    return posed_motion(rotations, move, smpl_body, fps, options.up, provenance, turns_about_origin=True)
