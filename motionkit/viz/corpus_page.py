"""A store as one page of cards with moving thumbnails, to filter, play and mark (docs/view.md)."""

from collections.abc import Iterator, Sequence
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core.errors import MotionkitError, UsageError, counted
from motionkit.core.files import write_whole
from motionkit.core.motion import Motion
from motionkit.core.progress import OnProgress, ignore, tracked
from motionkit.core.shapes import Int64
from motionkit.core.skeletons.mapping import SkeletonMapError, counterpart_joints
from motionkit.store import Store
from motionkit.viz.player import Panel, check_places, data_text, drawing_of, filled, pack, packed_bytes

# Thumbnails are every n-th native frame, nothing is resampled: about 10 fps, at most 4 s from the middle.
THUMBNAIL_FPS, THUMBNAIL_SECONDS = 10, 4
# 40 frames of 22 joints. Bodies of more joints have shorter thumbnails, so that 2,000 sequences stay below 20 MB.
THUMBNAIL_BYTES = packed_bytes(THUMBNAIL_FPS * THUMBNAIL_SECONDS, 22)
MOST_JOINTS, MOST_SEQUENCES = 64, 5000
SCRIPTS = ("packing.js", "clock.js", "camera.js", "panel.js", "marks.js", "corpus.js")
COLUMNS = ("sequence_id", "source", "action", "split", "subject", "source_path", "num_frames", "duration_seconds")


def write_corpus_page(
    path: Path, store: Store, indices: Int64[np.ndarray, "sequences"], on_progress: OnProgress = ignore
) -> list[tuple[str, str]]:
    """Write the page of some sequences atomically, and return id and message of those that cannot be drawn.

    Raises `UsageError` for more than 5,000 sequences.
    """
    if len(indices) > MOST_SEQUENCES:
        every = ceil(len(indices) / MOST_SEQUENCES)
        raise UsageError(
            f"a page shows at most {MOST_SEQUENCES:,} sequences, not {len(indices):,}: choose with --where, "
            f'as --where "sequence_index % {every} = 0"'
        )
    failures: list[tuple[str, str]] = []

    def cards() -> Iterator[dict[str, Any]]:
        rows = store.sequences_table.take(store.rows_of(indices)).select([*COLUMNS, "quality_flags"]).to_pylist()
        motions = store.read_many(indices, rotations=False)
        for row, motion in tracked(on_progress, "draw", zip(rows, motions, strict=True), len(rows)):
            try:
                yield _card(row, motion)
            except MotionkitError as error:
                failures.append((row["sequence_id"], str(error)))

    title = f"{store.path.absolute().name}: {counted(len(indices), 'sequence')}"
    data = {"store": str(store.path), "cards": list(cards())}
    page = filled("corpus.html", title, data_text(data), SCRIPTS, ("style.css", "corpus.css"))
    write_whole(path, page)
    return failures


def _card(row: dict[str, Any], motion: Motion) -> dict[str, Any]:
    check_places(Panel(row["sequence_id"], motion.joint_positions, motion.skeleton, motion.fps))
    drawing = drawing_of(motion.skeleton, motion.joint_positions)
    try:
        joints = sorted(set(counterpart_joints(motion.skeleton).values()))
    except SkeletonMapError:
        joints = list(range(0, motion.skeleton.num_joints, ceil(motion.skeleton.num_joints / MOST_JOINTS)))
    number = {joint: place for place, joint in enumerate(joints)}
    every = max(1, round(motion.fps / THUMBNAIL_FPS))
    fps = motion.fps / every
    num_frames = min(ceil(THUMBNAIL_SECONDS * fps), THUMBNAIL_BYTES // packed_bytes(1, len(joints)))
    first = max(0, ceil(motion.num_frames / every) - num_frames) // 2 * every
    positions = motion.joint_positions[first::every][:num_frames, joints]
    return {
        **{name: row[name] for name in COLUMNS},
        "name": row["sequence_id"],
        "flags": row["quality_flags"],
        "nativeFps": [motion.fps.numerator, motion.fps.denominator],
        "captions": [[each.text, each.start_seconds, each.end_seconds] for each in motion.captions],
        "fps": [fps.numerator, fps.denominator],
        "startSeconds": motion.timegrid.start_seconds + float(first / motion.fps),
        "numFrames": len(positions),
        "positions": pack(positions),
        "bones": [_nearest(drawing.bones, joint, number) for joint in joints],
        "sides": [drawing.sides[joint] for joint in joints],
        "head": number.get(drawing.head, -1),
        "yaw": drawing.yaw,
    }


def _nearest(bones: Sequence[int], joint: int, number: dict[int, int]) -> int:
    """The place of the nearest joint above that the thumbnail has, -1 if there is none."""
    above = bones[joint]
    while above >= 0 and above not in number:
        above = bones[above]
    return number.get(above, -1)
