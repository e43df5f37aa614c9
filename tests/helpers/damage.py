"""What happens to files on their way: bytes lost, lines repeated, numbers too large, other line ends and encodings."""

import io
import re
import zipfile
from collections.abc import Callable

from hypothesis import strategies as st

PLAIN_WORDS = (
    b'\n| |{|}|\0|\xff|\xe9|nan|inf|-inf|1e999|-|0|-1|99999999999999999999|1e9|#|,|"|[|]|null|true|OFFSET|CHANNELS|'
    b"End Site|MOTION|Frames: 3|Frames: 2000000000|Frame Time: 0|Frame Time: -1|Frame Time: nan|Frame Time: 1e-9|"
    b"JOINT x|:root|begin|end|root 1|../../etc/passwd|\xd9\xa3|\xef\xbb\xbf|1e-999|5e-324|9/0|**/|{any}|\x1b[31m|"
    b"\\ud800"
)
# Numbers that Python does not read, or that no float holds, and brackets nested deeper than it follows.
WORDS = (*PLAIN_WORDS.split(b"|"), b"9" * 400, b"9" * 5000, b"0x" + b"f" * 5000, b"[" * 5000)
WHOLE: tuple[Callable[[bytes], bytes], ...] = (
    lambda content: content.replace(b"\n", b"\r\n"),
    lambda content: content.replace(b"\n", b"\r"),
    lambda content: b"\xef\xbb\xbf" + content,
    lambda content: content.replace(b".", b","),
    lambda content: content.decode("latin-1").encode("utf-16"),
    lambda content: content.replace(b" ", b"\xa0"),
    lambda content: content * 2,
    lambda content: content[::-1],
    lambda content: b"",
)


@st.composite
def damaged(draw: st.DrawFn, content: bytes) -> bytes:
    """A file's bytes after one to four accidents."""
    for _ in range(draw(st.integers(1, 4))):
        accident = draw(st.sampled_from([_splice, _flip, _truncate, _swap_words, _repeat_line, _whole]))
        content = draw(accident(content))
    return content


@st.composite
def damaged_archive(draw: st.DrawFn, content: bytes) -> bytes:
    """A zip archive after an accident to one of its members, whose checksum then agrees, or to the whole."""
    if draw(st.booleans()):
        return draw(damaged(content))
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    victim = draw(st.sampled_from(sorted(members)))
    fate = draw(st.sampled_from(["damage", "damage", "damage", "lose", "rename"]))
    if fate == "damage":
        members[victim] = draw(damaged(members[victim]))
    else:
        content = members.pop(victim)
        if fate == "rename":
            members[draw(st.sampled_from(["../up.npy", "/absolute.npy", "x", victim.upper()]))] = content
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, member in members.items():
            archive.writestr(name, member)
    return file.getvalue()


@st.composite
def _splice(draw: st.DrawFn, content: bytes) -> bytes:
    start = draw(st.integers(0, len(content)))
    stop = start + draw(st.sampled_from([0, 0, 1, 1, 2, 8, 64]))
    return content[:start] + draw(st.sampled_from(WORDS) | st.binary(max_size=8)) + content[stop:]


@st.composite
def _flip(draw: st.DrawFn, content: bytes) -> bytes:
    # Headers, where most of what matters stands, are hit as often as everything else together.
    if not content:
        return content
    place = draw(st.integers(0, min(len(content) - 1, 200)) | st.integers(0, len(content) - 1))
    return content[:place] + bytes([content[place] ^ (1 << draw(st.integers(0, 7)))]) + content[place + 1 :]


@st.composite
def _truncate(draw: st.DrawFn, content: bytes) -> bytes:
    return content[: draw(st.integers(0, len(content)))]


@st.composite
def _swap_words(draw: st.DrawFn, content: bytes) -> bytes:
    words = re.split(rb"(\s+)", content)
    if len(words) < 3:
        return content
    first, second = (2 * draw(st.integers(0, (len(words) - 1) // 2)) for _ in range(2))
    if draw(st.booleans()):
        words[first] = draw(st.sampled_from(WORDS))
    else:
        words[first], words[second] = words[second], words[first]
    return b"".join(words)


@st.composite
def _repeat_line(draw: st.DrawFn, content: bytes) -> bytes:
    lines = content.splitlines(keepends=True)
    if not lines:
        return content
    place = draw(st.integers(0, len(lines) - 1))
    return b"".join([*lines[: place + 1], *lines[place : place + draw(st.integers(0, 3))], *lines[place + 1 :]])


@st.composite
def _whole(draw: st.DrawFn, content: bytes) -> bytes:
    return draw(st.sampled_from(WHOLE))(content)
