"""What is removed among caches, and where they lie: nothing of a user's own is touched, no link is followed."""

import errno
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.checksums import write_json
from motionkit.core.errors import LinkError, StoreError
from motionkit.store import Store, StoreWriter
from motionkit.store.cache.positions import open_cache
from motionkit.store.life.rewrite import compact
from motionkit.store.reports.summary import summarise
from motionkit.store.validate import faults

NAME_OF_A_CACHE = "0123456789abcdef-smpl22-0123456789abcdef"


def content_of(folder: Path) -> dict[str, bytes | str]:
    """Every file below a folder; of links where they lead."""
    return {
        str(path.relative_to(folder)): str(path.readlink()) if path.is_symlink() else path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_symlink() or path.is_file()
    }


@pytest.fixture
def precious(tmp_path: Path) -> Path:
    """Somebody's folder, some of it named as caches are."""
    for name in ("photos", "building-a", f"building-{NAME_OF_A_CACHE}", NAME_OF_A_CACHE):
        (tmp_path / "home" / name).mkdir(parents=True)
        (tmp_path / "home" / name / "cat.jpg").write_bytes(b"cat")
    (tmp_path / "home" / "letter.txt").write_text("dear")
    return tmp_path / "home"


def change(store: Path, make_motion, name: str = "new") -> None:
    with StoreWriter.append(store) as writer:
        writer.add(make_motion(name))


@pytest.mark.parametrize("target", ["home", "nowhere"])
def test_a_link_is_not_followed(small_store, precious, target):
    """Each folder behind it used to be deleted."""
    before = content_of(precious)
    (small_store / "cache").symlink_to(precious.parent / target)
    with pytest.raises(LinkError, match=r"cache is a symbolic link to .*: delete the link, .* MOTIONKIT_CACHE"):
        open_cache(Store.open(small_store))
    assert content_of(precious) == before
    assert summarise(Store.open(small_store)).cache_bytes == 0
    assert list(faults(small_store)) == []
    assert "cache is a symbolic link" in next(faults(small_store, deep=True))
    compact(small_store)
    assert content_of(precious) == before


def test_links_inside_are_not_followed(small_store, precious, make_motion):
    before = content_of(precious)
    built = open_cache(Store.open(small_store))
    shutil.move(built.path, precious.parent / "elsewhere")
    built.path.symlink_to(precious.parent / "elsewhere")
    outside = content_of(precious.parent / "elsewhere")
    with pytest.raises(LinkError, match="is a symbolic link"):
        open_cache(Store.open(small_store))
    (small_store / "cache" / NAME_OF_A_CACHE).symlink_to(precious)
    change(small_store, make_motion)
    open_cache(Store.open(small_store))
    assert content_of(precious) == before
    assert content_of(precious.parent / "elsewhere") == outside


@pytest.mark.parametrize("name", [".motionkit-cache", "positions.npy", "index.npy", "cache.json"])
def test_files_that_are_links_are_not_written_through(small_store, tmp_path, name):
    target = tmp_path / "letter.txt"
    target.write_text("dear")
    built = open_cache(Store.open(small_store))
    expected = built.positions.copy()
    for each in (name, "index.npy", ".positions.npy.tmp.npy", ".index.npy.tmp.npy", ".cache.json.tmp.json"):
        (built.path / each).unlink(missing_ok=True)
        (built.path / each).symlink_to(target)
    with pytest.raises(OSError, match="symbolic link"):
        open_cache(Store.open(small_store))
    np.testing.assert_array_equal(open_cache(Store.open(small_store)).positions, expected)
    assert target.read_text() == "dear"


def test_a_lock_that_is_a_link_is_refused(small_store, tmp_path):
    (tmp_path / "letter.txt").write_text("dear")
    (small_store / "cache").mkdir()
    (small_store / "cache" / ".builder.lock").symlink_to(tmp_path / "letter.txt")
    with pytest.raises(LinkError, match=r"builder\.lock is a symbolic link"):
        open_cache(Store.open(small_store))
    assert (tmp_path / "letter.txt").read_text() == "dear"


def test_what_is_a_users_own_stays(small_store, precious, make_motion):
    """Folders without our marker, and files that are not ours inside of our folders."""
    shutil.copytree(precious, small_store / "cache")
    own = content_of(small_store / "cache")
    first = open_cache(Store.open(small_store))
    first.derived_rows("zeros", 1, lambda: (np.zeros((n, 1), np.float32) for n in first.num_frames))
    (first.path / "notes.txt").write_text("dear")
    (first.path / "mine.npy").write_bytes(b"mine")
    (first.path / "figures").mkdir()
    change(small_store, make_motion)
    second = open_cache(Store.open(small_store))
    found = content_of(small_store / "cache")
    assert {name: content for name, content in found.items() if name in own} == own
    left = {name for name in found if name.startswith(first.path.name)}
    assert left == {f"{first.path.name}/notes.txt", f"{first.path.name}/mine.npy"}
    assert (first.path / "figures").is_dir() and second.path.is_dir()


def test_a_stale_cache_goes_with_all_that_is_ours(small_store, make_motion):
    first = open_cache(Store.open(small_store))
    first.derived_rows("zeros", 1, lambda: (np.zeros((n, 1), np.float32) for n in first.num_frames))
    change(small_store, make_motion)
    second = open_cache(Store.open(small_store))
    assert sorted(path.name for path in (small_store / "cache").iterdir()) == [".builder.lock", second.path.name]


def test_caches_of_the_first_version_are_removed(small_store):
    """They have no marker, but their three files under a name of ours."""
    fingerprint = Store.open(small_store).fingerprint
    old = small_store / "cache" / f"{fingerprint[:16]}-smpl22-0123456789abcdef"
    old.mkdir(parents=True)
    for name in ("positions.npy", "index.npy", "rows-1.npy", ".rows-1.lock", "rows-2.partial", ".rows-2.lock"):
        (old / name).write_bytes(b"")
    write_json(old / "cache.json", {"version": 1})
    open_cache(Store.open(small_store))
    assert not old.exists()


def test_compact_removes_the_caches_of_earlier_states(small_store, make_motion):
    """They hold what was removed from the store: compact is the way to make data go."""
    first = open_cache(Store.open(small_store))
    change(small_store, make_motion)
    assert compact(small_store)
    assert not first.path.exists()
    second = open_cache(Store.open(small_store))
    assert not compact(small_store)
    assert second.path.exists()


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch) -> Path:
    monkeypatch.setenv("MOTIONKIT_CACHE", str(tmp_path / "scratch"))
    return tmp_path / "scratch"


def test_caches_elsewhere(small_store, elsewhere, make_motion, recwarn):
    store = Store.open(small_store)
    built = open_cache(store)
    assert built.path.parent == elsewhere / store.fingerprint
    assert not (small_store / "cache").exists()
    assert open_cache(store).path == built.path
    assert summarise(store).cache_bytes == sum(path.stat().st_size for path in built.path.iterdir())
    (elsewhere / "mine").mkdir()
    change(small_store, make_motion)
    again = open_cache(Store.open(small_store))
    assert built.path.exists(), "another copy of the store may use it"
    assert again.path.parent == elsewhere / Store.open(small_store).fingerprint
    assert (elsewhere / "mine").exists()
    content = bytearray((again.path / "positions.npy").read_bytes())
    content[-1] ^= 1
    (again.path / "positions.npy").write_bytes(content)
    (fault,) = faults(small_store, deep=True)
    assert str(again.path) in fault
    assert open_cache(Store.open(small_store)).num_sequences == 7
    assert any("positions.npy is damaged" in str(each.message) for each in recwarn)


def test_the_folder_elsewhere_is_not_reached_through_a_link_of_its_own(small_store, elsewhere, precious):
    before = content_of(precious)
    elsewhere.mkdir()
    (elsewhere / Store.open(small_store).fingerprint).symlink_to(precious)
    with pytest.raises(LinkError):
        open_cache(Store.open(small_store))
    assert content_of(precious) == before


def test_the_folder_elsewhere_may_be_a_link(small_store, elsewhere):
    elsewhere.with_name("disk").mkdir()
    elsewhere.symlink_to(elsewhere.with_name("disk"))
    assert open_cache(Store.open(small_store)).num_sequences == 6


@pytest.fixture
def read_only_store(small_store: Path, tmp_path: Path):
    """The store, mounted so that nothing can be written to it."""
    place = tmp_path / "read-only"
    place.mkdir()
    for command in (["mount", "--bind", small_store, place], ["mount", "-o", "remount,bind,ro", place]):
        if os.geteuid() or subprocess.run(command, check=False, capture_output=True).returncode:
            subprocess.run(["umount", place], check=False, capture_output=True)
            pytest.skip("may not mount a folder")
    yield place
    subprocess.run(["umount", place], check=True)


def test_a_store_on_a_read_only_medium(read_only_store, elsewhere, monkeypatch):
    assert open_cache(Store.open(read_only_store)).num_sequences == 6
    monkeypatch.delenv("MOTIONKIT_CACHE")
    with pytest.raises(StoreError, match=r"training cache cannot be written \(.*Read-only.*MOTIONKIT_CACHE") as caught:
        open_cache(Store.open(read_only_store))
    assert "\n" not in str(caught.value)


def test_a_cache_on_a_read_only_medium_is_used(small_store, read_only_store, monkeypatch):
    built = open_cache(Store.open(small_store))
    read = open_cache(Store.open(read_only_store))
    np.testing.assert_array_equal(read.positions, built.positions)
    with pytest.raises(StoreError, match=r"^the training cache cannot be written .*MOTIONKIT_CACHE"):
        read.derived_rows("zeros", 1, lambda: (np.zeros((n, 1), np.float32) for n in read.num_frames))
    (built.path / "index.npy").write_bytes(b"cut")
    with pytest.raises(StoreError, match=r"index\.npy is damaged \(it has 3 .*\), and the .*MOTIONKIT_CACHE"):
        open_cache(Store.open(read_only_store))


@pytest.mark.parametrize("number", [errno.EROFS, errno.EACCES, errno.EPERM])
def test_a_store_that_may_not_be_written_to(small_store, monkeypatch, number):
    def refuse(path: Path, *arguments: object, **options: object) -> None:
        raise OSError(number, os.strerror(number), str(path))

    store = Store.open(small_store)
    with monkeypatch.context() as patched:
        patched.setattr(Path, "mkdir", refuse)
        with pytest.raises(StoreError, match=r"cannot be written .*cache.*: name a folder .* MOTIONKIT_CACHE"):
            open_cache(store)
