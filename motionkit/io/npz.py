"""The project's own .npz: one motion as named numpy arrays, without Python objects.

`joint_positions` [T, J, 3] in metres, y up, and a clock are required: `fps_numerator` and `fps_denominator`, or `fps`,
or `time_seconds` [T], evenly spaced; all that are present must agree. Everything else is optional: `local_rotations`
[T, J, 4] unit quaternions (w, x, y, z), `root_translation` [T, 3]; the skeleton (`skeleton_arrays`); `captions`
[C], `caption_seconds` [C, 2] (NaN: to the end), `caption_tokens` [C]; single strings `action`, `style`, `split`,
`sequence_id`, `source`, `subset`, `licence`, `subject`, `stated_fps`; `operations` [K]. With all of these, writing and
reading a motion is lossless.
"""

from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core.errors import FormatError, MotionkitError
from motionkit.core.framerate import format_fps, parse_fps
from motionkit.core.motion import Caption, Motion, Provenance
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import STANDARD_SKELETONS, Feet, Skeleton
from motionkit.core.skeletons.families import parse_layout_map
from motionkit.core.timegrid import TimeGrid
from motionkit.io import npy
from motionkit.io.npy import checked_rotations
from motionkit.io.registry import FileHead, Format, ReadOptions, of_path
from motionkit.io.source import clock, source_file
from motionkit.io.source.body_frame import in_metres


def skeleton_arrays(skeleton: Skeleton) -> dict[str, Any]:
    """All fields of a skeleton: names, parents, offsets in metres; pairs, feet, end sites and map if it has them."""
    arrays: dict[str, Any] = {
        "skeleton": np.array(skeleton.name),
        "joint_names": np.array(skeleton.joint_names),
        "parents": np.array(skeleton.parents, np.int64),
        "offsets": skeleton.offsets,
    }
    if skeleton.left_right_pairs:
        arrays["left_right_pairs"] = np.array(skeleton.left_right_pairs, np.int64)
    if (feet := skeleton.feet) is not None:
        arrays["feet"] = np.array((feet.left_ankle, feet.left_toe, feet.right_ankle, feet.right_toe), np.int64)
    if skeleton.end_sites:
        arrays["end_site_joints"] = np.array([joint for joint, _ in skeleton.end_sites], np.int64)
        arrays["end_site_offsets"] = np.array([offset for _, offset in skeleton.end_sites], np.float64)
    if skeleton.layout_map:
        arrays["layout_map"] = np.array(skeleton.layout_map)
    return arrays


def read_skeleton(archive: npy.Archive, joint_positions: Float32[np.ndarray, "frames joints 3"]) -> Skeleton:
    """The skeleton that the arrays describe; missing parts are taken from a standard layout or from frame 0.

    Without `joint_names`, 22 joints are SMPL's and 21 KIT's. Names and parents of a standard layout give that layout.
    Without `offsets` the rest pose is that of frame 0; without `parents` all joints are children of the first. Raises
    `FormatError` (`channel-count`, `bones`).
    """
    num_joints = joint_positions.shape[1]
    if "joint_names" not in archive:
        return unnamed_skeleton(num_joints, archive.path)
    names = archive.strings("joint_names")
    if len(names) != num_joints:
        message = f"{len(names)} joint_names for {num_joints} joints"
        raise FormatError(message, path=archive.path, reason="channel-count")
    for skeleton in STANDARD_SKELETONS.values():
        if names == skeleton.joint_names and "offsets" not in archive:
            return skeleton
    return _described(archive, names, joint_positions)


def unnamed_skeleton(num_joints: int, path: Path) -> Skeleton:
    """The standard skeleton with `num_joints` joints; raises `FormatError` (`channel-count`) if there is none."""
    for skeleton in STANDARD_SKELETONS.values():
        if skeleton.num_joints == num_joints:
            return skeleton
    message = f"{num_joints} joints without joint_names; only 22 (SMPL's) and 21 (KIT's) are known without"
    raise FormatError(message, path=path, reason="channel-count")


def checked_layout_map(text: str, path: Path) -> str:
    """A skeleton's own map, unchanged; raises `FormatError` (`skeleton-map`) if it is invalid."""
    try:
        if text:
            parse_layout_map(text)
    except MotionkitError as error:
        raise FormatError(str(error), path=path, reason="skeleton-map") from None
    return text


def bones_of_pose(pose: Float32[np.ndarray, "joints 3"], parents: tuple[int, ...]) -> Float32[np.ndarray, "joints 3"]:
    """Offsets in metres that make a pose the rest pose; the root's is zero."""
    return np.asarray(pose - pose[np.maximum(parents, 0)], np.float32)


def _described(
    archive: npy.Archive, names: tuple[str, ...], joint_positions: Float32[np.ndarray, "frames joints 3"]
) -> Skeleton:
    num_joints = len(names)
    parents = (-1, *(0,) * (num_joints - 1))
    if "parents" in archive:
        parents = tuple(_indices(archive, "parents", (num_joints,), -1, num_joints).tolist())
    try:
        if "offsets" in archive:
            offsets = archive.numbers("offsets", (num_joints, 3))
        else:
            offsets = bones_of_pose(joint_positions[0], parents)
        layout_map = "".join(archive.strings("layout_map")) if "layout_map" in archive else ""
        name = archive.strings("skeleton")[0] if "skeleton" in archive else archive.path.stem
        return Skeleton(
            name,
            names,
            parents,
            offsets,
            left_right_pairs=_pairs(archive, num_joints),
            feet=_feet(archive, num_joints),
            end_sites=_end_sites(archive, num_joints),
            layout_map=checked_layout_map(layout_map, archive.path),
        )
    except (ValueError, IndexError) as error:
        raise FormatError(str(error), path=archive.path, reason="bones") from None


def _pairs(archive: npy.Archive, num_joints: int) -> tuple[tuple[int, int], ...]:
    if "left_right_pairs" not in archive:
        return ()
    pairs = _indices(archive, "left_right_pairs", (None, 2), 0, num_joints).tolist()
    return tuple((left, right) for left, right in pairs)


def _feet(archive: npy.Archive, num_joints: int) -> Feet | None:
    return Feet(*_indices(archive, "feet", (4,), 0, num_joints).tolist()) if "feet" in archive else None


def _end_sites(archive: npy.Archive, num_joints: int) -> tuple[tuple[int, tuple[float, float, float]], ...]:
    if "end_site_joints" not in archive:
        return ()
    joints = _indices(archive, "end_site_joints", (None,), 0, num_joints).tolist()
    offsets = archive.exact("end_site_offsets", (len(joints), 3)).tolist()
    return tuple((joint, (x, y, z)) for joint, (x, y, z) in zip(joints, offsets, strict=True))


def _indices(archive: npy.Archive, key: str, shape: tuple[int | None, ...], low: int, high: int) -> np.ndarray:
    found = archive.exact(key, shape)
    if not ((found >= low) & (found < high) & (found == np.rint(found))).all():
        message = f"{key}: joints are numbered {low} … {high - 1}, these are not"
        raise FormatError(message, path=archive.path, reason="bones")
    return found.astype(np.int64)


PROVENANCE = ("source", "subset", "licence", "subject")


def accepts(head: FileHead) -> bool:
    """Whether an .npz file lists joint_positions; a broken file passes, so that reading it reports the fault."""
    return not head.array_names or "joint_positions" in head.array_names


def read_npz(path: Path, options: ReadOptions | None = None) -> Motion:
    """Read one motion; lengths are multiplied by `options.unit_metres`, `options.fps` replaces the clock's framerate.

    Raises `FormatError`, with the reason `no-framerate` if there is no clock and `frame-time` for uneven time stamps.
    """
    options = options or ReadOptions()
    data = source_file.read_bytes(path)
    archive = npy.open_archive(path, data)
    positions = archive.numbers("joint_positions", (None, None, 3))
    grid, stated_fps, operations = _clock(archive, len(positions), options)
    skeleton = read_skeleton(archive, positions)
    motion = Motion(
        joint_positions=positions,
        skeleton=skeleton,
        timegrid=grid,
        local_rotations=_rotations(archive, positions.shape[:2]),
        root_translation=_optional(archive, "root_translation", (len(positions), 3)),
        captions=_captions(archive),
        action=_text(archive, "action"),
        style=_text(archive, "style"),
        split=_text(archive, "split"),
        sequence_id=_text(archive, "sequence_id") or path.stem,
        provenance=Provenance(
            **{name: _text(archive, name) for name in PROVENANCE},
            source_path=path.name,
            source_sha256=source_file.sha256(data),
            source_format="npz",
            stated_fps=stated_fps,
            operations=(*_texts(archive, "operations"), *operations),
        ),
    )
    return in_metres(motion, options.unit_metres)


def write_npz(motion: Motion, path: Path) -> None:
    """Write a motion with all its fields; that read by `read_npz` differs only in the file's name and hash."""
    write_arrays(path, motion_arrays(motion))


def motion_arrays(motion: Motion) -> dict[str, Any]:
    """The arrays of one motion by the names of the schema; absent fields are omitted."""
    provenance = motion.provenance
    texts = {"action": motion.action, "style": motion.style, "split": motion.split, "sequence_id": motion.sequence_id}
    texts |= {name: getattr(provenance, name) for name in PROVENANCE}
    arrays: dict[str, Any] = {
        "joint_positions": motion.joint_positions,
        "time_seconds": motion.timegrid.seconds(),
        "fps": np.float64(float(motion.fps)),
        "fps_numerator": np.int64(motion.fps.numerator),
        "fps_denominator": np.int64(motion.fps.denominator),
        "local_rotations": motion.local_rotations,
        "root_translation": motion.root_translation,
        **skeleton_arrays(motion.skeleton),
        **caption_arrays(motion.captions),
        **{name: np.array(text) for name, text in texts.items() if text},
        # Also if the source stated none: else a reader would take the clock above for the stated framerate.
        "stated_fps": np.array(provenance.stated_fps),
        "operations": np.array(provenance.operations) if provenance.operations else None,
    }
    return {name: array for name, array in arrays.items() if array is not None}


def caption_arrays(captions: Sequence[Caption]) -> dict[str, Any]:
    """`captions`, their seconds (NaN: to the end), and tokens if any caption has them; empty without captions."""
    if not captions:
        return {}
    ends = [np.nan if caption.end_seconds is None else caption.end_seconds for caption in captions]
    arrays = {
        "captions": np.array([caption.text for caption in captions]),
        "caption_seconds": np.stack(([caption.start_seconds for caption in captions], ends), axis=1),
    }
    if any(caption.tokens for caption in captions):
        arrays["caption_tokens"] = np.array([caption.tokens for caption in captions])
    return arrays


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write an .npz that is readable with `allow_pickle=False`."""
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def _clock(archive: npy.Archive, num_frames: int, options: ReadOptions) -> tuple[TimeGrid, str, list[str]]:
    try:
        stated, words = _stated_fps(archive)
    except FormatError:
        if options.fps is None:
            raise
        stated, words = None, ""
    seconds = None
    if "time_seconds" in archive:
        seconds = archive.exact("time_seconds", (num_frames,))
        if options.fps is None:
            grid = clock.grid_of_seconds(seconds, archive.path, stated)
            stated, words = grid.fps, words or f"time_seconds: {format_fps(grid.fps)}"
    fps = options.fps or stated
    if fps is None:
        raise FormatError(
            "none of fps, fps_numerator and fps_denominator, time_seconds says the framerate; add one, or use --fps",
            path=archive.path,
            reason="no-framerate",
        )
    start = float(seconds[0]) if seconds is not None and np.isfinite(seconds[0]) else 0.0
    said = _text(archive, "stated_fps") if "stated_fps" in archive else words
    return TimeGrid(fps, num_frames, start), said, clock.replaced_fps(fps, stated)


def _stated_fps(archive: npy.Archive) -> tuple[Fraction | None, str]:
    try:
        if "fps_numerator" in archive and "fps_denominator" in archive:
            pair = [archive.exact(f"fps_{part}", ()) for part in ("numerator", "denominator")]
            fps = parse_fps(Fraction(*(int(part) for part in pair)))
            return fps, f"fps: {format_fps(fps)}"
        if "fps" in archive:
            value = archive.scalar("fps")
            if value is None:
                raise ValueError("a Python object, which is not loaded")
            return parse_fps(value), f"fps: {value}"
    except (ValueError, OverflowError, ZeroDivisionError) as error:
        raise FormatError(f"fps: {error}", path=archive.path, reason="frame-time") from None
    return None, ""


def _rotations(archive: npy.Archive, shape: tuple[int, ...]) -> Float32[np.ndarray, "frames joints 4"] | None:
    rotations = _optional(archive, "local_rotations", (*shape, 4))
    if rotations is not None:
        checked_rotations(rotations, archive.path, "local_rotations")
    return rotations


def _captions(archive: npy.Archive) -> tuple[Caption, ...]:
    texts = _texts(archive, "captions")
    tokens = _texts(archive, "caption_tokens") or ("",) * len(texts)
    if len(tokens) != len(texts):
        message = f"{len(tokens)} caption_tokens for {len(texts)} captions"
        raise FormatError(message, path=archive.path, reason="channel-count")
    if "caption_seconds" not in archive:
        return tuple(Caption(text, tokens=words) for text, words in zip(texts, tokens, strict=True))
    bounds = archive.exact("caption_seconds", (len(texts), 2))
    if not np.isfinite(bounds[:, 0]).all() or np.isinf(bounds[:, 1]).any():
        raise FormatError("caption_seconds: a start that is no number", path=archive.path, reason="text")
    return tuple(
        Caption(text, start, None if np.isnan(end) else end, words)
        for text, (start, end), words in zip(texts, bounds.tolist(), tokens, strict=True)
    )


def _optional(archive: npy.Archive, key: str, shape: tuple[int, ...]) -> Float32[np.ndarray, "..."] | None:
    return archive.numbers(key, shape) if key in archive else None


def _texts(archive: npy.Archive, key: str) -> tuple[str, ...]:
    return archive.strings(key) if key in archive else ()


def _text(archive: npy.Archive, key: str) -> str:
    return next(iter(_texts(archive, key)), "")


FORMAT = Format(
    name="npz",
    read=of_path(read_npz),
    suffixes=(".npz",),
    accepts=accepts,
    write=write_npz,
)
