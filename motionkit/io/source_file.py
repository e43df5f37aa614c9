"""What all readers share: a file's bytes, hash and text, and the framerate in use.

Mislabelled files are identified for messages; time stamps of frames become a uniform grid, or an error says why not.
"""

import hashlib
import os
import re
import stat
from collections.abc import Callable, Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.motion import Provenance
from motionkit.core.shapes import Float64
from motionkit.core.timegrid import TimeGrid, parse_fps

MAX_BYTES = 4 << 30
HEADER_BYTES = 1 << 20
CONTENT = re.compile(rb"[^ \t\r\n\0]")
UTF_16 = (b"\xff\xfe", b"\xfe\xff")
# 9.7 hours at 120 fps; and frames × joints, about 80 bytes of memory each: 5 GB.
MAX_FRAMES = 1 << 22
MAX_POSES = 1 << 26


def read_bytes(path: Path) -> bytes:
    """All bytes of a file; raises `FormatError` (`unreadable`, `empty`, `too-large`)."""
    size = check_file(path).st_size
    if size > MAX_BYTES:
        raise FormatError(f"{size} bytes, expected at most {MAX_BYTES}; split the file", path=path, reason="too-large")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise unreadable(path, error) from None
    if CONTENT.search(data) is None:  # `strip` would copy
        raise FormatError("the file is empty", path=path, reason="empty")
    return data


def check_file(path: Path) -> os.stat_result:
    """`os.stat` of a file; raises `FormatError` (`unreadable`) for anything but a regular file."""
    try:
        status = path.stat()
    except OSError as error:
        raise unreadable(path, error) from None
    if not stat.S_ISREG(status.st_mode):
        raise FormatError("a folder, a pipe or a device, expected a file", path=path, reason="unreadable")
    return status


def check_size(num_frames: int, num_joints: int, path: Path) -> None:
    """Raise `FormatError` (`too-large`) beyond 4,194,304 frames, and beyond 67,108,864 frames × joints."""
    most = min(MAX_FRAMES, MAX_POSES // max(1, num_joints))
    if num_frames > most:
        raise FormatError(
            f"{num_frames:,} frames of {num_joints} joints, expected at most {most:,} frames of so many joints; cut it "
            "into several files (docs/formats.md, Long takes)",
            path=path,
            reason="too-large",
        )


def dangling(link: Path) -> FormatError | None:
    """The error of a link that leads nowhere; None for anything else."""
    try:
        if link.is_symlink():
            link.stat()
        return None
    except OSError as error:
        message = f"is a link to {link.readlink()}, which leads nowhere ({error.strerror or error}): fix the link or "
        return FormatError(message + "remove it", path=link, reason="dangling-link")


def unreadable(path: Path, error: OSError) -> FormatError:
    """The error of a file that cannot be opened or read."""
    return dangling(path) or FormatError(f"cannot be read ({error.strerror or error})", path=path, reason="unreadable")


def sha256(data: bytes) -> str:
    """SHA-256 of a file's bytes in hex."""
    return hashlib.sha256(data).hexdigest()


def provenance(
    path: Path, data: bytes, source_format: str, operations: Iterable[str], *, stated_fps: str = "", subject: str = ""
) -> Provenance:
    """The provenance of a motion read from a file's bytes, with its operation log."""
    return Provenance(
        source_path=path.name,
        source_sha256=sha256(data),
        source_format=source_format,
        subject=subject,
        stated_fps=stated_fps,
        operations=tuple(operations),
    )


def decode(data: bytes, path: Path) -> str:
    """Bytes as UTF-8 text, a byte order mark dropped; raises `FormatError` (`encoding`) naming the line."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise FormatError(
            f"byte 0x{data[error.start]:02x} is not UTF-8; convert the file to UTF-8",
            path=path,
            reason="encoding",
            line=line,
        ) from None


def header_names(path: Path) -> list[str]:
    """The names in a table's first line, in any encoding and with any separator; empty if there is no such line.

    Raises `FormatError` (`unreadable`).
    """
    try:
        if not path.is_file():
            return []
        with path.open("rb") as file:
            head = file.readline(HEADER_BYTES)
    except OSError as error:
        raise unreadable(path, error) from None
    text = head.decode("utf-16" if head.startswith(UTF_16) else "utf-8-sig", "replace")
    return [name.strip('" \r\n\ufffd') for name in re.split(r"[,;\t]", text)]


def describe_content(data: bytes) -> str:
    """A description of a file by its first bytes, for messages about mislabelled files."""
    head = data[:4096].lstrip(b"\xef\xbb\xbf \t\r\n")
    signatures = (
        (b"HIERARCHY", "a BVH file"),
        (b"\x93NUMPY", "a .npy array"),
        (b"PK\x03\x04", "a zip or .npz archive"),
        (b"\x1f\x8b", "a gzip archive"),
        (b"\x89PNG", "a PNG image"),
        (b"Kaydara FBX", "an FBX file"),
        (b":FULLY-SPECIFIED", "an AMC file"),
        (b":version", "an ASF skeleton"),
        (b"<", "an XML or HTML page"),
        (b"{", "a JSON file"),
        (b"version https://git-lfs", "a Git LFS pointer (fetch the real file with `git lfs pull`)"),
    )
    for signature, name in signatures:
        if head.startswith(signature):
            return name
    if b":FULLY-SPECIFIED" in head:
        return "an AMC file"
    if b":bonedata" in head or b":root" in head:
        return "an ASF skeleton"
    return "binary data" if b"\0" in head else "some other text"


# Rounding to milliseconds is an error of 0.06 frames at 120 fps; a missing frame is one of 1.
UNEVEN_FRAMES = 0.1


def fps_in_use(
    given: Fraction | None, stated: Callable[[], Fraction], *, words: str = ""
) -> tuple[Fraction, list[str]]:
    """The given framerate, else the stated one; and the log lines of `replaced_fps`.

    `stated` reads the file's framerate. If it raises `FormatError`, that is raised only without a given framerate;
    otherwise the log names `words` as the file's statement, or none.
    """
    if given is None:
        return stated(), []
    try:
        stated_fps: Fraction | str = stated()
    except FormatError:
        stated_fps = words
    return given, replaced_fps(given, stated_fps)


def replaced_fps(fps: Fraction, stated: Fraction | str | None, *, by: str = "", who: str = "the file") -> list[str]:
    """The log line of a framerate that replaces the one that `who` states, if any; empty if both are the same.

    `by` names the source of the decision.
    """
    return [] if fps == stated else [f"framerate set to {fps}{by}; {who} says {stated or 'none'}"]


def grid_of_seconds(seconds: Float64[np.ndarray, "frames"], path: Path, fps: Fraction | None = None) -> TimeGrid:
    """The grid of evenly spaced time stamps in seconds; `fps`, if given, must agree.

    Raises `FormatError` (`no-framerate` for a single time stamp, `frame-time` for uneven ones).
    """
    finite = np.isfinite(seconds)
    if not finite.all():
        raise _fault("a time stamp is no number", path, int(np.argmin(finite)))
    if fps is None:
        fps = _framerate(seconds, path)
    grid = TimeGrid(fps, len(seconds), float(seconds[0]))
    off = np.abs(grid.seconds() - seconds) * float(fps)
    if off.max() > UNEVEN_FRAMES:
        raise _uneven(seconds, fps, path, int(np.argmax(off > UNEVEN_FRAMES)))
    return grid


def _uneven(seconds: Float64[np.ndarray, "frames"], fps: Fraction, path: Path, frame: int) -> FormatError:
    # A missing frame shifts the mean of all steps; their median locates it.
    steps = np.diff(seconds)
    usual = float(np.median(steps))
    odd = np.abs(steps - usual) > np.abs(usual) / 2
    if not odd.any():
        what = f"is at {seconds[frame]:.6g} s; time stamps are not those of {float(fps):.6g} fps"
    else:
        frame = int(np.argmax(odd)) + 1
        what = f"comes {steps[frame - 1]:.6g} s after the one before, where {usual:.6g} s is usual"
    return _fault(f"{what}; sample the motion evenly, nothing is resampled at ingest", path, frame)


def _framerate(seconds: Float64[np.ndarray, "frames"], path: Path) -> Fraction:
    if len(seconds) < 2:
        message = "one time stamp does not say a framerate; state fps, or use --fps"
        raise FormatError(message, path=path, reason="no-framerate")
    step = float(seconds[-1] - seconds[0]) / (len(seconds) - 1)
    if step <= 0:
        raise _fault("time stamps do not ascend", path, 0)
    try:
        return parse_fps(1 / step)
    except ValueError as error:
        raise _fault(str(error), path, 0) from None


def _fault(message: str, path: Path, frame: int) -> FormatError:
    return FormatError(message, path=path, reason="frame-time", frame=frame)
