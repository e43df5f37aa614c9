"""The training cache holds the store's frames bit by bit, and its clips are the frames they claim to be."""

import json
import pickle
import shutil
import subprocess
import sys
import textwrap
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from motionkit.errors import StoreError, UsageError
from motionkit.skeleton import KIT21, SMPL22, Skeleton
from motionkit.skeletons.mapping import map_joints
from motionkit.store import Store, StoreWriter, cache

CHAIN = Skeleton("chain", ("a", "b", "c"), (-1, 0, 1), np.eye(3, dtype=np.float32))


@pytest.fixture
def mixed_store(tmp_path: Path, make_motion) -> Path:
    """Motions on three skeletons, one of which has no body."""
    with StoreWriter.create(tmp_path / "mixed") as writer:
        writer.add(make_motion("smpl", 50))
        writer.add(make_motion("chain", 60, skeleton=CHAIN))
        writer.add(make_motion("long", 700, fps=Fraction(30000, 1001), split="test"))
    return tmp_path / "mixed"


def test_the_cache_holds_the_frames_of_the_store(small_store):
    store = Store.open(small_store)
    built = cache.open_cache(store)
    assert built.positions.dtype == np.float32
    assert not built.positions.flags.writeable
    assert built.num_joints == 22
    assert built.skipped == ()
    np.testing.assert_array_equal(built.sequence_index, np.arange(6))
    np.testing.assert_array_equal(built.num_frames, store.sequences["num_frames"])
    np.testing.assert_array_equal(built.fps_numerator, store.sequences["fps_numerator"])
    np.testing.assert_array_equal(built.fps_denominator, store.sequences["fps_denominator"])
    for n in range(built.num_sequences):
        np.testing.assert_array_equal(built.sequence_positions(n), map_joints(store.read(n), "smpl22"))


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_clips_are_the_frames_they_claim_to_be(small_store, data):
    built = cache.open_cache(Store.open(small_store))
    num_frames = data.draw(st.integers(1, 40))
    sequence = np.array(data.draw(st.lists(st.integers(0, 5), min_size=0, max_size=8)), np.int64)
    start = np.array([data.draw(st.integers(0, int(built.num_frames[n]) - num_frames)) for n in sequence], np.int64)
    clips = built.gather_clips(sequence, start, num_frames)
    assert clips.shape == (len(sequence), num_frames, 22, 3)
    for clip, n, first in zip(clips, sequence, start, strict=True):
        np.testing.assert_array_equal(clip, built.sequence_positions(n)[first : first + num_frames])


@pytest.mark.parametrize(("start", "num_frames"), [(-1, 8), (33, 8), (0, 41)])
def test_a_clip_may_not_leave_its_sequence(small_store, start, num_frames):
    built = cache.open_cache(Store.open(small_store))
    with pytest.raises(IndexError, match="do not lie inside the 40 frames"):
        built.gather_clips(np.array([3, 0]), np.array([5, start]), num_frames)
    with pytest.raises(IndexError, match="at least one frame"):
        built.gather_clips(np.array([0]), np.array([0]), 0)


def test_a_filter_and_sequences_that_do_not_fit(mixed_store):
    store = Store.open(mixed_store)
    everything = cache.open_cache(store)
    assert list(everything.sequence_index) == [0, 2]
    assert [(each.sequence_index, each.sequence_id) for each in everything.skipped] == [(1, "chain")]
    assert "cannot be mapped to smpl22" in everything.skipped[0].reason
    tests = cache.open_cache(store, where="split = 'test'")
    assert list(tests.sequence_index) == [2]
    assert tests.path != everything.path
    np.testing.assert_array_equal(tests.positions, store.read("long").joint_positions)
    assert cache.open_cache(store, layout="kit21", where="split = 'test'").num_joints == KIT21.num_joints


def test_native_joints_need_one_number_of_joints(mixed_store):
    store = Store.open(mixed_store)
    with pytest.raises(UsageError, match="have 3, 22: choose with a condition"):
        cache.open_cache(store, layout="native")
    native = cache.open_cache(store, layout="native", where="num_joints = 3")
    np.testing.assert_array_equal(native.positions, store.read("chain").joint_positions)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"layout": "smpl"}, "no layout 'smpl'"),
        ({"where": "split = 'nowhere'"}, "no sequence of"),
        ({"where": "no_such_column > 1"}, "duckdb: .*no_such_column"),
        ({"where": "sequence_id = 'chain'"}, "none of the 1 chosen sequences can be brought to smpl22"),
    ],
)
def test_requests_that_make_no_sense(mixed_store, options, says):
    with pytest.raises(UsageError, match=says):
        cache.open_cache(Store.open(mixed_store), **options)


def test_a_cache_is_built_once_and_follows_the_store(small_store, make_motion, monkeypatch):
    store = Store.open(small_store)
    first = cache.open_cache(store)
    with monkeypatch.context() as patched:
        patched.setattr(cache, "_build", None)
        assert cache.open_cache(Store.open(small_store)).path == first.path
    with StoreWriter.append(small_store) as writer:
        writer.add(make_motion("new", 33))
    second = cache.open_cache(Store.open(small_store))
    assert second.num_sequences == 7
    assert not first.path.exists(), "the cache of an earlier state is removed"
    assert first.positions[-1].shape == (22, 3), "and stays valid for those who mapped it"


def test_a_cache_travels_to_another_process(small_store):
    built = cache.open_cache(Store.open(small_store))
    pickled = pickle.dumps(built)
    assert len(pickled) < 1000, "the map is opened again, not copied"
    again = pickle.loads(pickled)  # noqa: S301 - our own bytes, as a data loader's worker gets them
    np.testing.assert_array_equal(again.positions, built.positions)


def test_a_killed_builder_leaves_nothing_that_is_used(small_store, monkeypatch):
    store = Store.open(small_store)

    def killed(source: Path) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(cache.files, "sync_file", killed)
        with pytest.raises(KeyboardInterrupt):
            cache.open_cache(store)
    (left,) = (path for path in (small_store / "cache").iterdir() if path.is_dir())
    assert left.name.startswith("building-")
    built = cache.open_cache(store)
    np.testing.assert_array_equal(built.sequence_positions(0), store.read(0).joint_positions)
    assert [path for path in (small_store / "cache").iterdir() if path.is_dir()] == [built.path]


def test_two_builders_at_once(small_store):
    program = textwrap.dedent(
        """
        import sys
        from motionkit.store import Store
        from motionkit.store.cache import open_cache
        sys.stdin.read(1)
        print(len(open_cache(Store.open(sys.argv[1])).positions))
        """
    )
    children = [
        subprocess.Popen(
            [sys.executable, "-c", program, str(small_store)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for _ in range(2)
    ]
    assert [child.communicate("x")[0].strip() for child in children] == ["812"] * 2
    assert len([path for path in (small_store / "cache").iterdir() if path.is_dir()]) == 1


def test_a_disk_that_is_too_small(small_store, monkeypatch):
    usage = shutil.disk_usage(small_store)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=1000))
    with pytest.raises(StoreError, match="free some space"):
        cache.open_cache(Store.open(small_store))


def test_the_key_knows_the_joint_maps(small_store, monkeypatch):
    """Another table of joints makes another cache: an old one is never taken for it."""
    store = Store.open(small_store)
    first = cache.open_cache(store)
    facts = json.loads((first.path / "cache.json").read_text())
    assert facts["layout"] == SMPL22.name
    original = cache.joint_map

    def shifted(skeleton, layout):
        mapping = original(skeleton, layout)
        return type(mapping)(**{**vars(mapping), "weights": mapping.weights[::-1].copy()})

    monkeypatch.setattr(cache, "joint_map", shifted)
    assert cache.open_cache(store).path != first.path
