"""The training cache holds the store's frames bit by bit, and its clips are the frames they claim to be."""

import hashlib
import json
import pickle
import re
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

from motionkit.core import checksums, files
from motionkit.core.checksums import read_json, write_json
from motionkit.core.errors import StoreError, UsageError
from motionkit.core.progress import Progress
from motionkit.core.skeleton import KIT21, SMPL22, Skeleton
from motionkit.core.skeletons.mapping import map_joints
from motionkit.store import Store, StoreWriter
from motionkit.store.cache import build
from motionkit.store.cache import positions as cache
from motionkit.store.validate import faults

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


def test_building_a_cache_is_reported(small_store, capfd):
    reports: list[Progress] = []
    store = Store.open(small_store, on_progress=reports.append)
    cache.open_cache(store)
    states = [Progress("cache smpl22", done, 6) for done in range(7)]
    assert reports == [*states, Progress("cache smpl22", 6, 6, finished=True)]
    cache.open_cache(store)
    assert len(reports) == 8
    assert capfd.readouterr() == ("", "")


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
        patched.setattr(cache, "build", None)
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


KILLED = textwrap.dedent(
    """
    import os, signal, sys
    from motionkit.core import checksums, files
    from motionkit.store import Store
    from motionkit.store.cache.positions import open_cache

    sync, left = files.sync, [int(sys.argv[2])]
    def dying(path):
        if left[0] == 0: os.kill(os.getpid(), signal.SIGKILL)
        left[0] -= 1
        sync(path)
    files.sync = dying
    open_cache(Store.open(sys.argv[1]))
    """
)


# Two calls for each file that is written: marker, positions, index, cache.json; then one that ends the program.
@pytest.mark.parametrize("moment", range(9))
def test_a_killed_builder_leaves_nothing_that_is_used(small_store, make_motion, moment):
    """Neither in the store that it was for, nor in what became of it."""
    child = subprocess.run([sys.executable, "-c", KILLED, str(small_store), str(moment)], check=False)
    assert child.returncode == (-9 if moment < 8 else 0)
    changed = shutil.copytree(small_store, small_store.with_name("changed"))
    with StoreWriter.append(changed) as writer:
        writer.add(make_motion("new"))
    for path in (small_store, changed):
        store = Store.open(path)
        built = cache.open_cache(store)
        for n in range(built.num_sequences):
            np.testing.assert_array_equal(built.sequence_positions(n), store.read(n).joint_positions)
        assert files_of(built.path) == {".motionkit-cache", "cache.json", "index.npy", "positions.npy"}
        assert folders_of(path) == [built.path], "what a killed builder left is removed"


def files_of(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def folders_of(store: Path) -> list[Path]:
    return [path for path in (store / "cache").iterdir() if path.is_dir()]


def test_a_builder_that_fails_leaves_nothing(small_store, monkeypatch):
    def full(path: Path) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(files, "sync", full)
        with pytest.raises(OSError, match=r"No space left on device.*cache.*"):
            cache.open_cache(Store.open(small_store))
    assert folders_of(small_store) == []


def test_two_builders_at_once(small_store):
    program = textwrap.dedent(
        """
        import sys
        from motionkit.store import Store
        from motionkit.store.cache.positions import open_cache
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
    original = build.joint_map

    def shifted(skeleton, layout):
        mapping = original(skeleton, layout)
        return type(mapping)(**{**vars(mapping), "weights": mapping.weights[::-1].copy()})

    monkeypatch.setattr(build, "joint_map", shifted)
    assert cache.open_cache(store).path != first.path


def sums(built: cache.PositionCache) -> np.ndarray:
    """Rows derived from a cache, as trainings do it."""
    rows = built.derived_rows(
        "sums", 1, lambda: (built.sequence_positions(n).sum((1, 2))[:, None] for n in range(built.num_sequences))
    )
    return rows[np.arange(len(rows))]


@pytest.mark.parametrize("name", ["positions.npy", "index.npy", "cache.json", "sums.npy", "sums.json"])
@pytest.mark.parametrize("damage", ["flip the first", "flip", "flip the last", "cut", "empty", "remove", "grow"])
def test_a_damaged_cache_is_made_anew_and_said(small_store, name, damage, recwarn):
    store = Store.open(small_store)
    built = cache.open_cache(store)
    positions, derived = built.positions.copy(), sums(built)
    path = built.path / name
    content = bytearray(path.read_bytes())
    place = {"flip the first": 0, "flip the last": len(content) - 2}.get(damage, len(content) // 2)
    if damage.startswith("flip"):
        content[place] ^= 1
    path.write_bytes({"cut": content[: len(content) // 3], "empty": b"", "grow": content + b" ]"}.get(damage, content))
    if damage == "remove":
        path.unlink()
    assert not recwarn.list
    again = cache.open_cache(Store.open(small_store))
    np.testing.assert_array_equal(again.positions, positions)
    np.testing.assert_array_equal(sums(again), derived)
    warnings = [str(each.message) for each in recwarn]
    if damage == "remove" and name.endswith(".json"):
        assert not warnings, "what was not finished is made"
    else:
        (warning,) = warnings
        assert f"{name} is damaged (" in warning and "anew" in warning and "\n" not in warning
    assert cache.open_cache(Store.open(small_store)).path == built.path
    assert sums(again).tobytes() == derived.tobytes()
    assert [str(each.message) for each in recwarn] == warnings


def test_who_has_a_damaged_cache_mapped_keeps_what_it_read(small_store):
    """The new file has another place on the disk: nobody's rows change under their hands."""
    built = cache.open_cache(Store.open(small_store))
    before = built.positions[0].copy()
    path = built.path / "positions.npy"
    path.write_bytes(path.read_bytes()[:-1] + b"?")
    cache.open_cache(Store.open(small_store))
    np.testing.assert_array_equal(built.positions[0], before)


@pytest.mark.parametrize("name", ["positions.npy", "sums.npy"])
def test_large_caches_are_checked_by_validate_deep(small_store, monkeypatch, name):
    built = cache.open_cache(Store.open(small_store))
    sums(built)
    monkeypatch.setattr(checksums, "MOST_HASHED_BYTES", 100)
    content = bytearray((built.path / name).read_bytes())
    content[-1] ^= 1
    (built.path / name).write_bytes(content)
    assert list(faults(small_store)) == []
    (fault,) = faults(small_store, deep=True)
    assert fault == (
        f"{built.path / name} is damaged (its content is not what was written): "
        + ("delete its folder, it is made anew" if name == "positions.npy" else "delete it, it is computed anew")
    )
    (built.path / name).write_bytes(content[:-4])
    (fault,) = faults(small_store, deep=True)
    assert "bytes instead of" in fault


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        ({"where": "fps = 30"}, "it is that of another cache"),
        ({"store_fingerprint": "0" * 64}, "it is that of another cache"),
        ({"skipped": [{"id": 1}]}, "TypeError"),
        ({"skipped": 7}, "TypeError"),
        ({"files": {}}, "KeyError"),
        ({"files": {"positions.npy": {"sha256": 5, "num_bytes": 1}, "index.npy": {}}}, "is no digest"),
    ],
)
def test_a_cache_that_was_signed_again_is_not_used(small_store, edit, says, recwarn):
    built = cache.open_cache(Store.open(small_store))
    path = built.path / "cache.json"
    write_json(path, read_json(path, "") | edit)
    assert cache.open_cache(Store.open(small_store)).num_sequences == 6
    assert any(says in str(each.message) for each in recwarn)


@pytest.mark.parametrize(
    ("column", "row", "value", "says"),
    [
        ("num_frames", 0, 41, "do not follow each other"),
        ("num_frames", 0, -1, "do not follow each other"),
        ("start_row", 1, 2**40, "do not follow each other"),
        ("num_frames", 5, 2**31 - 1, "its shape"),
        ("sequence_index", 5, 6, "holds no sequence 6"),
        ("fps_numerator", 0, 0, "fps_numerator are not those"),
    ],
)
def test_an_index_that_was_signed_again_is_not_used(small_store, column, row, value, says, recwarn):
    built = cache.open_cache(Store.open(small_store))
    path = built.path / "index.npy"
    index = np.load(path)
    index[column][row] = value
    np.save(path, index)
    facts = read_json(built.path / "cache.json", "")
    facts["files"]["index.npy"]["sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
    write_json(built.path / "cache.json", facts)
    np.testing.assert_array_equal(cache.open_cache(Store.open(small_store)).num_frames, built.num_frames)
    assert any(says in str(each.message) for each in recwarn)


def test_unpickling_a_removed_cache_is_reported(small_store, make_motion):
    pickled = pickle.dumps(cache.open_cache(Store.open(small_store)))
    with StoreWriter.append(small_store) as writer:
        writer.add(make_motion("new"))
    cache.open_cache(Store.open(small_store))
    with pytest.raises(StoreError, match="was removed, since its store has changed: start again"):
        pickle.loads(pickled)  # noqa: S301 - our own bytes


def test_another_process_does_not_read_the_digest_again(small_store, monkeypatch):
    pickled = pickle.dumps(cache.open_cache(Store.open(small_store)))
    monkeypatch.setattr(cache, "file_fault", None)
    assert pickle.loads(pickled).num_sequences == 6  # noqa: S301 - our own bytes


def test_opening_a_cache_maps_no_page_of_it(tmp_path, make_motion):
    """Its bytes are compared, but do not stay in the process."""
    status = Path("/proc/self/status")
    if not status.is_file():
        pytest.skip("needs Linux's /proc")
    with StoreWriter.create(tmp_path / "store") as writer:
        writer.add(make_motion("long", 80_000))
    cache.open_cache(Store.open(tmp_path / "store"))
    checksums._sha256_of_version.cache_clear()
    store = Store.open(tmp_path / "store")

    def resident() -> int:
        return sum(map(int, re.findall(r"^Rss(?:File|Anon):\s+(\d+)", status.read_text(), re.MULTILINE)))

    before = resident()
    built = cache.open_cache(store)
    assert resident() - before < 4_000 < built.positions.nbytes // 1024


def test_an_index_whose_header_says_more_than_there_is_is_not_used(small_store, recwarn):
    built = cache.open_cache(Store.open(small_store))
    path = built.path / "index.npy"
    with path.open("wb") as file:
        header = {"descr": cache.INDEX_DTYPE.descr, "fortran_order": False, "shape": (10**15,)}
        np.lib.format.write_array_header_1_0(file, header)
    content, facts = path.read_bytes(), read_json(built.path / "cache.json", "")
    facts["files"]["index.npy"] = {"sha256": hashlib.sha256(content).hexdigest(), "num_bytes": len(content)}
    write_json(built.path / "cache.json", facts)
    np.testing.assert_array_equal(cache.open_cache(Store.open(small_store)).num_frames, built.num_frames)
    assert any("index.npy is damaged" in str(each.message) for each in recwarn)
