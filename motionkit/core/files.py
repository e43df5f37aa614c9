"""Files and folders that appear whole, locks between processes, signals that wait, records of a folder's sha256.

A file is written beside its place, flushed to the disk and renamed, so a reader never finds half of it. A folder of
several files may have a record of their sha256, which is checked when the folder is opened for use.
"""

import errno
import hashlib
import json
import math
import os
import re
import secrets
import shutil
import signal
import threading
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from motionkit.core.errors import BusyError, DamagedFileError, UsageError
from motionkit.core.progress import warn

# The lock file in a folder that one process writes at a time.
LOCK = ".lock"
# The record of a folder: one line a file, as `sha256sum` writes and checks them.
RECORD = "SHA256SUMS"
_RECORD_LINE = re.compile(r"([0-9a-f]{64})  (.+)")
_TEMPORARY = re.compile(r"\..+\.[0-9a-f]{8}\.tmp(\.[^.]*)?")
STOPPING_SIGNALS = (signal.SIGTERM, signal.SIGINT)
# Integers of more digits are beyond 64 bits; Python itself reads no more than thousands of them.
MOST_DIGITS = 18
LONGEST_TOML = 1_000_000
_NO_LOCKS = (errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK)

# The files and the folder by which a store is known.
MANIFEST_FILE, SEQUENCES_FILE, MOTIONS_FOLDER = "manifest.json", "sequences.parquet", "motions"


def is_store(path: Path) -> bool:
    """Whether a path is a store's folder, intact or damaged: it has a manifest beside a table or parts."""
    # Not Path.is_file, which raises for folders that may not be entered.
    beside = (path / SEQUENCES_FILE, path / MOTIONS_FOLDER)
    return os.path.isfile(path / MANIFEST_FILE) and any(map(os.path.exists, beside))  # noqa: PTH113


def default_path(name: str) -> Path:
    """The folder `store`, `runs` or `results` of the environment variable MOTIONKIT_NAME, or else ./NAME."""
    return Path(os.environ.get(f"MOTIONKIT_{name.upper()}") or name)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary file beside `path` that replaces it when the block ends without an error.

    The temporary file has the suffix of `path`, for writers that choose the format by it. Raises `OSError` that names
    `path`, also if the disk is full.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    require_regular(path)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp{path.suffix}")
    with naming(path):
        try:
            yield temporary
            replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)


def require_regular(path: Path) -> None:
    """Raise `OSError` for a folder, a pipe or a device, which might never end."""
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "not a regular file", str(path))


def is_temporary(path: Path) -> bool:
    """Whether a file has the name of a temporary one of `whole_file`, which a killed process leaves."""
    return _TEMPORARY.fullmatch(path.name) is not None


def write_whole(path: Path, content: bytes | str) -> None:
    """Write bytes, or text as UTF-8, as `whole_file` does."""
    with whole_file(path) as temporary:
        temporary.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write a JSON file as `whole_file` does; raises `ValueError` for NaN and infinity."""
    write_whole(path, json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def read_json(path: Path, hint: str) -> dict[str, Any]:
    """Read a JSON object; `hint` tells the user how to repair a damaged file.

    Raises `DamagedFileError` for anything but a JSON object of finite numbers, `OSError` for an unreadable file.
    """
    require_regular(path)
    try:
        with naming(path):
            document = json.loads(path.read_bytes(), parse_float=_finite, parse_constant=_finite)
    except (ValueError, RecursionError) as error:
        raise DamagedFileError(path, str(error), hint) from None
    if not isinstance(document, dict):
        raise DamagedFileError(path, "it is not a JSON object", hint)
    return document


def whole_number(text: str) -> int | None:
    """The integer of 1 to 18 decimal digits; None for any other text, including signs."""
    return int(text) if text.isdecimal() and len(text) <= MOST_DIGITS else None


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML; raises `ValueError` for anything else, also if it is nested too deep."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("nested too deep") from None


def parse_json(text: str) -> Any:
    """Parse JSON, with integers beyond 64 bits as floats.

    Raises `json.JSONDecodeError` with the position, or another `ValueError`: nested too deep, or a lone surrogate.
    """
    try:
        value = json.loads(text, parse_int=_bounded)
        if "\\ud" in text or "\\uD" in text:
            json.dumps(value, ensure_ascii=False).encode("utf-8")
    except RecursionError:
        raise ValueError("nested too deep") from None
    except UnicodeEncodeError as error:
        raise ValueError(f"{error.object[error.start]!r} is half a character") from None
    return value


def _bounded(digits: str) -> int | float:
    return int(digits) if len(digits) <= MOST_DIGITS else float(digits)


def _finite(text: str) -> float:
    if not math.isfinite(float(text)):
        raise ValueError(f"{text} is not a finite number")
    return float(text)


def replace(source: Path, target: Path) -> None:
    """Rename inside one folder, replacing the target; content, then name are flushed to the disk."""
    sync(source)
    source.replace(target)
    sync(target.parent)


def sync(path: Path) -> None:
    """Flush a file's content, or a folder's entries, to the disk."""
    if os.name == "nt" and path.is_dir():
        return  # Windows cannot open a folder
    descriptor = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        with naming(path):
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


def create(path: Path) -> None:
    """Create an empty file; raises `FileExistsError` if anything is there, even a link."""
    os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Add the file's name to an `OSError` without one, as raised for a full disk or by a failing one."""
    try:
        yield
    except OSError as error:
        if error.filename is not None:
            raise
        if error.errno is None:  # as numpy raises it
            raise OSError(f"{path} cannot be written whole, perhaps the disk is full ({error})") from None
        # pyarrow adds a sentence before the system's message.
        raise OSError(error.errno, os.strerror(error.errno), str(path)) from None


def read_at_most(path: Path, num_bytes: int) -> bytes:
    """Content of a file or a pipe of limited size; raises `OSError` for more."""
    with naming(path), path.open("rb") as file:
        content = file.read(num_bytes + 1)
    if len(content) > num_bytes:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
    return content


def sha256_of(path: Path) -> str:
    """Hexadecimal sha256 of a file's content, read in pieces."""
    require_regular(path)
    with naming(path), path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def write_record(folder: Path, names: Iterable[str]) -> None:
    """Record the sha256 of these files of a folder in its SHA256SUMS; names are paths from the folder."""
    write_whole(folder / RECORD, "".join(f"{sha256_of(folder / name)}  {name}\n" for name in sorted(names)))


def read_record(folder: Path, hint: str) -> dict[str, str]:
    """The recorded sha256 of a folder's files by their names; raises `DamagedFileError`, and `OSError` without any."""
    path = folder / RECORD
    try:
        with naming(path):
            lines = path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError:
        raise DamagedFileError(path, "it is not UTF-8", hint) from None
    matches = [_RECORD_LINE.fullmatch(line) for line in lines]
    if not all(matches):
        raise DamagedFileError(path, f"line {matches.index(None) + 1} is not a sha256 and a name", hint)
    return {match[2]: match[1] for match in matches if match}


def require_new(path: Path, *, overwrite: bool, replaced: Callable[[Path], bool] = Path.is_file, instead: str) -> None:
    """Raise `UsageError` for a path that exists, unless `overwrite`; `instead` says how to write elsewhere.

    An empty folder is new. Also with `overwrite` only what satisfies `replaced` may be there: a file, or a folder that
    the same command wrote.
    """
    if not path.exists() or (path.is_dir() and not any(path.iterdir())):
        return
    if not replaced(path):
        raise UsageError(f"{path} exists and is not what this command writes: {instead}")
    if not overwrite:
        raise UsageError(f"{path} exists: --overwrite replaces it, {instead}")


def remove_entry(path: Path) -> None:
    """Delete a file, a folder with its content, or a symbolic link, but not the link's target."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """Yield an empty folder that takes the place of `path` when the block ends without an error.

    It lies in `NAME.partial` beside `path`, which is locked; what a killed process left there is deleted by the next
    one. Raises `BusyError` if another process writes the same folder.
    """
    partial = path.with_name(f"{path.name}.partial")
    with locked_folder(partial, busy=f"another process is writing {partial}: wait for it, or name another folder"):
        content, former = partial / path.name, partial / f"{path.name}.former"
        remove_entry(content)
        content.mkdir()
        try:
            with naming(path):
                yield content
            with defer_signals():
                if path.exists():
                    path.rename(former)
                content.rename(path)
            sync(path.parent)
        finally:
            # Also after Ctrl-C, since a partial folder would look complete.
            remove_entry(content)
            if path.exists():
                remove_entry(former)


@contextmanager
def locked_folder(path: Path, *, busy: str) -> Iterator[None]:
    """Hold the lock of a folder during the block; the folder is created if needed, and deleted if it is then empty.

    Temporary files that a killed process left in it are deleted. Raises `BusyError` with the text `busy` if another
    process holds the lock.
    """
    path.mkdir(parents=True, exist_ok=True)
    with exclusive_lock(path / LOCK, busy=busy):
        for entry in filter(is_temporary, path.iterdir()):
            entry.unlink(missing_ok=True)
        try:
            yield
        finally:
            with suppress(OSError):
                (path / LOCK).unlink()
                path.rmdir()


@contextmanager
def exclusive_lock(path: Path, *, busy: str | None) -> Iterator[None]:
    """Hold an exclusive lock on a file during the block; the file is created if needed, and stays.

    With `busy`, a lock that is held elsewhere raises `BusyError` with that text; otherwise wait for it. The system
    releases the lock of a process that ends, however it ends. On a file system without locks, a warning takes the place
    of the lock.
    """
    from filelock import FileLock, Timeout

    lock = FileLock(path, timeout=-1 if busy is None else 0, fallback_to_soft=False)
    try:
        lock.acquire()
    except Timeout:
        raise BusyError(busy) from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        warn(f"the file system of {path.parent} has no locks: let one process at a time write there")
    try:
        yield
    finally:
        lock.release()


@contextmanager
def defer_signals() -> Iterator[None]:
    """Deliver Ctrl-C and SIGTERM only after the block, however it ends; for short blocks.

    Blocks may be nested. Does nothing outside the main thread, where no signals are handled.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    # None: a handler that was not set from Python and cannot be restored.
    previous = {number: handler for number in STOPPING_SIGNALS if (handler := signal.getsignal(number)) is not None}
    try:
        for number in previous:
            signal.signal(number, lambda arrived, frame: came.append(arrived))
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
        for arrived in came:
            signal.raise_signal(arrived)
