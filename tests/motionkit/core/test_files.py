"""Files, folders, locks and records: whole or absent, one writer at a time, damage noticed."""

import json
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from motionkit.core.errors import BusyError, DamagedFileError, UsageError
from motionkit.core.files import (
    LOCK,
    defer_signals,
    is_temporary,
    locked_folder,
    parse_json,
    parse_toml,
    read_json,
    read_record,
    remove_entry,
    replace,
    require_new,
    sha256_of,
    whole_file,
    whole_folder,
    whole_number,
    write_json,
    write_record,
    write_whole,
)
from tests.helpers.killing import killed_before


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def test_a_file_appears_with_its_whole_content_or_the_old_one_stays(tmp_path: Path) -> None:
    path = tmp_path / "a" / "walk.npz"
    with whole_file(path) as temporary:
        temporary.write_bytes(b"old")
        assert not path.exists()
        assert temporary.suffix == ".npz" and is_temporary(temporary) and not is_temporary(path)
    assert path.read_bytes() == b"old"
    with pytest.raises(RuntimeError), whole_file(path) as temporary:
        temporary.write_bytes(b"new")
        raise RuntimeError
    assert path.read_bytes() == b"old"
    assert names(path.parent) == ["walk.npz"]


def test_a_link_at_the_path_is_replaced_and_not_written_through(tmp_path: Path) -> None:
    (tmp_path / "letter").write_text("dear")
    for write in (lambda path: write_whole(path, "x"), partial(replace, tmp_path / "new")):
        (tmp_path / "new").write_text("x")
        (tmp_path / "walk.json").unlink(missing_ok=True)
        (tmp_path / "walk.json").symlink_to(tmp_path / "letter")
        write(tmp_path / "walk.json")
        assert (tmp_path / "letter").read_text() == "dear" and (tmp_path / "walk.json").read_text() == "x"
        assert not (tmp_path / "walk.json").is_symlink()


def test_a_folder_is_removed_but_no_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "file").touch()
    (tmp_path / "folder").mkdir()
    for link in (tmp_path / "folder" / "inner", tmp_path / "link"):
        link.symlink_to(tmp_path / "kept")
    remove_entry(tmp_path / "folder")
    remove_entry(tmp_path / "link")
    remove_entry(tmp_path / "absent")
    assert names(tmp_path) == ["kept"]
    assert (tmp_path / "kept" / "file").exists()


def test_json_comes_back(tmp_path: Path) -> None:
    document = {"b": [1, 0.1, None, True, "é"], "a": {"c": {}}}
    write_json(tmp_path / "a.json", document)
    assert list(read_json(tmp_path / "a.json", "")) == ["b", "a"]
    assert read_json(tmp_path / "a.json", "") == document
    with pytest.raises(ValueError, match="nan"):
        write_json(tmp_path / "a.json", {"a": float("nan")})


@pytest.mark.parametrize("content", [b"", b"[]", b'{"a": "\xff"}', b"[" * 100_000])
def test_what_is_no_json_object_is_damage(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.json").write_bytes(content)
    with pytest.raises(DamagedFileError, match=r"a\.json"):
        read_json(tmp_path / "a.json", "restore it")


@pytest.mark.parametrize(
    ("parse", "text"),
    [
        (parse_toml, f"a = {'9' * 5000}"),
        (parse_toml, f"a = {'[' * 3000}"),
        (parse_json, "[" * 100_000),
        (parse_json, r'["\ud800"]'),
    ],
)
def test_every_fault_of_a_text_is_a_value_error(parse: Callable[[str], object], text: str) -> None:
    with pytest.raises(ValueError):
        parse(text)


def test_texts_are_read_as_python_reads_them_but_for_huge_whole_numbers() -> None:
    assert parse_toml("a = [true, 1.5]") == {"a": [True, 1.5]}
    text = r'{"a": [1, -2, 2.5, null, true, "\ud83d\ude00"], "b": {"c": 999999999999999999}}'
    assert parse_json(text) == json.loads(text)
    assert parse_json(f"[{'9' * 5000}]") == [float("inf")]
    numbers = {"0": 0, "007": 7, "٣": 3, "9" * 18: 10**18 - 1, "9" * 19: None, "9" * 5000: None, "": None, "-1": None}
    assert {each: whole_number(each) for each in numbers} == numbers


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """A folder of two files with its record."""
    (tmp_path / "inner").mkdir()
    (tmp_path / "a b.json").write_text("{}")
    (tmp_path / "inner" / "é").write_bytes(b"\0")
    write_record(tmp_path, ["inner/é", "a b.json"])
    return tmp_path


def test_a_record_is_what_sha256sum_reads(recorded: Path) -> None:
    assert read_record(recorded, "") == {name: sha256_of(recorded / name) for name in ("a b.json", "inner/é")}
    check = subprocess.run(["sha256sum", "--check", "--strict", "SHA256SUMS"], cwd=recorded, capture_output=True)
    assert check.returncode == 0


@pytest.mark.parametrize("content", [b"\xff", b"0" * 64 + b"  a b.json\nabc  e\n"])
def test_a_record_that_is_none_is_damaged(recorded: Path, content: bytes) -> None:
    (recorded / "SHA256SUMS").write_bytes(content)
    with pytest.raises(DamagedFileError, match="SHA256SUMS"):
        read_record(recorded, "repair it")


def test_a_folder_appears_with_all_that_is_in_it_or_not_at_all(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), whole_folder(tmp_path / "new" / "out") as folder:
        (folder / "b").write_text("b")
        raise KeyboardInterrupt
    assert names(tmp_path / "new") == []
    with whole_folder(tmp_path / "new" / "out") as folder:
        (folder / "a").write_text("a")
        assert names(tmp_path / "new") == ["out.partial"]
    assert names(tmp_path / "new") == ["out"]
    assert names(tmp_path / "new" / "out") == ["a"]


def test_what_exists_is_replaced_on_request_and_only_where_it_is_of_the_same_kind(tmp_path: Path) -> None:
    path = tmp_path / "out"
    require_new(path, overwrite=False, instead="-")
    path.mkdir()
    require_new(path, overwrite=False, instead="-")
    (path / "a").write_text("a")
    with pytest.raises(UsageError, match="not what this command writes: name another"):
        require_new(path, overwrite=True, instead="name another")
    with pytest.raises(UsageError, match="--overwrite replaces it, name another"):
        require_new(path, overwrite=False, replaced=Path.is_dir, instead="name another")
    require_new(path, overwrite=True, replaced=Path.is_dir, instead="-")
    with pytest.raises(KeyboardInterrupt), whole_folder(path):
        raise KeyboardInterrupt
    assert names(path) == ["a"]
    with whole_folder(path) as folder:
        (folder / "b").write_text("b")
    assert names(path) == ["b"] and names(tmp_path) == ["out"]


def test_killed_before_any_step_the_folder_is_there_or_the_next_writer_makes_it(tmp_path: Path) -> None:
    def write(path: Path) -> None:
        with whole_folder(path) as folder:
            (folder / "a").write_text("a")

    killed = 0
    for step in range(20):
        path = tmp_path / str(step) / "out"
        path.parent.mkdir()
        if not killed_before(step, path.parent, partial(write, path)):
            break
        killed += 1
        if not path.exists():
            write(path)
        assert names(path) == ["a"]
        assert set(names(path.parent)) <= {"out", "out.partial"}
    assert killed >= 7  # the folder, its lock, the content's folder, the file, the rename, the lock's end, the folder's


def hold(path: Path, ready: Path) -> None:
    with locked_folder(path, busy="busy"):
        ready.touch()
        time.sleep(60)


def test_a_lock_refuses_others_until_its_holder_ends_however_it_ends(tmp_path: Path) -> None:
    path, ready = tmp_path / "run" / "field", tmp_path / "ready"
    holder = multiprocessing.get_context("fork").Process(target=hold, args=(path, ready))
    holder.start()
    while not ready.exists():
        time.sleep(0.01)
    with pytest.raises(BusyError, match="wait"), locked_folder(path, busy="wait for it"):
        pass
    assert holder.pid is not None
    (path / ".weights.0123abcd.tmp.npz").touch()
    os.kill(holder.pid, signal.SIGKILL)
    holder.join()
    with locked_folder(path, busy="wait for it"):
        assert names(path) == [LOCK]  # and not the temporary file of the killed process
    assert not path.exists()


WITHOUT_LOCKS = """
import errno, fcntl, sys, warnings
from dataclasses import replace
from pathlib import Path
def refuse(*_): raise OSError(errno.ENOLCK, 'No locks')
fcntl.flock = refuse
import numpy as np
import motionkit as mk
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    motion = mk.Motion.from_joints(np.random.default_rng(0).normal(size=(20, 22, 3)), 20)
    with mk.StoreWriter.create(Path(sys.argv[1])) as writer:
        writer.add(replace(motion, sequence_id="walk"))
print(mk.Store.open(sys.argv[1]).num_sequences, *{str(each.message) for each in caught}, sep="; ")
"""


def test_a_store_is_written_without_locks_and_says_so(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_LOCKS, str(tmp_path / "store")], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(r"1; .*lock.*\n", done.stdout)


def test_a_signal_waits_for_the_end_of_all_blocks() -> None:
    number = signal.SIGTERM
    previous = signal.signal(number, signal.default_int_handler)
    done = []
    try:
        with pytest.raises(KeyboardInterrupt) as caught, defer_signals():
            with defer_signals():
                signal.raise_signal(number)
                done.append("inner")
            done.append("outer")
            raise ValueError("a fault")
    finally:
        signal.signal(number, previous)
    assert done == ["inner", "outer"]
    assert isinstance(caught.value.__context__, ValueError)
