"""Reading a file once: its bytes, its hash, its text; and telling what a mislabelled file is."""

import hashlib
import os
import re
import stat
from pathlib import Path

from motionkit.errors import FormatError
from motionkit.formats.folders import dangling

MAX_BYTES = 4 << 30
HEADER_BYTES = 1 << 20
BLANK = b" \t\r\n\0"
UTF_16 = (b"\xff\xfe", b"\xfe\xff")


def read_bytes(path: Path) -> bytes:
    """All bytes of a file; raises `FormatError` (`unreadable`, `empty`, `too-large`)."""
    size = check_file(path).st_size
    if size > MAX_BYTES:
        raise FormatError(f"{size} bytes, expected at most {MAX_BYTES}; split the file", path=path, reason="too-large")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise unreadable(path, error) from None
    if not data.strip(BLANK):
        raise FormatError("the file is empty", path=path, reason="empty")
    return data


def check_file(path: Path) -> os.stat_result:
    """What the system knows of a file; raises `FormatError` (`unreadable`) for what is none."""
    try:
        status = path.stat()
    except OSError as error:
        raise unreadable(path, error) from None
    if not stat.S_ISREG(status.st_mode):
        raise FormatError("a folder, a pipe or a device, expected a file", path=path, reason="unreadable")
    return status


def unreadable(path: Path, error: OSError) -> FormatError:
    """The error of a file that the system does not give out."""
    return dangling(path) or FormatError(f"cannot be read ({error.strerror or error})", path=path, reason="unreadable")


def sha256(data: bytes) -> str:
    """Hash of a file's bytes in hex."""
    return hashlib.sha256(data).hexdigest()


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
    """The names in a table's first line, whatever encodes and separates them; none where there is no such line."""
    try:
        if not path.is_file():
            return []
        with path.open("rb") as file:
            head = file.readline(HEADER_BYTES)
    except OSError:
        return []
    text = head.decode("utf-16" if head.startswith(UTF_16) else "utf-8-sig", "replace")
    return [name.strip('" \r\n\ufffd') for name in re.split(r"[,;\t]", text)]


def describe_content(data: bytes) -> str:
    """What the first bytes of a file look like, for messages about files that are not what their names say."""
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
