"""Clips of a store as torch's DataLoader gives them: the store's own frames, at their framerates."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from torch.utils.data import DataLoader

import motionkit as mk


def test_batches_hold_the_stores_frames(tmp_path):
    frames = {30: 70, 120: 100, 60: 20}
    with mk.StoreWriter.create(tmp_path / "store") as writer:
        for fps, num_frames in frames.items():
            positions = np.random.default_rng(fps).normal(size=(num_frames, 22, 3)).astype(np.float32)
            writer.add(replace(mk.Motion.from_joints(positions, fps=Fraction(fps)), sequence_id=f"{fps}"))
    store = mk.Store.open(tmp_path / "store")
    assert len(mk.ClipDataset(str(store.path), num_frames=32)) == len(mk.ClipDataset(store.path, num_frames=32)) == 5
    clips = mk.ClipDataset(store, num_frames=32, stride=16)
    assert len(clips) == 3 + 5
    (batch,) = DataLoader(clips, batch_size=8)
    assert batch["joint_positions"].shape == (8, 32, 22, 3)
    assert batch["fps"].tolist() == [30.0] * 3 + [120.0] * 5
    motion, start = store[int(batch["sequence_index"][4])], round(float(batch["start_seconds"][4]) * 120)
    assert (motion.sequence_id, start) == ("120", 16)
    np.testing.assert_array_equal(batch["joint_positions"][4], motion.joint_positions[16:48])
    with pytest.raises(mk.UsageError, match="101"):
        mk.ClipDataset(store, num_frames=101)
