"""Two processes that each see a part have the value of the whole."""

from pathlib import Path

import numpy as np
import pytest
import torch
import torch.distributed
from torch.multiprocessing import spawn

from eval import FID, ClipFID, DeclaredMean, RPrecision
from eval.clip_fid import features

RNG = np.random.default_rng(0)
ROWS = torch.from_numpy(RNG.normal(size=(80, 6)))
OTHERS = ROWS + torch.from_numpy(RNG.normal(size=(80, 6)))
JOINTS = torch.from_numpy(RNG.normal(size=(2, 80, 22, 3)))
MOTIONS = [torch.from_numpy(RNG.normal(size=(length, 22, 3)).cumsum(axis=0) / 50) for length in (80, 100, 70)]
PARTS = (slice(0, 30), slice(30, 80))


def values(rows: slice, motions: slice) -> dict[str, float]:
    """What the metrics say after a part of the data; in a group of processes, after all of it."""
    features.FIT_CLIPS = 256
    fid, pairs, error = FID(), RPrecision(), DeclaredMean("mpjpe")
    clips = ClipFID(60, [motion.numpy() for motion in MOTIONS[:2]], clips=64, replications=2)
    fid.update(ROWS[rows], real=True)
    fid.update(OTHERS[rows], real=False)
    pairs.update(ROWS[rows], OTHERS[rows])
    error.update(JOINTS[0, rows], JOINTS[1, rows])
    clips.update(MOTIONS[motions])
    single = {"fid": fid.compute(), "mpjpe": error.compute()}
    return {name: float(value) for name, value in (single | pairs.compute() | clips.compute()).items()}


def work(rank: int, folder: str) -> None:
    """One of two processes: computes, and leaves what it found."""
    torch.distributed.init_process_group("gloo", init_method=f"file://{folder}/meet", rank=rank, world_size=2)
    found = values(PARTS[rank], (slice(0, 2), slice(2, 3))[rank])
    torch.save(found, Path(folder) / f"{rank}.pt")
    torch.distributed.destroy_process_group()


def test_two_processes_have_the_value_of_the_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(features, "FIT_CLIPS", 256)
    spawn(work, args=(str(tmp_path),), nprocs=2)
    expected = values(slice(0, 80), slice(0, 3))
    for rank in range(2):
        assert torch.load(tmp_path / f"{rank}.pt", weights_only=True) == pytest.approx(expected, rel=1e-12)
