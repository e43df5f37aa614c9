"""Windows by seconds of a store of several framerates, as torch's `DataLoader` gives them."""

import pickle
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch.utils.data import DataLoader

import motionkit as mk

# Frames by framerate: 2.5 s, and of 30 fps one second.
FRAMES = {"20": 50, "60": 150, "120": 300, "30": 30, "30000/1001": 75}
CAPTIONS = (mk.Caption("walks", 0.0, 1.0), mk.Caption("jumps", 1.0))


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> mk.Store:
    """Five motions in as many parts."""
    path = tmp_path_factory.mktemp("clips") / "store"
    for number, (fps, num_frames) in enumerate(FRAMES.items()):
        positions = np.random.default_rng(number).normal(size=(num_frames, 22, 3)).astype(np.float32)
        motion = mk.Motion.from_joints(positions, fps=Fraction(fps))
        with mk.StoreWriter.append(path) if number else mk.StoreWriter.create(path) as writer:
            writer.add(replace(motion, sequence_id=fps, captions=CAPTIONS, action="walk", split="train"))
    assert len(mk.Store.open(path).manifest.parts) == len(FRAMES)
    return mk.Store.open(path)


def key(item):
    return item["sequence_id"], float(item["start_seconds"])


@pytest.mark.parametrize(
    ("options", "windows", "too_short"),
    [
        ({"seconds": 2.0}, {"20": 1, "60": 1, "120": 1, "30000/1001": 1}, 1),
        ({"seconds": 1.0}, {"20": 2, "60": 2, "120": 2, "30": 1, "30000/1001": 2}, 0),
        ({"seconds": 2.0, "stride_seconds": 0.25}, {"20": 3, "60": 3, "120": 3, "30000/1001": 3}, 1),
        ({"seconds": 9.0, "min_seconds": 1.0}, dict.fromkeys(FRAMES, 1), 0),
        ({"seconds": 9.0, "min_seconds": 2.5, "where": "fps < 60"}, {"20": 1, "30000/1001": 1}, 1),
    ],
)
def test_windows_of_a_store(store, options, windows, too_short):
    clips = mk.ClipDataset(str(store.path), **options)
    stream = mk.ClipStream(str(store.path), seed=0, **options)
    counts = {name: [key(clip)[0] for clip in clips].count(name) for name in windows}
    assert (counts, len(clips), stream.num_windows) == (windows, sum(windows.values()), sum(windows.values()))
    assert clips.num_too_short == stream.num_too_short == too_short
    assert f"{len(windows)} sequences; {too_short} too short" in repr(clips)
    by_key = {key(item): item for item in stream}
    assert len(by_key) == len(clips)
    for clip in clips:
        assert all(np.array_equal(value, by_key[key(clip)][name]) for name, value in clip.items())


@pytest.mark.parametrize(
    "options", [{"seconds": 9.0}, {"seconds": 0.0}, {"seconds": 1.0, "min_seconds": 2.0}, {"seconds": float("nan")}]
)
def test_lengths_without_a_window_are_refused(store, options):
    with pytest.raises(mk.UsageError, match=r"seconds|shorter"):
        mk.ClipDataset(store, **options)


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seconds=st.floats(0.06, 2.5), stride=st.floats(0.05, 3.0), min_share=st.floats(0.1, 1.0))
def test_times_and_masks_are_those_of_the_frames(store, seconds, stride, min_share):
    clips = mk.ClipDataset(store, seconds=seconds, stride_seconds=stride, min_seconds=min_share * seconds)
    batch = mk.collate_clips(list(clips))
    assert batch["seconds"].dtype == batch["start_seconds"].dtype == torch.float64
    for row, name in enumerate(batch["sequence_id"]):
        fps, motion, count = Fraction(name), store[name], int(batch["mask"][row].sum())
        assert batch["mask"][row].tolist() == [k < count for k in range(batch["mask"].shape[1])]
        assert batch["seconds"][row, :count].tolist() == [float(k / fps) for k in range(count)]
        assert count == min(sum(k / fps < seconds - 1e-6 for k in range(FRAMES[name] + 1)), FRAMES[name])
        start = round(batch["start_seconds"][row].item() * fps)
        assert batch["start_seconds"][row].item() == float(start / fps)
        expected = motion.joint_positions[start : start + count]
        np.testing.assert_array_equal(batch["joint_positions"][row, :count], expected)
        assert not batch["joint_positions"][row, count:].any()


def test_a_batch_of_three_framerates(store):
    clips = mk.ClipDataset(store, seconds=1.0, where="fps IN (20, 60, 120)")
    (batch,) = DataLoader(clips, batch_size=6, collate_fn=mk.collate_clips)
    assert batch["joint_positions"].shape == (6, 120, 22, 3)
    assert batch["fps"].tolist() == [20.0, 20.0, 60.0, 60.0, 120.0, 120.0]
    assert batch["mask"].sum(1).tolist() == [20, 20, 60, 60, 120, 120]
    assert batch["captions"] == [("walks",), ("jumps",)] * 3
    assert batch["action"] + batch["split"] == ["walk"] * 6 + ["train"] * 6
    assert [store[index].sequence_id for index in batch["sequence_index"].tolist()] == batch["sequence_id"]


def test_two_workers_of_two_ranks_give_every_window_once(store):
    keys = []
    for rank in range(2):
        stream = mk.ClipStream(store, seconds=0.5, seed=3, buffer=4, rank=rank, world_size=2)
        sent = pickle.loads(pickle.dumps(stream))  # noqa: S301 (workers that are not forked)
        keys += map(key, DataLoader(sent, batch_size=None, num_workers=2))
    assert sorted(keys) == sorted(map(key, mk.ClipDataset(store, seconds=0.5)))
    with pytest.raises(mk.UsageError, match="5 parts"):
        mk.ClipStream(store, seconds=0.5, seed=0, world_size=6)


def test_the_order_is_that_of_seed_and_epoch(store):
    def order(seed, epoch=0, buffer=512):
        stream = mk.ClipStream(store, seconds=0.5, seed=seed, buffer=buffer)
        stream.epoch = epoch
        return list(map(key, stream))

    assert order(1) == order(1) != order(2)
    assert order(1, epoch=1) != order(1)
    in_parts = [name for name, _ in order(1, buffer=1)]
    assert sorted(in_parts, key=in_parts.index) == in_parts
