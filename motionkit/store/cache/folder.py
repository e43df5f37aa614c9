"""Folders of training caches: location, names, and removal of outdated ones.

A cache is a folder `KEY` of known files, in the store's folder `cache` or in one that the user names. Only folders with
such a name and our marker are removed, and of them only known files; symbolic links are not followed.
"""

import errno
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from motionkit.core.errors import DamagedFileError, LinkError, StoreError
from motionkit.core.files import exclusive_lock, require_no_link, temporary_name, write_whole
from motionkit.core.settings import optional_path
from motionkit.store.schema import CACHE_FOLDER

# Raised when a cache's files or their content change.
CACHE_VERSION = 2
CACHE_FILE = "cache.json"
INDEX_FILE = "index.npy"
POSITIONS_FILE = "positions.npy"
MARKER_FILE = ".motionkit-cache"
MARKER = f"motionkit training cache, version {CACHE_VERSION}: may be deleted at any time\n"

_LOCK_FILE = ".builder.lock"
_NAME = re.compile(r"[0-9a-f]{16}-[a-z0-9]+-[0-9a-f]{16}")
_OF_VERSION_1 = (CACHE_FILE, INDEX_FILE, POSITIONS_FILE)
_NOT_WRITABLE = (errno.EROFS, errno.EACCES, errno.EPERM)


def cache_root(store: Path, fingerprint: str) -> Path:
    """The folder of a store's caches: `cache` in the store, or `fingerprint` in the folder that MOTIONKIT_CACHE names.

    Raises `LinkError` where it is a symbolic link.
    """
    elsewhere = optional_path("cache")
    root = store / CACHE_FOLDER if elsewhere is None else elsewhere / fingerprint
    require_no_link(root, "delete the link, and name the folder for caches in MOTIONKIT_CACHE")
    return root


def cache_name(fingerprint: str, layout: str, key: str) -> str:
    """Name of a cache's folder, by the fingerprint of its store and the digest of all that it depends on."""
    return f"{fingerprint[:16]}-{layout}-{key[:16]}"


@contextmanager
def building(root: Path, damage: DamagedFileError | None = None) -> Iterator[None]:
    """Hold the builder's lock on the folder of a store's caches, which is created if needed.

    `damage` is the reason for building. Raises `StoreError` that names MOTIONKIT_CACHE if the folder is not writable.
    """
    with writable(damage):
        root.mkdir(parents=True, exist_ok=True)
        with exclusive_lock(root / _LOCK_FILE, busy=None):
            yield


@contextmanager
def writable(damage: DamagedFileError | None = None) -> Iterator[None]:
    """Raise `StoreError` that names MOTIONKIT_CACHE if a cache is not writable in the block."""
    try:
        yield
    except OSError as error:
        if error.errno not in _NOT_WRITABLE:
            raise
        why = f"{damage.path} is damaged ({damage.fault}), and " if damage else ""
        raise StoreError(
            f"{why}the training cache cannot be written ({error}): name a folder for caches with MOTIONKIT_CACHE"
        ) from None


def mark(folder: Path) -> None:
    """Create a cache's folder with our marker; raises `LinkError` for a symbolic link."""
    require_no_link(folder, "delete the link")
    folder.mkdir(exist_ok=True)
    write_whole(folder / MARKER_FILE, MARKER)


def cache_bytes(store: Path, fingerprint: str) -> int:
    """Bytes of all caches of a store, those of its earlier states in the store included."""
    try:
        folders = _own_folders(cache_root(store, fingerprint))
    except LinkError:
        return 0
    return sum(path.lstat().st_size for folder in folders for path in folder.iterdir())


def caches_of(root: Path, fingerprint: str) -> list[Path]:
    """The complete caches of one state of a store, of this version."""
    return [
        folder
        for folder in _own_folders(root)
        if _is_of(folder, fingerprint) and _marker(folder) == MARKER and (folder / CACHE_FILE).exists()
    ]


def remove_stale(root: Path, fingerprint: str) -> None:
    """Remove caches of other states of the store and of other versions; open memory maps stay valid."""
    for folder in _own_folders(root):
        if not _is_of(folder, fingerprint) or _marker(folder) != MARKER:
            remove_cache(folder)


def remove_stale_caches(store: Path, fingerprint: str) -> None:
    """Remove the caches of other states of the store inside it, when no builder is running."""
    root = store / CACHE_FOLDER
    if _own_folders(root):
        with building(root):
            remove_stale(root, fingerprint)


def remove_cache(folder: Path) -> None:
    """Remove a cache's own files, and its folder if it has no others."""
    names = {entry.name for entry in os.scandir(folder) if not entry.is_dir(follow_symlinks=False)}
    # Whatever is derived from a cache has a lock (`PositionCache.derived_rows`).
    derived = [name[1:].removesuffix(".lock") for name in names if name.startswith(".") and name.endswith(".lock")]
    own = [CACHE_FILE, INDEX_FILE, POSITIONS_FILE]
    for name in derived:
        own += [f"{name}.json", f"{name}.npy", f"{name}.partial"]
    own += [temporary_name(folder / name).name for name in [*own, MARKER_FILE]]
    own += [*(f".{name}.lock" for name in derived), MARKER_FILE]
    for name in own:
        if name in names:
            (folder / name).unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()


def _own_folders(root: Path) -> list[Path]:
    if not root.is_dir() or root.is_symlink():
        return []
    found = (Path(entry) for entry in os.scandir(root) if entry.is_dir(follow_symlinks=False))
    return sorted(folder for folder in found if _NAME.fullmatch(folder.name) and is_cache(folder))


def is_cache(folder: Path) -> bool:
    """Whether a folder with a cache's name is a cache, complete or not."""
    # Caches of version 1 had no marker, but always these three. One that has just been begun has nothing yet.
    begun = {entry.name for entry in os.scandir(folder)} <= {temporary_name(folder / MARKER_FILE).name}
    return begun or bool(_marker(folder)) or all(_is_file(folder / name) for name in _OF_VERSION_1)


def _is_of(folder: Path, fingerprint: str) -> bool:
    return folder.name.startswith(f"{fingerprint[:16]}-")


def _marker(folder: Path) -> str:
    path = folder / MARKER_FILE
    if not _is_file(path):
        return ""
    with path.open(encoding="utf-8", errors="replace") as file:
        return file.read(2 * len(MARKER))


def _is_file(path: Path) -> bool:
    return path.is_file() and not path.is_symlink()
