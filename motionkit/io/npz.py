"""The project's own .npz: one motion as named numpy arrays, without Python objects.

`joint_positions` [T, J, 3] in metres, y up, and a clock are required: `fps_numerator` and `fps_denominator`, or `fps`,
or `time_seconds` [T], evenly spaced; all that are present must agree. Everything else is optional: `local_rotations`
[T, J, 4] unit quaternions (w, x, y, z), `root_translation` [T, 3]; the skeleton (`skeleton_arrays`); `captions`
[C], `caption_seconds` [C, 2] (NaN: to the end), `caption_tokens` [C]; single strings `action`, `style`, `split`,
`sequence_id`, `source`, `subset`, `licence`, `subject`, `stated_fps`; `operations` [K]. With all of these, writing and
reading a motion is lossless.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core.errors import FormatError, MotionkitError
from motionkit.core.motion import Caption, Motion
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import STANDARD_SKELETONS, Feet, Skeleton
from motionkit.core.skeletons.mapping import parse_layout_map, rig_name
from motionkit.core.timegrid import TimeGrid, parse_fps
from motionkit.io import npy, source_file
from motionkit.io.body_frame import in_metres
from motionkit.io.registry import FileHead, ReadOptions

PROVENANCE = ("source", "subset", "licence", "subject")
# Quaternions of float16 are off unit length by 1e-3.
MAX_LENGTH_ERROR = 0.01


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
    """The skeleton that the arrays describe; what is missing is taken from a standard layout or from frame 0.

    Without `joint_names`, 22 joints are SMPL's and 21 KIT's. Names of a standard layout without `offsets` give that
    layout. Without `offsets` the rest pose is that of frame 0; without `parents` all joints are children of the first.
    Raises `FormatError` (`channel-count`, `bones`).
    """
    path, num_joints = archive.path, joint_positions.shape[1]
    names = archive.strings("joint_names")
    for skeleton in STANDARD_SKELETONS.values():
        same_names = names == skeleton.joint_names and "offsets" not in archive
        if skeleton.num_joints == num_joints and (same_names or "joint_names" not in archive):
            return skeleton
    if len(names) != num_joints:
        message = f"{len(names)} joint_names for {num_joints} joints; only 22 (SMPL's) and 21 (KIT's) need none"
        raise FormatError(message, path=path, reason="channel-count")

    def joints(key: str, shape: npy.Shape, lowest: int = 0) -> list[Any]:
        indices = archive.exact(key, shape)
        if not ((indices >= lowest) & (indices < num_joints) & (indices == np.rint(indices))).all():
            raise ValueError(f"{key}: joints are numbered {lowest} … {num_joints - 1}, these are not")
        whole: list[Any] = indices.astype(np.int64).tolist()
        return whole

    layout_map = "".join(archive.strings("layout_map"))
    try:
        if layout_map:
            parse_layout_map(layout_map)
        parents = (-1, *(0,) * (num_joints - 1))
        if "parents" in archive:
            parents = tuple(joints("parents", (num_joints,), -1))
        pairs = joints("left_right_pairs", (None, 2)) if "left_right_pairs" in archive else []
        tips = joints("end_site_joints", (None,)) if "end_site_joints" in archive else []
        tip_offsets = archive.exact("end_site_offsets", (len(tips), 3)).tolist() if tips else []
        return Skeleton(
            archive.text("skeleton") if "skeleton" in archive else rig_name(names),
            names,
            parents,
            archive.numbers("offsets", (num_joints, 3))
            if "offsets" in archive
            else bones_of_pose(joint_positions[0], parents),
            left_right_pairs=tuple((left, right) for left, right in pairs),
            feet=Feet(*joints("feet", (4,))) if "feet" in archive else None,
            end_sites=tuple((joint, (x, y, z)) for joint, (x, y, z) in zip(tips, tip_offsets, strict=True)),
            layout_map=layout_map,
        )
    except (ValueError, MotionkitError) as error:
        raise FormatError(str(error), path=path, reason="bones") from None


def bones_of_pose(pose: Float32[np.ndarray, "joints 3"], parents: tuple[int, ...]) -> Float32[np.ndarray, "joints 3"]:
    """Offsets in metres that make a pose the rest pose; the root's is zero."""
    return np.asarray(pose - pose[np.maximum(parents, 0)], np.float32)


def accepts(head: FileHead) -> bool:
    """Whether an .npz file lists joint_positions; a broken file passes, so that reading it reports the fault."""
    return not head.array_names or "joint_positions" in head.array_names


def read_npz(path: Path, options: ReadOptions = ReadOptions()) -> Motion:
    """Read one motion; lengths are multiplied by `options.unit_metres`, `options.fps` replaces the clock's framerate.

    Raises `FormatError`, with the reason `no-framerate` if there is no clock and `frame-time` for uneven time stamps.
    """
    data = source_file.read_bytes(path)
    archive = npy.open_archive(path, data)
    fill = options.fill_missing
    positions = archive.numbers("joint_positions", (None, None, 3), fill_missing=fill)
    num_frames, num_joints, _ = positions.shape
    grid, stated_fps, log = _clock(archive, num_frames, options)
    operations = (*archive.strings("operations"), *log)
    source = source_file.provenance(path, data, "npz", operations, stated_fps=stated_fps)
    texts: dict[str, Any] = {name: archive.text(name) for name in PROVENANCE}
    rotations = root = None
    if "local_rotations" in archive:
        rotations = archive.numbers("local_rotations", (num_frames, num_joints, 4), fill_missing=fill)
        error = np.abs(np.linalg.norm(rotations, axis=-1) - 1.0).max(axis=1)
        if error.max() > MAX_LENGTH_ERROR:
            message = f"local_rotations: a quaternion's length is off 1 by {error.max():.3g}, expected unit quaternions"
            frame = int(np.argmax(error > MAX_LENGTH_ERROR))
            raise FormatError(message, path=path, reason="range", frame=frame)
    if "root_translation" in archive:
        root = archive.numbers("root_translation", (num_frames, 3), fill_missing=fill)
    motion = Motion(
        joint_positions=positions,
        skeleton=read_skeleton(archive, positions),
        timegrid=grid,
        local_rotations=rotations,
        root_translation=root,
        captions=_captions(archive),
        action=archive.text("action"),
        style=archive.text("style"),
        split=archive.text("split"),
        sequence_id=archive.text("sequence_id") or path.stem,
        provenance=replace(source, **texts),
    )
    return in_metres(motion, options.unit_metres)


def write_npz(motion: Motion, path: Path) -> None:
    """Write a motion with all its fields; that read by `read_npz` differs only in the file's name and hash."""
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
    write_arrays(path, {name: array for name, array in arrays.items() if array is not None})


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
    """The grid in use, the framerate as the source stated it, and the log's lines."""
    path, stated, words, start = archive.path, None, "", 0.0
    seconds = archive.exact("time_seconds", (num_frames,)) if "time_seconds" in archive else None
    if seconds is not None and np.isfinite(seconds[0]):
        start = float(seconds[0])
    try:
        stated, words = _stated_fps(archive)
        if seconds is not None:
            stated = source_file.grid_of_seconds(seconds, path, stated).fps
            words = words or f"time_seconds: {stated}"
    except FormatError:
        if options.fps is None:
            raise
    fps = options.fps or stated
    if fps is None:
        message = "neither fps nor time_seconds says the framerate; add one, or use --fps"
        raise FormatError(message, path=path, reason="no-framerate")
    words = archive.text("stated_fps") if "stated_fps" in archive else words
    return TimeGrid(fps, num_frames, start), words, source_file.replaced_fps(fps, stated)


def _stated_fps(archive: npy.Archive) -> tuple[Fraction | None, str]:
    try:
        if "fps_numerator" in archive and "fps_denominator" in archive:
            pair = [int(archive.exact(key, ())) for key in ("fps_numerator", "fps_denominator")]
            fps = parse_fps(Fraction(*pair))
            return fps, f"fps: {fps}"
        if "fps" in archive:
            value = archive.scalar("fps")
            if value is None:
                raise ValueError("a Python object, which is not loaded")
            return parse_fps(value), f"fps: {value}"
    except (ValueError, OverflowError, ZeroDivisionError) as error:
        raise FormatError(f"fps: {error}", path=archive.path, reason="frame-time") from None
    return None, ""


def _captions(archive: npy.Archive) -> tuple[Caption, ...]:
    texts = archive.strings("captions")
    tokens = archive.strings("caption_tokens") or ("",) * len(texts)
    if len(tokens) != len(texts):
        message = f"{len(tokens)} caption_tokens for {len(texts)} captions"
        raise FormatError(message, path=archive.path, reason="channel-count")
    bounds = np.tile([0.0, np.nan], (len(texts), 1))
    if "caption_seconds" in archive:
        bounds = archive.exact("caption_seconds", (len(texts), 2))
    if not np.isfinite(bounds[:, 0]).all() or np.isinf(bounds[:, 1]).any():
        raise FormatError("caption_seconds: a start that is no number", path=archive.path, reason="text")
    return tuple(
        Caption(text, start, None if np.isnan(end) else end, words)
        for text, (start, end), words in zip(texts, bounds.tolist(), tokens, strict=True)
    )
