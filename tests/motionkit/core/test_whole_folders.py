import multiprocessing
import os
import signal
import time
from pathlib import Path

import pytest

from motionkit.core.errors import BusyError, LinkError, UsageError
from motionkit.core.files import LOCK, locked_folder, whole_folder
from tests.helpers.killing import killed_before


def _names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def test_the_folder_appears_with_all_that_is_in_it(tmp_path: Path) -> None:
    with whole_folder(tmp_path / "new" / "out") as folder:
        (folder / "a").write_text("a")
        assert _names(tmp_path / "new") == ["out.partial"]
    assert _names(tmp_path / "new") == ["out"]
    assert _names(tmp_path / "new" / "out") == ["a"]


def test_an_error_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), whole_folder(tmp_path / "out") as folder:
        (folder / "a").write_text("a")
        raise KeyboardInterrupt
    assert not _names(tmp_path)


def _write_slowly(path: Path) -> None:
    with whole_folder(path) as folder:
        (folder / "a").write_text("a")
        time.sleep(60)


def test_while_one_writes_another_is_refused_and_goes_on_when_it_was_killed(tmp_path: Path) -> None:
    path = tmp_path / "out"
    writer = multiprocessing.get_context("fork").Process(target=_write_slowly, args=(path,))
    writer.start()
    while not (tmp_path / "out.partial" / "out" / "a").exists():
        time.sleep(0.01)
    with pytest.raises(BusyError, match=r"another process is writing .*out\.partial"), whole_folder(path):
        pass
    assert (tmp_path / "out.partial" / "out" / "a").exists()
    assert writer.pid is not None
    os.kill(writer.pid, signal.SIGKILL)
    writer.join()
    with whole_folder(path) as folder:
        assert not _names(folder)
    assert _names(tmp_path) == ["out"]


def test_killed_before_any_step_it_is_there_or_the_next_writer_makes_it(tmp_path: Path) -> None:
    def write(path: Path) -> None:
        with whole_folder(path) as folder:
            (folder / "a").write_text("a")

    killed = 0
    for step in range(20):
        path = tmp_path / str(step) / "out"
        path.parent.mkdir()
        if not killed_before(step, path.parent, lambda path=path: write(path)):
            break
        killed += 1
        if path.exists():  # what is left beside it goes with the next writer, which may find that it has nothing to do
            with pytest.raises(UsageError), whole_folder(path):
                raise UsageError("it is there")
        else:
            write(path)
        assert _names(path.parent) == ["out"]
        assert _names(path) == ["a"]
    assert killed >= 7  # the folder, its lock, the content's folder, the file, the rename, the lock's end, the folder's


def test_what_somebody_else_has_there_stays(tmp_path: Path) -> None:
    partial = tmp_path / "out.partial"
    partial.mkdir()
    (partial / "mine").touch()
    with pytest.raises(UsageError, match="motionkit did not make it"), whole_folder(tmp_path / "out"):
        pass
    assert _names(partial) == ["mine"]
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / LOCK).touch()
    (tmp_path / "other.partial").symlink_to(tmp_path / "foreign")
    with pytest.raises(LinkError), whole_folder(tmp_path / "other"):
        pass
    assert _names(tmp_path / "foreign") == [LOCK]


def _hold(path: Path) -> None:
    with locked_folder(path, busy="busy"):
        (path / "held").touch()
        time.sleep(60)


def test_the_lock_of_a_folder_names_its_holder_and_ends_with_it(tmp_path: Path) -> None:
    path = tmp_path / "run" / "field"
    holder = multiprocessing.get_context("fork").Process(target=_hold, args=(path,))
    holder.start()
    while not (path / "held").exists():
        time.sleep(0.01)
    with pytest.raises(BusyError, match=rf"wait .*process {holder.pid} on"), locked_folder(path, busy="wait"):
        pass
    holder.kill()
    holder.join()
    with locked_folder(path, busy="wait"):
        (path / "held").unlink()
    assert not path.exists()
