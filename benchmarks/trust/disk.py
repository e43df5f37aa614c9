"""A small disk in memory that can be filled to the last page, or made read-only."""

import contextlib
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

from benchmarks.trust.faults import Fault

SIZE_BYTES = 128 * 2**20
BALLAST = ".ballast"


class NoDiskError(Exception):
    """This user may not mount a disk; says why."""


class SmallDisk:
    """A tmpfs at a folder, mounted while the `with` block runs; raises `NoDiskError` if that is not permitted."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> "SmallDisk":
        self.path.mkdir(parents=True, exist_ok=True)
        _mount("-t", "tmpfs", "-o", f"size={SIZE_BYTES}", "tmpfs", str(self.path))
        return self

    def __exit__(self, *exception: object) -> None:
        subprocess.run(("umount", "--lazy", str(self.path)), check=True)

    def fill(self, free_bytes: int) -> None:
        """Leave so many bytes free, rounded up to whole pages."""
        page = os.statvfs(self.path).f_frsize
        wanted = -(-free_bytes // page)
        with (self.path / BALLAST).open("wb") as handle:
            while (surplus := os.statvfs(self.path).f_bavail - wanted) > 0:
                # A page of the file system's own may go with it, so it is looked at again.
                os.posix_fallocate(handle.fileno(), handle.seek(0, os.SEEK_END), surplus * page)

    @contextlib.contextmanager
    def suffering(self, fault: Fault) -> Iterator[None]:
        """Be full but for the fault's bytes, or read-only, while the block runs."""
        if fault.kind == "full":
            self.fill(int(fault.number))
        else:
            _mount("-o", "remount,ro", str(self.path))
        try:
            yield
        finally:
            if fault.kind == "full":
                (self.path / BALLAST).unlink()
            else:
                _mount("-o", "remount,rw", str(self.path))


def _mount(*arguments: str) -> None:
    try:
        done = subprocess.run(("mount", *arguments), capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise NoDiskError("there is no command 'mount'") from None
    if done.returncode:
        raise NoDiskError(f"a disk in memory cannot be mounted ({done.stderr.strip()})")
