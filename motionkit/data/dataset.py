"""Windows of a store's motions by seconds, as a map-style data set for torch's `DataLoader`."""

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from motionkit.core.errors import UsageError, counted
from motionkit.core.shapes import Float32, Int, Int64
from motionkit.core.timegrid import SAME_SECONDS, TimeGrid
from motionkit.data.captions import overlapping_captions
from motionkit.store.cache import open_cache
from motionkit.store.reader import Store

COLUMNS = ("sequence_index", "sequence_id", "fps_numerator", "fps_denominator", "captions", "action", "split")


@dataclass(frozen=True, eq=False)
class ClipFrames:
    """W windows as frames [start, start + num_frames) of sequences; `sequence` is a row of `sequences`, ascending."""

    sequences: pa.Table
    sequence: Int64[np.ndarray, "windows"]
    start: Int64[np.ndarray, "windows"]
    num_frames: Int64[np.ndarray, "windows"]
    num_too_short: int
    text: str

    def item(self, window: int, positions: Float32[np.ndarray, "sequence_frames joints 3"]) -> dict[str, Any]:
        """One item of a data set, with the window's frames of all `positions` of its sequence."""
        (item,) = self.sequences.slice(self.sequence[window], 1).to_pylist()
        fps, start = Fraction(item.pop("fps_numerator"), item.pop("fps_denominator")), int(self.start[window])
        stop = start + int(self.num_frames[window])
        begin, end = float(start / fps), float(stop / fps)
        item["captions"] = overlapping_captions(item["captions"], begin, end)
        times = {"seconds": TimeGrid(fps, stop - start).seconds(), "start_seconds": begin, "fps": float(fps)}
        return {"joint_positions": positions[start:stop].copy(), **times, **item}


def clip_frames(
    store: Store,
    indices: Int[np.ndarray, "sequences"],
    num_unmapped: int,
    seconds: float,
    stride_seconds: float | None,
    min_seconds: float | None,
) -> ClipFrames:
    """The windows of these sequences of a store, as `ClipDataset` describes them; raises `UsageError` for none."""
    stride = seconds if stride_seconds is None else stride_seconds
    shortest = seconds if min_seconds is None else min_seconds
    if not (0 < shortest <= seconds < np.inf and 0 < stride < np.inf):
        raise UsageError(
            "seconds, stride_seconds and min_seconds must be positive, and min_seconds at most seconds, "
            f"not {seconds:g}, {stride:g} and {shortest:g}"
        )
    table = store.sequences_table.take(store.rows_of(indices))
    frames = table["num_frames"].to_numpy().astype(np.int64)
    fps = table["fps_numerator"].to_numpy() / table["fps_denominator"].to_numpy()
    # Frame k belongs to a window if k / fps < seconds.
    full, fewest = (np.ceil((each - SAME_SECONDS) * fps).astype(np.int64) for each in (seconds, shortest))
    step = np.maximum(1, np.round(stride * fps).astype(np.int64))
    counts = np.where(frames < full, frames >= fewest, (frames - full) // step + 1)
    too_short = int((counts == 0).sum())
    windows, sequences = counted(int(counts.sum()), "window"), counted(len(counts) - too_short, "sequence")
    text = f"{windows} of {seconds:g} s, {sequences}; {too_short} too short"
    text += f", {num_unmapped} of other skeletons" if num_unmapped else ""
    if not counts.any():
        raise UsageError(f"no sequence of {store.path} lasts {shortest:g} s ({text}): ask for shorter windows")
    sequence = np.repeat(np.arange(len(counts)), counts)
    start = step[sequence] * (np.arange(len(sequence)) - np.repeat(np.cumsum(counts) - counts, counts))
    return ClipFrames(table.select(COLUMNS), sequence, start, np.minimum(full, frames)[sequence], too_short, text)


class ClipDataset:
    """Windows of `seconds` of a store's motions at their own framerates, `stride_seconds` apart (default: `seconds`).

    `store` is a `Store`, or the path of one. A sequence shorter than `seconds` is one window if it lasts `min_seconds`
    (default: `seconds`) and else one of `num_too_short`. `where` is a SQL condition over the table of sequences.

    An item holds `joint_positions` [T, J, 3] (float32, metres) of the `layout`; `seconds` [T] (float64), frame k at
    k / fps; `start_seconds` of its first frame in its sequence; `fps`; `captions`, those whose time overlaps the
    window's by half of the shorter; `sequence_index`, `sequence_id`, `action` and `split`. `collate_clips` makes
    batches. Frames come from the store's training cache, a memory map that workers share. Raises `UsageError` if no
    sequence is long enough, and what `open_cache` raises.

    >>> clips = mk.ClipDataset("store", seconds=0.5, where="fps = 60")
    >>> clips
    ClipDataset(15 windows of 0.5 s, 3 sequences; 0 too short)
    >>> clips[0]["joint_positions"].shape, clips[1]["start_seconds"]
    ((30, 22, 3), 0.5)
    """

    def __init__(
        self,
        store: Store | str | Path,
        *,
        seconds: float,
        stride_seconds: float | None = None,
        min_seconds: float | None = None,
        where: str | None = None,
        layout: str = "smpl22",
    ) -> None:
        store = store if isinstance(store, Store) else Store.open(store)
        self._cache = cache = open_cache(store, layout=layout, where=where)
        skipped = len(cache.skipped)
        self._windows = clip_frames(store, cache.sequence_index, skipped, seconds, stride_seconds, min_seconds)
        self.num_too_short = self._windows.num_too_short

    def __len__(self) -> int:
        return len(self._windows.start)

    def __getitem__(self, index: int) -> dict[str, Any]:
        window = range(len(self))[index]
        return self._windows.item(window, self._cache.sequence_positions(self._windows.sequence[window]))

    def __repr__(self) -> str:
        return f"ClipDataset({self._windows.text})"
