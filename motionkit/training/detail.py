"""The stage `detail` of `motionkit train`, and a run's detail."""

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch

from motionkit.core.errors import UsageError
from motionkit.core.progress import task
from motionkit.core.skeleton import SMPL22
from motionkit.fields.detail import GRID_FPS, Detail, fit_detail
from motionkit.fields.resample import resample_positions
from motionkit.store.cache import PositionCache, open_cache
from motionkit.training.loop import load_tensors, rebuilding, save_tensors
from motionkit.training.run import RunFolder, Stage, StageContext

NAME = "detail"


@dataclass(frozen=True)
class DetailConfig:
    """Training sequences of detail: those of 120 fps or more, a random selection of up to some minutes.

    `where` (SQL) selects the sequences.
    """

    where: str = "split NOT IN ('val', 'test')"
    minutes: float = 40.0


def train_detail(context: StageContext, config: DetailConfig) -> None:
    """Learn detail; write RUN/detail/model.safetensors, which `load_detail` reads.

    Raises `UsageError` for a store without training sequences of 120 fps.
    """
    cache, fast = _fast_sequences(context, config)
    captures: list[np.ndarray] = []
    frames = 0
    for index in np.random.default_rng(context.seed).permutation(fast).tolist():
        if frames >= config.minutes * 60 * GRID_FPS:
            break
        capture = resample_positions(cache.sequence_positions(index), cache.exact_fps(index), Fraction(GRID_FPS))
        if len(capture) > 1:
            captures.append(capture)
            frames += len(capture)
    store = context.open_store()
    folder = context.begin(NAME, config, store_fingerprint=store.fingerprint)
    with task(context.on_progress, NAME, 2 * len(captures)) as work:
        detail = fit_detail(captures, work.advance)
    tensors = {name: torch.from_numpy(np.ascontiguousarray(values)) for name, values in detail.arrays().items()}
    save_tensors(folder.model_path, tensors, {"store_fingerprint": store.fingerprint})
    folder.finish({"takes": len(captures), "minutes": frames / GRID_FPS / 60})


def _fast_sequences(context: StageContext, config: DetailConfig) -> tuple[PositionCache, list[int]]:
    """The training sequences, and the indices of those with 120 fps or more; raises `UsageError` if none has."""
    cache = open_cache(context.open_store(), layout=SMPL22.name, where=config.where or None)
    rates = map(cache.exact_fps, range(cache.num_sequences))
    fast = [index for index, fps in enumerate(rates) if fps >= GRID_FPS and cache.num_frames[index] > fps / GRID_FPS]
    if not fast:
        raise UsageError(
            f"{context.store}: detail is learnt from captures of {GRID_FPS} fps or more, and none of the "
            f"{cache.num_sequences} sequences for training is as fast"
        )
    return cache, fast


def load_detail(run: Path) -> Detail:
    """Load a run's detail; raises `RunError`, with the command that trains it, if it has none."""
    stage = RunFolder(run).stage(NAME)
    stage.read_summary()
    path = stage.model_path
    tensors, _ = load_tensors(path)
    with rebuilding(path, NAME):
        return Detail(**{name: tensor.numpy() for name, tensor in tensors.items()})


STAGE = Stage(
    name=NAME,
    description="captured motion above 10 Hz, for motionkit generate --detail",
    recipes=dict.fromkeys(("demo", "nano", "small", "base", "paper"), DetailConfig),
    train=train_detail,
    check=_fast_sequences,
)
