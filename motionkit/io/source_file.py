"""What all readers share: a file's bytes, hash and text, tables of numbers in it, and the framerate in use.

Mislabelled files are identified for messages; time stamps of frames become a uniform grid, or an error says why not.

Tables are read block by block: array operations find all words of some lines and view them as Arrow's 16-byte string
views (https://arrow.apache.org/docs/format/Columnar.html, variable-size binary view layout), which Arrow casts to
float64, so that no word becomes a Python object. A block that this fails to parse is parsed line by line.
"""

import hashlib
import re
import stat
import tomllib
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion, Provenance
from motionkit.core.shapes import Bool, Float32, Float64, Int64
from motionkit.core.skeleton import Skeleton
from motionkit.core.timegrid import TimeGrid, parse_fps

MAX_BYTES = 4 << 30
HEADER_BYTES = 1 << 20
CONTENT = re.compile(rb"[^ \t\r\n\0]")
UTF_16 = (b"\xff\xfe", b"\xfe\xff")
# 9.7 hours at 120 fps; and frames × joints, about 80 bytes of memory each: 5 GB.
MAX_FRAMES = 1 << 22
MAX_POSES = 1 << 26
# Of a number in a text.
LARGEST_VALUE = 1e9
# A block and its word tables fit into a core's cache, and each is small enough for malloc to reuse its memory: from
# 128 KB on every table would be mapped anew, with a page fault for each 4 KB, a third of the time of parsing.
BLOCK_BYTES = 3 << 15
# Arrow's string view of a word: its length, then the word itself if it is short.
LENGTH_BYTES, INLINE_BYTES = 4, 12
VIEW_BYTES = LENGTH_BYTES + INLINE_BYTES
NEWLINE, SPACE = 10, 32


def read_bytes(path: Path) -> bytes:
    """All bytes of a file; raises `FormatError` (`unreadable`, `empty`, `too-large`)."""
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise FormatError("a folder, a pipe or a device, expected a file", path=path, reason="unreadable")
        if status.st_size > MAX_BYTES:
            message = f"{status.st_size} bytes, expected at most {MAX_BYTES}; split the file"
            raise FormatError(message, path=path, reason="too-large")
        data = path.read_bytes()
    except OSError as error:
        raise unreadable(path, error) from None
    if CONTENT.search(data) is None:  # `strip` would copy
        raise FormatError("the file is empty", path=path, reason="empty")
    return data


def check_size(num_frames: int, num_joints: int, path: Path) -> None:
    """Raise `FormatError` (`too-large`) beyond 4,194,304 frames, and beyond 67,108,864 frames × joints."""
    most = min(MAX_FRAMES, MAX_POSES // max(1, num_joints))
    if num_frames > most:
        message = f"{num_frames:,} frames of {num_joints} joints, expected at most {most:,}; cut it into several files"
        raise FormatError(f"{message} (docs/formats.md, Long takes)", path=path, reason="too-large")


@cache
def shipped(path: str) -> dict[str, Any]:
    """A TOML file of motionkit's own, by its path in the package."""
    return tomllib.loads(resources.files("motionkit").joinpath(path).read_text(encoding="utf-8"))


def unreadable(path: Path, error: OSError) -> FormatError:
    """The error of a file that cannot be opened or read."""
    link = f", a link to {path.readlink()}" if path.is_symlink() else ""
    return FormatError(f"cannot be read ({error.strerror or error}){link}", path=path, reason="unreadable")


def provenance(
    path: Path, data: bytes, source_format: str, operations: Iterable[str], *, stated_fps: str = "", subject: str = ""
) -> Provenance:
    """The provenance of a motion read from a file's bytes, with its operation log."""
    return Provenance(
        source_path=path.name,
        source_sha256=hashlib.sha256(data).hexdigest(),
        source_format=source_format,
        subject=subject,
        stated_fps=stated_fps,
        operations=tuple(operations),
    )


def motion_of(
    path: Path,
    data: bytes,
    source_format: str,
    skeleton: Skeleton,
    fps: Fraction,
    operations: Iterable[str],
    *,
    positions: Float32[np.ndarray, "frames joints 3"] | None = None,
    rotations: Float32[np.ndarray, "frames joints 4"] | None = None,
    root: Float32[np.ndarray, "frames 3"] | None = None,
    stated_fps: str = "",
    subject: str = "",
) -> Motion:
    """A motion read from a file's bytes: joint positions, or rotations and the root's translation, from time 0 on."""
    if positions is None:
        assert rotations is not None and root is not None
        positions = kinematics.forward_kinematics(rotations, root, skeleton)
    source = provenance(path, data, source_format, operations, stated_fps=stated_fps, subject=subject)
    grid = TimeGrid(fps, len(positions))
    return Motion(positions, skeleton, grid, rotations, root, sequence_id=path.stem, provenance=source)


def decode(data: bytes, path: Path) -> str:
    """Bytes as UTF-8 text, a byte order mark dropped; raises `FormatError` (`encoding`) naming the line."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        message = f"byte 0x{data[error.start]:02x} is not UTF-8; convert the file to UTF-8"
        raise FormatError(message, path=path, reason="encoding", line=line) from None


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
        (b"Kaydara FBX", "an FBX file"),
        (b"<", "an XML or HTML page"),
        (b"{", "a JSON file"),
        (b"version https://git-lfs", "a Git LFS pointer (fetch the real file with `git lfs pull`)"),
    )
    for signature, name in signatures:
        if head.startswith(signature):
            return name
    return "binary data" if b"\0" in head else "some other text"


# Rounding to milliseconds is an error of 0.06 frames at 120 fps; a missing frame is one of 1.
UNEVEN_FRAMES = 0.1


def fps_in_use(
    given: Fraction | None, stated: Callable[[], Fraction], *, words: str = "", who: str = "the file"
) -> tuple[Fraction, list[str]]:
    """The given framerate, else the stated one; and the log lines of `replaced_fps`.

    `stated` reads the file's framerate. If it raises `FormatError`, that is raised only without a given framerate;
    otherwise the log names `words` as the statement of `who`, or none.
    """
    if given is None:
        return stated(), []
    try:
        stated_fps: Fraction | str = stated()
    except FormatError:
        stated_fps = words
    return given, replaced_fps(given, stated_fps, who=who)


def replaced_fps(fps: Fraction, stated: Fraction | str | None, *, who: str = "the file") -> list[str]:
    """The log line of a framerate that replaces the one that `who` states, if any; empty if both are the same."""
    return [] if fps == stated else [f"framerate set to {fps}; {who} says {stated or 'none'}"]


def grid_of_seconds(seconds: Float64[np.ndarray, "frames"], path: Path, fps: Fraction | None = None) -> TimeGrid:
    """The grid of evenly spaced time stamps in seconds; `fps`, if given, must agree.

    Raises `FormatError` (`no-framerate` for a single time stamp, `frame-time` for uneven ones).
    """

    def fault(message: str, frame: int) -> FormatError:
        return FormatError(message, path=path, reason="frame-time", frame=frame)

    if fps is None:
        if len(seconds) < 2:
            message = "one time stamp does not say a framerate; state fps, or use --fps"
            raise FormatError(message, path=path, reason="no-framerate")
        try:
            fps = parse_fps(1 / (float(seconds[-1] - seconds[0]) / (len(seconds) - 1)))
        except (ValueError, ZeroDivisionError) as error:
            raise fault(f"time stamps from {seconds[0]:.6g} s to {seconds[-1]:.6g} s ({error})", 0) from None
    grid = TimeGrid(fps, len(seconds), float(seconds[0]))
    off = np.abs(grid.seconds() - seconds) * float(fps)
    if not off.max() <= UNEVEN_FRAMES:  # also of nan
        steps = np.diff(seconds)
        frame = int(np.argmax(np.abs(steps - float(1 / fps)))) + 1
        what = f"comes {steps[frame - 1]:.6g} s after the one before, expected {float(1 / fps):.6g} s"
        raise fault(f"{what} at {float(fps):.6g} fps; sample the motion evenly, nothing is resampled at ingest", frame)
    return grid


def last_valid(valid: Bool[np.ndarray, "frames"], path: Path) -> Int64[np.ndarray, "frames"]:
    """For each frame the last valid one up to it, the first valid one before that; raises `FormatError` (`nan`)."""
    if not valid.any():
        raise FormatError("every frame holds nan: nothing is observed", path=path, reason="nan")
    return np.asarray(np.maximum.accumulate(np.where(valid, np.arange(len(valid)), int(np.argmax(valid)))))


def unique_names(names: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names made unique by _2, _3 …, and a log line if any was changed."""
    unique: dict[str, None] = {}
    changed: list[str] = []
    for name in names:
        candidate, number = name, 2
        while candidate in unique:
            candidate, number = f"{name}_{number}", number + 1
        unique[candidate] = None
        changed += [candidate] if candidate != name else []
    return tuple(unique), (f"repeated joint names made unique: {', '.join(changed)}",) if changed else ()


# Tables of numbers


def read_table(
    text: bytes, num_rows: int, num_columns: int, path: Path, first_line: int
) -> Float64[np.ndarray, "rows columns"]:
    """The numbers of a text with one line for each row, separated by white space; empty lines are skipped.

    `first_line` is the number of its first line in the file. Raises `FormatError` (`truncated`, `channel-count`,
    `frame-count`, `not-a-number`, `nan`, `range`) naming the line and the frame.
    """
    # A number takes at least a digit and a separator.
    most_rows = len(text) // (2 * num_columns) + 1
    table = np.empty((min(num_rows, most_rows), num_columns))
    row, line, stop = 0, first_line, 0
    while stop < len(text):
        start, stop = stop, text.find(b"\n", stop + BLOCK_BYTES) + 1 or len(text)
        block = text[start:stop]
        rows = _rows_of_block(block, num_columns)
        if rows is None or row + len(rows) > num_rows:
            rows = _rows_of_lines(block, num_columns, path, line, row, num_rows, is_last=stop == len(text))
        table[row : row + len(rows)] = rows
        row += len(rows)
        line += block.count(b"\n")
    if row < num_rows:
        message = f"the file ends after {row} frames, expected {num_rows}"
        raise FormatError(message, path=path, reason="truncated", line=line, frame=row)
    return table


def format_table(table: Float64[np.ndarray, "rows columns"]) -> bytes:
    """One line per row, numbers separated by spaces, each with its shortest exact digits."""
    import pyarrow as pa
    from pyarrow import csv

    columns = pa.table({str(column): values for column, values in enumerate(np.ascontiguousarray(table.T))})
    buffer = pa.BufferOutputStream()
    csv.write_csv(columns, buffer, csv.WriteOptions(include_header=False, delimiter=" ", quoting_style="none"))
    return bytes(buffer.getvalue().to_pybytes())


class Words(NamedTuple):
    """The words of a text, between newlines: each begins at `starts` of `padded` and has `lengths` bytes."""

    padded: bytes
    starts: Int64[np.ndarray, "words"]
    lengths: Int64[np.ndarray, "words"]

    def windows(self, num_bytes: int) -> np.ndarray:
        """The `num_bytes` bytes from every offset of the text, as opaque values, without a copy."""
        return np.ndarray((len(self.padded) - num_bytes,), f"V{num_bytes}", self.padded, strides=(1,))


def find_words(text: bytes) -> Words:
    """All words of a text, which are separated by white space."""
    padded = b"".join((b"\n" * LENGTH_BYTES, text, b"\n" * (VIEW_BYTES + 1)))
    solid = np.frombuffer(padded, np.uint8) > SPACE
    edges = np.flatnonzero(solid[1:] != solid[:-1]) + 1
    return Words(padded, edges[::2], edges[1::2] - edges[::2])


def to_numbers(words: Words) -> Float64[np.ndarray, "words"] | None:
    """The words as numbers; None if one is not a finite number in the valid range."""
    import pyarrow as pa

    # A view begins before its word, to leave room for the length.
    views = words.windows(VIEW_BYTES)[words.starts - LENGTH_BYTES].view("<i4").reshape(-1, 4)
    views[:, 0] = words.lengths
    long = np.flatnonzero(words.lengths > INLINE_BYTES)
    if long.size:  # these are four bytes, a buffer's number and an offset into it
        views[long, 2], views[long, 3] = 0, words.starts[long]
    buffers = [None, pa.py_buffer(views), pa.py_buffer(words.padded)]
    try:
        column = pa.Array.from_buffers(pa.string_view(), len(views), buffers).cast(pa.float64())
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
        return None
    values = np.frombuffer(column.buffers()[1], np.float64, len(column))  # `to_numpy` would import pandas: 0.3 s
    return values if (np.abs(values) < LARGEST_VALUE).all() else None


def _rows_of_block(block: bytes, num_columns: int) -> Float64[np.ndarray, "rows columns"] | None:
    """The rows of a block; None if a line has another number of words, or a word is no number."""
    words = find_words(block)
    if len(words.starts) % num_columns:
        return None
    newlines = np.flatnonzero(np.frombuffer(words.padded, np.uint8) == NEWLINE)
    first = np.searchsorted(newlines, words.starts[::num_columns])
    last = np.searchsorted(newlines, words.starts[num_columns - 1 :: num_columns])
    if (first != last).any() or (first[1:] == last[:-1]).any():
        return None
    numbers = to_numbers(words)
    return None if numbers is None else numbers.reshape(-1, num_columns)


def _rows_of_lines(
    block: bytes, num_columns: int, path: Path, first_line: int, first_row: int, num_rows: int, *, is_last: bool
) -> Float64[np.ndarray, "rows columns"]:
    """The rows of a block, line by line; raises what `read_table` raises. `is_last`: the text ends with the block."""
    numbers: list[list[float]] = []
    lines = block.rstrip().split(b"\n")
    for line, text in enumerate(lines, start=first_line):
        words, frame = text.split(), first_row + len(numbers)
        if not words:
            continue
        if frame == num_rows:
            message = f"a line of numbers after the {num_rows} declared frames; expected the end of the file"
            raise FormatError(message, path=path, reason="frame-count", line=line)
        if len(words) != num_columns:
            is_cut = is_last and len(words) < num_columns and line == first_line + len(lines) - 1
            message, reason = f"{len(words)} numbers, expected {num_columns} (one for each channel)", "channel-count"
            if is_cut:
                message = f"the file ends after {len(words)} of {num_columns} numbers, expected {num_rows} whole frames"
                reason = "truncated"
            raise FormatError(message, path=path, reason=reason, line=line, frame=frame)
        numbers.append([parse_number(word, path, line, frame) for word in words])
    return np.array(numbers, dtype=np.float64).reshape(len(numbers), num_columns)


def parse_number(word: bytes | str, path: Path, line: int, frame: int | None = None) -> float:
    """A finite number in the valid range; raises `FormatError` (`not-a-number`, `nan`, `range`) naming the line."""
    shown = word.decode("utf-8", "backslashreplace") if isinstance(word, bytes) else word
    try:
        value = float(shown.replace("_", "?"))  # Python's numbers may have underscores
    except ValueError:
        message, reason = f"{shown[:40]!r} where a number was expected", "not-a-number"
    else:
        if abs(value) < LARGEST_VALUE:
            return value
        message, reason = f"{shown[:40]} where a finite number was expected", "nan"
        if np.isfinite(value):
            message, reason = f"{value:g} is beyond ±{LARGEST_VALUE:g}; no channel of a body is", "range"
    raise FormatError(message, path=path, reason=reason, line=line, frame=frame)
