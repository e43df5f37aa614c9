import errno
import multiprocessing
import os
import signal
import stat
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from motionkit.core.checksums import sha256_of
from motionkit.core.errors import LinkError
from motionkit.core.files import (
    create,
    naming,
    read_at_most,
    read_regular,
    remove_folder,
    replace,
    require_no_link,
    temporary_name,
    whole_file,
    write_whole,
)
from motionkit.store.parts import read_footer


def test_the_file_appears_with_its_whole_content(tmp_path: Path) -> None:
    path = tmp_path / "a" / "take.npz"
    with whole_file(path) as temporary:
        temporary.write_bytes(b"half")
        assert not path.exists()
        assert temporary.suffix == ".npz"
    assert path.read_bytes() == b"half"
    assert [entry.name for entry in path.parent.iterdir()] == ["take.npz"]


def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "take.npz"
    path.write_bytes(b"old")
    with pytest.raises(RuntimeError), whole_file(path) as temporary:
        temporary.write_bytes(b"new")
        raise RuntimeError
    assert path.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["take.npz"]


def test_permissions_follow_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_whole(tmp_path / "weights", "x")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "weights").stat().st_mode) == 0o640


def test_a_full_disk_names_the_file(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"No space left.*take\.json"), whole_file(tmp_path / "take.json"):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _write_slowly(path: Path, content: str, seconds: float) -> None:
    with whole_file(path) as temporary:
        temporary.write_text(content)
        time.sleep(seconds)


def test_what_a_killed_writer_left_is_written_over(tmp_path: Path) -> None:
    path = tmp_path / "take.json"
    writer = multiprocessing.get_context("fork").Process(target=_write_slowly, args=(path, "a longer text", 60))
    writer.start()
    while not temporary_name(path).exists() or not temporary_name(path).stat().st_size:
        time.sleep(0.01)
    assert writer.pid is not None
    os.kill(writer.pid, signal.SIGKILL)
    writer.join()
    assert [entry.name for entry in tmp_path.iterdir()] == [temporary_name(path).name]
    write_whole(path, "short")
    assert path.read_text() == "short"
    assert [entry.name for entry in tmp_path.iterdir()] == ["take.json"]


def test_a_second_writer_of_the_same_path_waits(tmp_path: Path) -> None:
    path = tmp_path / "take.json"
    context = multiprocessing.get_context("fork")
    writers = [context.Process(target=_write_slowly, args=(path, str(number) * 1000, 0.05)) for number in range(4)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert [writer.exitcode for writer in writers] == [0] * 4
    text = path.read_text()
    assert len(text) == 1000
    assert len(set(text)) == 1
    assert [entry.name for entry in tmp_path.iterdir()] == ["take.json"]


def test_a_link_at_the_temporary_name_is_not_followed(tmp_path: Path) -> None:
    foreign = tmp_path / "foreign"
    foreign.write_text("mine")
    (tmp_path / "run").mkdir()
    path = tmp_path / "run" / "take.json"
    temporary_name(path).symlink_to(foreign)
    with pytest.raises(OSError, match=r"take\.json"):
        write_whole(path, "x")
    assert foreign.read_text() == "mine"


def test_a_link_at_the_path_is_replaced_and_not_written_through(tmp_path: Path) -> None:
    foreign = tmp_path / "foreign"
    foreign.write_text("mine")
    (tmp_path / "take.json").symlink_to(foreign)
    write_whole(tmp_path / "take.json", "x")
    assert foreign.read_text() == "mine"
    assert (tmp_path / "take.json").read_text() == "x"


def test_a_folder_is_removed_but_no_link_is_followed(tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "file").touch()
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "inner").symlink_to(kept)
    (tmp_path / "link").symlink_to(kept)
    with pytest.raises(LinkError, match=r"symbolic link to .*kept"):
        remove_folder(tmp_path / "link")
    remove_folder(folder)
    assert not folder.exists()
    assert (kept / "file").exists()


def test_a_link_is_refused_with_what_to_do_instead(tmp_path: Path) -> None:
    require_no_link(tmp_path / "absent", "do that")
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    with pytest.raises(LinkError, match="do that"):
        require_no_link(tmp_path / "dangling", "do that")


def test_the_next_writers_temporary_file_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may be there as soon as this one's has been renamed; it used to be removed now and then."""
    path = tmp_path / "take.json"

    def sync(synced: Path) -> None:
        if synced == tmp_path:
            temporary_name(path).write_text("another's")

    monkeypatch.setattr("motionkit.core.files.sync", sync)
    write_whole(path, "mine")
    assert path.read_text() == "mine"
    assert temporary_name(path).read_text() == "another's"


@pytest.mark.parametrize("what", ["file", "link", "dangling"])
def test_nothing_is_made_where_something_is(tmp_path: Path, what: str) -> None:
    path, letter = tmp_path / "take.json", tmp_path / "letter.txt"
    letter.write_text("dear")
    if what == "file":
        path.write_text("old")
    else:
        path.symlink_to(letter if what == "link" else tmp_path / "nowhere")
    with pytest.raises(FileExistsError, match=r"take\.json"):
        create(path)
    assert letter.read_text() == "dear"
    assert not (tmp_path / "nowhere").exists()


def test_a_file_is_made_by_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        create(tmp_path / "take.json")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "take.json").stat().st_mode) == 0o640


def test_a_rename_replaces_a_link_and_not_what_it_leads_to(tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("dear")
    (tmp_path / "take.json").symlink_to(tmp_path / "letter.txt")
    (tmp_path / "new").write_text("new")
    replace(tmp_path / "new", tmp_path / "take.json")
    assert (tmp_path / "letter.txt").read_text() == "dear"
    assert (tmp_path / "take.json").read_text() == "new"
    assert not (tmp_path / "take.json").is_symlink()


def test_what_never_ends_is_not_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zeros").symlink_to("/dev/zero")
    (tmp_path / "take.json").write_text("{}")
    (tmp_path / "link").symlink_to(tmp_path / "take.json")
    for name in ("pipe", "zeros", "."):
        with pytest.raises(OSError, match="not a regular file"):
            read_regular(tmp_path / name)
    assert read_regular(tmp_path / "link") == b"{}"


def test_an_error_of_a_library_names_the_file_in_the_systems_words(tmp_path: Path) -> None:
    with (
        pytest.raises(OSError, match=r"^\[Errno 28\] No space left on device: .*part\.parquet'$"),
        naming(tmp_path / "part.parquet"),
    ):
        raise OSError(errno.ENOSPC, "Error writing bytes to file. Detail: [errno 28] No space left on device")
    with pytest.raises(OSError, match="corrupt"), naming(tmp_path / "part.parquet"):
        raise OSError("corrupt")


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="needs a file that opens and cannot be read")
@pytest.mark.parametrize("read", [read_regular, partial(read_at_most, num_bytes=10), sha256_of, read_footer])
def test_errors_of_reading_name_the_file(tmp_path: Path, read: Callable[[Path], object]) -> None:
    """The system names the file that cannot be opened, not the one that cannot be read."""
    (tmp_path / "broken").symlink_to("/proc/self/mem")
    with pytest.raises(OSError) as caught:
        read(tmp_path / "broken")
    assert caught.value.filename == str(tmp_path / "broken")
