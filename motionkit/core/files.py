"""Atomic files and folders, locks between processes, deletion without following links."""

import errno
import os
import shutil
import socket
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from motionkit.core.errors import BusyError, LinkError, UsageError
from motionkit.core.progress import warn

# The lock file in a folder that one process writes at a time, and how much of it is read for messages.
LOCK = ".lock"
HOLDER_BYTES = 300
_NO_LOCKS = (errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK)


# The files and the folder by which a store is known.
MANIFEST_FILE, SEQUENCES_FILE, SEGMENTS_FOLDER = "manifest.json", "sequences.parquet", "segments"


def is_store(path: Path) -> bool:
    """Whether a path is a store's folder, intact or damaged: it has a manifest beside a table or parts."""
    # Not Path.is_file, which raises for folders that may not be entered.
    beside = (path / SEQUENCES_FILE, path / SEGMENTS_FOLDER)
    return os.path.isfile(path / MANIFEST_FILE) and any(map(os.path.exists, beside))  # noqa: PTH113


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary file beside `path` that replaces it when the block ends without an error.

    The content is flushed to the disk before the rename, and the folder after it. Permissions follow the umask. The
    temporary file has a fixed name for each `path` and is locked: a second writer of the same path waits for the first,
    and a killed writer's file is overwritten. Raises `OSError` that names `path`, also if the disk is full.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.exists():
        require_regular(path)
    temporary = temporary_name(path)
    with naming(path):
        descriptor, _ = _open_locked(temporary)
        try:
            os.ftruncate(descriptor, 0)
            yield temporary
            replace(temporary, path)
        finally:
            # After the rename, a file of that name belongs to another writer.
            if _is_at(descriptor, temporary):
                temporary.unlink()
            os.close(descriptor)


def write_whole(path: Path, content: bytes | str) -> None:
    """Write bytes, or text as UTF-8, atomically."""
    with whole_file(path) as temporary:
        temporary.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


def replace(source: Path, target: Path) -> None:
    """Rename inside one folder, replacing the target; content, then name are flushed to the disk."""
    sync(source)
    source.replace(target)
    sync(target.parent)


def create(path: Path) -> None:
    """Create an empty file; raises `FileExistsError` if anything is there, even a link."""
    os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))


def read_regular(path: Path) -> bytes:
    """Content of a regular file; raises `OSError` for a pipe or a device, which might never end."""
    require_regular(path)
    with naming(path):
        return path.read_bytes()


def read_at_most(path: Path, num_bytes: int) -> bytes:
    """Content of a file or a pipe of limited size; raises `OSError` for more."""
    with naming(path), path.open("rb") as file:
        content = file.read(num_bytes + 1)
    if len(content) > num_bytes:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
    return content


def require_regular(path: Path) -> None:
    """Raise `OSError` for a folder, a pipe or a device; links to files are allowed."""
    if not stat.S_ISREG(path.stat().st_mode):
        raise OSError(errno.EINVAL, "not a regular file", str(path))


def temporary_name(path: Path) -> Path:
    """The temporary path of `whole_file`; the suffix stays last, for writers that choose by it."""
    return path.with_name(f".{path.name}.tmp{path.suffix}")


def require_no_link(path: Path, instead: str) -> None:
    """Raise `LinkError`, with advice, if `path` is a symbolic link."""
    if path.is_symlink():
        raise LinkError(
            f"{path} is a symbolic link to {path.readlink()}, which is not followed, for what lies there may be "
            f"somebody else's: {instead}"
        )


def free_bytes(path: Path) -> int:
    """Free bytes on the disk of a path, or of its nearest existing parent."""
    return shutil.disk_usage(existing(path)).free


def existing(path: Path) -> Path:
    """The path itself, or its nearest existing parent."""
    there = path.absolute()
    while not there.exists():
        there = there.parent
    return there


def require_empty(folder: Path) -> None:
    """Raise `UsageError` for a folder that is not empty, or a file."""
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder} is a file: name a new folder")
    if folder.exists() and any(folder.iterdir()):
        raise UsageError(f"{folder} is not empty: name a new folder")


def remove_folder(path: Path) -> None:
    """Delete a folder with its content, without following links; raises `LinkError` for a symbolic link."""
    require_no_link(path, "delete the link, or what it points to, yourself")
    shutil.rmtree(path)


def remove_entry(path: Path) -> None:
    """Delete a file, a folder with its content, or a symbolic link, but not the link's target."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _open_locked(path: Path, busy: str | None = None) -> tuple[int, bool]:
    """A descriptor of the file at `path`, which is created if needed, and whether its file system could lock it.

    Waits for a lock that is held elsewhere, or raises `BusyError` with the text `busy`.
    """
    from filelock import lock_descriptor

    while True:
        descriptor, locked = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666), True
        try:
            if not lock_descriptor(descriptor, blocking=busy is None):
                holder = os.read(descriptor, HOLDER_BYTES).decode("utf-8", "replace").strip()
                raise BusyError(f"{busy} (held by {holder or 'an unknown process'})")
        except BaseException as error:
            if not isinstance(error, OSError) or error.errno not in _NO_LOCKS:
                os.close(descriptor)
                raise
            locked = False
        if _is_at(descriptor, path):
            return descriptor, locked
        os.close(descriptor)  # the previous holder has renamed or deleted the file


def _is_at(descriptor: int, path: Path) -> bool:
    """Whether `path` is the name of an open file."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    except FileNotFoundError:
        return False


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


def sync(path: Path) -> None:
    """Flush a file's content, or a folder's entries, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        with naming(path):
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """Yield an empty folder that becomes `path`, which must be absent or empty, when the block ends without an error.

    It is `NAME.partial` beside `path`, with a lock that is released when the process dies: leftovers of a killed writer
    are deleted by the next one. Raises `BusyError` if another process writes the same folder, `UsageError` if
    `NAME.partial` was not made by motionkit, and `LinkError` for a link.
    """
    partial = path.with_name(f"{path.name}.partial")
    require_no_link(partial, "delete the link")
    if partial.exists() and not (partial / LOCK).exists() and any(partial.iterdir()):
        raise UsageError(f"{partial} exists, and motionkit did not make it: delete it, or name another folder")
    with locked_folder(partial, busy=f"another process is writing {partial}: wait for it, or name another folder"):
        content = partial / path.name
        try:
            _remove_content(partial)
            content.mkdir()
            with naming(path):
                yield content
            content.rename(path)
            sync(path.parent)
        finally:
            # Also after Ctrl-C, since a partial folder would look complete.
            _remove_content(partial)


def _remove_content(partial: Path) -> None:
    for entry in partial.iterdir():
        if entry.name != LOCK:
            remove_entry(entry)


@contextmanager
def locked_folder(path: Path, *, busy: str) -> Iterator[None]:
    """Hold the lock of a folder during the block; the folder is created if needed, and deleted if it is then empty.

    A lock that is held elsewhere raises `BusyError` with the text `busy` and the holder's process and host.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    path.mkdir(exist_ok=True)
    with exclusive_lock(path / LOCK, busy=busy):
        try:
            yield
        finally:
            with suppress(OSError):
                (path / LOCK).unlink()
                path.rmdir()


@contextmanager
def exclusive_lock(path: Path, *, busy: str | None) -> Iterator[None]:
    """Hold an exclusive lock on a file during the block; the file is created if needed, and stays.

    With `busy`, a lock that is held elsewhere raises `BusyError` with that text and the holder's process and host;
    otherwise wait for it. The system releases the lock of a process that ends, however it ends. On a file system
    without locks, a warning takes the place of the lock. Raises `LinkError` for a symbolic link.
    """
    require_no_link(path, "delete the link")
    descriptor, locked = _open_locked(path, busy)
    if not locked:
        warn(f"the file system of {path.parent} has no locks: let one process at a time write there")
    try:
        with naming(path):
            os.ftruncate(descriptor, 0)
            os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
        yield
    finally:
        os.close(descriptor)
