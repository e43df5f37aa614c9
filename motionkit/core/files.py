"""Files and folders that appear whole or not at all, locks between processes, deleting without following links."""

import errno
import fcntl
import os
import shutil
import socket
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from motionkit.core.errors import LinkError, StoreError, UsageError

# In a folder that is being written, and what is read of one to say who writes.
LOCK = ".lock"
HOLDER_BYTES = 300


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary file beside `path` that replaces it when the block ends without an error.

    The content is flushed to the disk before the rename, and the folder after it. Permissions follow the umask. The
    temporary file has one name for each `path` and is locked: a second writer of the same path waits for the first, and
    what a killed one left is written over. Raises `OSError` that names `path`, also where the disk is full.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.exists():
        require_regular(path)
    temporary = temporary_name(path)
    with naming(path):
        descriptor = _open_locked(temporary)
        try:
            yield temporary
            replace(temporary, path)
        finally:
            # Once it has been renamed, a file of that name is another writer's.
            if _is_at(descriptor, temporary):
                temporary.unlink()
            os.close(descriptor)


def write_whole(path: Path, content: bytes | str) -> None:
    """Write bytes, or text as UTF-8, into a file that appears whole or not at all."""
    with whole_file(path) as temporary:
        temporary.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


def replace(source: Path, target: Path) -> None:
    """Rename inside one folder, replacing what was there; the content and then the name are flushed to the disk."""
    sync(source)
    source.replace(target)
    sync(target.parent)


def create(path: Path) -> None:
    """Make an empty file where there is nothing, not even a link; raises `FileExistsError`."""
    os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))


def read_regular(path: Path) -> bytes:
    """Content of a file; raises `OSError` for a pipe or a device, which might never end."""
    require_regular(path)
    return path.read_bytes()


def read_at_most(path: Path, num_bytes: int) -> bytes:
    """Content of a file or a pipe of up to so many bytes; raises `OSError` for more, which a device never ends."""
    with path.open("rb") as file:
        content = file.read(num_bytes + 1)
    if len(content) > num_bytes:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
    return content


def require_regular(path: Path) -> None:
    """Raise `OSError` for what is there but is no file: a folder, a pipe, a device. A link to a file is one."""
    if not stat.S_ISREG(path.stat().st_mode):
        raise OSError(errno.EINVAL, "not a regular file", str(path))


def temporary_name(path: Path) -> Path:
    """Where `whole_file` writes what becomes `path`; its suffix stays last, for writers that choose by it."""
    return path.with_name(f".{path.name}.tmp{path.suffix}")


def require_no_link(path: Path, instead: str) -> None:
    """Raise `LinkError`, with what to do instead, where `path` is a symbolic link."""
    if path.is_symlink():
        raise LinkError(
            f"{path} is a symbolic link to {path.readlink()}, which is not followed, for what lies there may be "
            f"somebody else's: {instead}"
        )


def free_bytes(path: Path) -> int:
    """Room on the disk of a path, or of the folder above it that is there."""
    return shutil.disk_usage(existing(path)).free


def existing(path: Path) -> Path:
    """The path itself, or the nearest folder above it that is there."""
    there = path.absolute()
    while not there.exists():
        there = there.parent
    return there


def require_empty(folder: Path) -> None:
    """Raise `UsageError` for a folder that holds something, or a file of its name."""
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder} is a file: name a new folder")
    if folder.exists() and any(folder.iterdir()):
        raise UsageError(f"{folder} is not empty: name a new folder")


def remove_folder(path: Path) -> None:
    """Delete a folder and all that is in it; raises `LinkError` for a symbolic link, follows none inside."""
    require_no_link(path, "delete the link, or what it points to, yourself")
    shutil.rmtree(path)


def remove_entry(path: Path) -> None:
    """Delete a file, a folder with all that is in it, or a symbolic link, but not what the link points to."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _open_locked(path: Path) -> int:
    """A locked descriptor of an empty file at `path`."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        with suppress(OSError):  # some network file systems have no locks
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        if _is_at(descriptor, path):
            os.ftruncate(descriptor, 0)
            return descriptor
        os.close(descriptor)  # the writer that was waited for has renamed the file


def _is_at(descriptor: int, path: Path) -> bool:
    """Whether `path` is the name of an open file."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    except FileNotFoundError:
        return False


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Let an `OSError` that names no file, as a write to a full disk raises it, name this one."""
    try:
        yield
    except OSError as error:
        if error.filename is not None:
            raise
        if error.errno is None:  # as numpy raises it
            raise OSError(f"{path} cannot be written whole, perhaps the disk is full ({error})") from None
        # pyarrow puts a sentence of its own before the system's words.
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

    It lies in `NAME.partial` beside `path`, with a lock that dies with the process: what a killed writer left is
    deleted by the next one. Raises `UsageError` where another process writes the same folder, or where `NAME.partial`
    is somebody else's, and `LinkError` where it is a link.
    """
    partial = path.with_name(f"{path.name}.partial")
    require_no_link(partial, "delete the link")
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor = _lock_folder(partial)
    content = partial / path.name
    try:
        _remove_content(partial)
        content.mkdir()
        with naming(path):
            yield content
        content.rename(path)
        sync(path.parent)
    finally:
        # Also when stopped by Ctrl-C: nobody would see that it is half a folder. The lock goes last.
        _remove_content(partial)
        with suppress(OSError):
            (partial / LOCK).unlink()
            partial.rmdir()
        os.close(descriptor)


def _lock_folder(partial: Path) -> int:
    """The locked descriptor of the lock's file in `partial`, which is made where it is absent."""
    lock = partial / LOCK
    while True:
        partial.mkdir(exist_ok=True)
        if not lock.exists() and any(partial.iterdir()):
            raise UsageError(f"{partial} exists, and motionkit did not make it: delete it, or name another folder")
        # Another writer that ends at this moment deletes the lock, and the folder.
        with suppress(FileNotFoundError):
            descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.path.samestat(os.fstat(descriptor), lock.lstat()):
                    return descriptor
            except BlockingIOError:
                os.close(descriptor)
                raise UsageError(
                    f"{partial} is being written by another process: wait for it, or name another folder"
                ) from None
            except OSError:
                os.close(descriptor)
                raise
            os.close(descriptor)


def _remove_content(partial: Path) -> None:
    for entry in partial.iterdir():
        if entry.name != LOCK:
            remove_entry(entry)


@contextmanager
def exclusive_lock(path: Path, *, busy: str | None) -> Iterator[None]:
    """Hold an exclusive lock on a file for as long as the block runs; the file is made where it is missing.

    With `busy`, a lock that is held elsewhere raises `StoreError` with that text and the holder's name; without, it is
    waited for. Raises `LinkError` for a symbolic link.
    """
    require_no_link(path, "delete the link")
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    try:
        with naming(path):
            _lock(descriptor, busy)
            os.ftruncate(descriptor, 0)
            os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
        yield
    finally:
        os.close(descriptor)


def _lock(descriptor: int, busy: str | None) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (fcntl.LOCK_NB if busy is not None else 0))
    except OSError as error:
        if error.errno not in (errno.EAGAIN, errno.EACCES):
            raise
        holder = os.read(descriptor, HOLDER_BYTES).decode("utf-8", "replace").strip()
        raise StoreError(f"{busy} (held by {holder or 'an unknown process'})") from None
