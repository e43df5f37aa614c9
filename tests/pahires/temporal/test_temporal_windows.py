"""Training windows: real frames only, exact answers, places that are equally likely."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from motionkit.features import rotations
from motionkit.store.reader import Store
from motionkit.training.config import apply_overrides
from pahires.temporal.settings import TaskSettings, TemporalSettings
from pahires.temporal.system import open_takes
from pahires.temporal.windows import TASKS, WindowSampler, draw_layout
from tests.helpers.small_network import TASKS as SMALL_TASKS
from tests.helpers.tiny import write_store

SETTINGS = apply_overrides(TemporalSettings(tasks=SMALL_TASKS, mirrored=False), ["schedule.batch_size=16"])


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    return Store.open(write_store(tmp_path_factory.mktemp("corpus") / "store"))


@pytest.mark.parametrize("task", TASKS)
@given(seed=st.integers(0, 2**31))
def test_layouts_ascend_and_ask_for_neighbouring_frames(task: str, seed: int) -> None:
    settings = TaskSettings()
    layout = draw_layout(task, np.random.default_rng(seed), 9, settings)  # type: ignore[arg-type]
    assert (np.diff(layout.observed, axis=1) > 0).all() and (layout.observed[:, 0] == 0).all()
    assert (np.diff(layout.queried, axis=1) == 1).all() and 2 <= layout.queried.shape[1] <= settings.num_queries
    inside = (layout.queried >= 0) & (layout.queried <= layout.observed[:, -1:])
    if task == "extend":
        beyond = np.maximum(-layout.queried, layout.queried - layout.observed[:, -1:])
        assert (beyond >= 0).all() and (beyond <= settings.longest_reach).all()
    else:
        assert inside.all()
    if task == "gap":
        assert np.diff(layout.observed, axis=1).max(axis=1).min() > settings.shortest_gap


def test_takes_are_every_kth_real_frame(store: Store) -> None:
    takes = open_takes(store, SETTINGS)
    assert takes.keep_every.tolist() == [4, 1, 2, 4] and takes.skipped == 0
    for take, index in enumerate(takes.sequence_index.tolist()):
        vectors = rotations.rotation_rows(store.read(index)).vectors
        stride = takes.keep_every[take : take + 1]
        found = takes.read(np.array([take]), np.array([1]), stride, np.arange(5)[None])
        np.testing.assert_array_equal(found[0], vectors[1 :: int(stride[0])][:5])
        assert takes.num_frames[take] == len(vectors) // stride[0]


@pytest.mark.parametrize("finer", [False, True])
def test_windows_hold_what_was_captured_at_their_times(store: Store, finer: bool) -> None:
    sampler = WindowSampler(open_takes(store, SETTINGS), replace(SETTINGS, finer=finer))
    rng = np.random.default_rng(0)
    scaling = sampler.measure(rng)
    rates = set()
    for task in TASKS:
        raw = sampler.draw(rng, task, 16)
        batch = sampler.standardised(raw, task, scaling)
        rates |= set(np.round(1 / raw.seconds_between).astype(int).tolist())
        # A query at an observed instant has that frame as its answer, and the middle frame stands at the origin.
        same = batch.window.queries_seconds[:, :, None] == batch.window.times_seconds[:, None, :]
        window, query, frame = same.nonzero(as_tuple=True)
        torch.testing.assert_close(
            batch.targets[window, query], batch.window.frames[window, frame], atol=1e-5, rtol=1e-5
        )
        middle = scaling.invert(batch.window.frames)[:, (batch.window.frames.shape[1] - 1) // 2]
        assert middle[:, [0, 2]].abs().max() < 1e-5
        assert (batch.window.times_seconds.diff(dim=1) > 0).all() and (batch.window.times_seconds[:, 0] == 0).all()
    assert rates == ({30, 40, 60, 120} if finer else {30})
