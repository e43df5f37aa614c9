"""Clips of a store as a map-style data set for torch's `DataLoader`, for your own training loop."""

from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core.errors import UsageError
from motionkit.store.cache import open_cache
from motionkit.store.reader import Store


class ClipDataset:
    """Clips of `num_frames` frames of a store's sequences, each at its sequence's own framerate, `stride` frames apart.

    `store` is a `Store`, or the path of one.
    An item holds `joint_positions` [num_frames, J, 3] (float32, metres) of the `layout`, `fps`, `start_seconds` of its
    first frame in its sequence, and `sequence_index`, its index in the store; `DataLoader` makes tensors of them, in
    batches. Frames come from the store's training cache, a memory map that workers share. `where` is a SQL condition
    over the table of sequences. Raises `UsageError` if no sequence is long enough, and what `open_cache` raises.

    >>> clips = mk.ClipDataset("store", num_frames=32, where="fps = 60")
    >>> clips[0]["joint_positions"].shape, clips[0]["fps"]
    ((32, 22, 3), 60.0)
    """

    def __init__(
        self,
        store: Store | str | Path,
        *,
        num_frames: int = 64,
        stride: int | None = None,
        where: str | None = None,
        layout: str = "smpl22",
    ) -> None:
        every = num_frames if stride is None else stride
        if num_frames < 1 or every < 1:
            raise UsageError(f"num_frames and stride must be 1 or more, not {num_frames} and {every}")
        self.num_frames = num_frames
        store = store if isinstance(store, Store) else Store.open(store)
        self._cache = open_cache(store, layout=layout, where=where)
        counts = np.maximum(0, (self._cache.num_frames.astype(np.int64) - num_frames) // every + 1)
        if not counts.sum():
            raise UsageError(f"no sequence of {store.path} has {num_frames} frames: ask for shorter clips")
        self._sequence = np.repeat(np.arange(len(counts)), counts)
        self._start = every * (np.arange(len(self._sequence)) - np.repeat(np.cumsum(counts) - counts, counts))

    def __len__(self) -> int:
        return len(self._sequence)

    def __getitem__(self, index: int) -> dict[str, Any]:
        return self.__getitems__([range(len(self))[index]])[0]

    def __getitems__(self, indices: list[int]) -> list[dict[str, Any]]:
        """Several items at once, as `DataLoader` fetches them."""
        cache, sequence, start = self._cache, self._sequence[indices], self._start[indices]
        fps = cache.fps_numerator[sequence] / cache.fps_denominator[sequence]
        clips = cache.gather_clips(sequence, start, self.num_frames)
        columns = zip(clips, fps.tolist(), (start / fps).tolist(), cache.sequence_index[sequence].tolist(), strict=True)
        names = ("joint_positions", "fps", "start_seconds", "sequence_index")
        return [dict(zip(names, values, strict=True)) for values in columns]
