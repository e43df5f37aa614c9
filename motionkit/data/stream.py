"""Windows of a store for torch's `DataLoader`: batches of them, and a stream that reads one part at a time."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.nn.utils.rnn import pad_sequence
from torch.utils.data import IterableDataset, get_worker_info

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Int
from motionkit.core.skeletons.mapping import SkeletonMapError, joint_map, map_joints
from motionkit.data.dataset import clip_frames
from motionkit.store.reader import Store

Item = dict[str, Any]


def collate_clips(items: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """A batch of items of `ClipDataset` or `ClipStream`, for `DataLoader(…, collate_fn=mk.collate_clips)`.

    Of B windows of at most T frames: `joint_positions` [B, T, J, 3] and `seconds` [B, T] (float64) are padded with
    zeros, and `mask` [B, T] (bool) is true where frames are. `fps` and `start_seconds` [B] are float64,
    `sequence_index` [B] int64; `captions`, `sequence_id`, `action` and `split` are lists.

    >>> clips = mk.ClipDataset("store", seconds=0.5)
    >>> batch = mk.collate_clips([clips[0], clips[-1]])
    >>> batch["joint_positions"].shape, batch["fps"].tolist(), batch["mask"].sum(1).tolist()
    (torch.Size([2, 30, 22, 3]), [60.0, 30.0], [30, 15])
    """
    batch: dict[str, Any] = {name: [item[name] for item in items] for name in items[0]}
    frames = [torch.ones(len(seconds), dtype=torch.bool) for seconds in batch["seconds"]]
    for name in ("joint_positions", "seconds"):
        batch[name] = pad_sequence([torch.from_numpy(values) for values in batch[name]], batch_first=True)
    for name in ("fps", "start_seconds"):
        batch[name] = torch.tensor(batch[name], dtype=torch.float64)
    return {**batch, "sequence_index": torch.tensor(batch["sequence_index"]), "mask": pad_sequence(frames, True)}


class ClipStream(IterableDataset[Item]):  # DataLoader iterates over subclasses of it alone
    """The windows of `ClipDataset`, read from the store's parts one after the other, without a cache.

    Nothing but the tables of the store is needed at once, and of a store of the Hub (`hf://datasets/OWNER/NAME`) parts
    are downloaded as they are read. Parts come in random order, and windows are drawn from a `buffer` of so many: the
    order depends on `seed`, and on `epoch`, which is set before each epoch (not with `persistent_workers`). Each part
    is read by one worker of one rank: `rank` of `world_size`. `num_windows` are those of all ranks. Raises `UsageError`
    as `ClipDataset` does, and for fewer parts than ranks.

    >>> stream = mk.ClipStream("store", seconds=0.5, seed=0)
    >>> stream
    ClipStream(30 windows of 0.5 s, 6 sequences; 0 too short; 1 part)
    >>> sorted(next(iter(stream)))[:4]
    ['action', 'captions', 'fps', 'joint_positions']
    """

    def __init__(
        self,
        store: Store | str | Path,
        *,
        seconds: float,
        seed: int,
        stride_seconds: float | None = None,
        min_seconds: float | None = None,
        where: str | None = None,
        layout: str = "smpl22",
        buffer: int = 512,
        rank: int = 0,
        world_size: int = 1,
    ) -> None:
        if buffer < 1 or not 0 <= rank < world_size:
            raise UsageError(f"buffer must be 1 or more, rank below world_size, not {buffer}, {rank} of {world_size}")
        self._store = store = store if isinstance(store, Store) else Store.open(store)
        self._layout, self._buffer, self._shard, self._seed = layout, buffer, (rank, world_size), seed
        self._uses_tips: dict[str, bool] = {}  # tips of bones are computed from rotations
        for name, skeleton in store.skeletons.items():
            with suppress(SkeletonMapError):
                self._uses_tips[name] = bool(joint_map(skeleton, layout).tip_weights.any())
        chosen = store.columns("skeleton", "part").loc[store.select_some(where)]
        self._rows = rows = chosen[chosen["skeleton"].isin(self._uses_tips)]
        skipped = len(chosen) - len(rows)
        self._windows = clip_frames(store, rows.index.to_numpy(), skipped, seconds, stride_seconds, min_seconds)
        self._parts = np.unique(rows["part"].to_numpy()[self._windows.sequence])
        if len(self._parts) < world_size:
            raise UsageError(
                f"{store.path} has windows in {len(self._parts)} parts, too few for {world_size} ranks: write it with "
                "a smaller part_bytes, or use ClipDataset"
            )
        self.epoch = 0
        self.num_windows = len(self._windows.start)
        self.num_too_short = self._windows.num_too_short

    def __iter__(self) -> Iterator[Item]:
        worker = get_worker_info()
        number, count = (worker.id, worker.num_workers) if worker else (0, 1)
        rank, world_size = self._shard
        order = np.random.default_rng((self._seed, self.epoch)).permutation(self._parts)
        draws = np.random.default_rng((self._seed, self.epoch, rank, number))
        waiting: list[Item] = []
        for item in self._read(order[rank::world_size][number::count]):
            if len(waiting) < self._buffer:
                waiting.append(item)
                continue
            place = int(draws.integers(self._buffer))
            yield waiting[place]
            waiting[place] = item
        for place in draws.permutation(len(waiting)):
            yield waiting[place]

    def _read(self, parts: Int[np.ndarray, "parts"]) -> Iterator[Item]:
        """Items in the order of these parts, one motion in memory at a time."""
        of_windows = self._rows.iloc[self._windows.sequence]
        for part in parts:
            here = np.flatnonzero(of_windows["part"] == part)
            for sequence, windows in groupby(here.tolist(), self._windows.sequence.__getitem__):
                row = self._rows.iloc[sequence]
                motion = self._store.read(row.name, rotations=self._uses_tips[row["skeleton"]])
                positions = map_joints(motion, self._layout)
                for window in windows:
                    yield self._windows.item(window, positions)

    def __repr__(self) -> str:
        return f"ClipStream({self._windows.text}; {len(self._parts)} part{'s' * (len(self._parts) != 1)})"
