"""One to four mutations of a file, suited to its content; all randomness comes from one generator."""

import io
import json
import re
import struct
import zipfile
from collections.abc import Callable
from random import Random
from typing import Any

Accident = Callable[[Random, bytes], bytes]
MOST_BYTES = 2 << 20
NPY = b"\x93NUMPY"
# Extreme machine words, and words that mean something to some parser.
WORDS = tuple(struct.pack(code, value) for code, value in (("<i", -1), ("<i", 2**31 - 1), (">i", 1), ("<d", 1e308)))
WILD = (
    *b"nan inf -inf 1e999 1e39 0 -1 3.5 1e9 65536 2147483648 9223372036854775808 1_000 0x10 1,5 1.2.3 1/0 [".split(),
    *b"{ } # , * (a+)+$ ../../x /etc/passwd OFFSET CHANNELS JOINT MOTION Frames: :root begin None __proto__".split(),
    *(b"", b"\0", b"\xff", b"\xef\xbb\xbf", b"\n", b"\x1b[31m", b"9" * 5000, b"x" * 70_000, "٣".encode()),
)
VALUES: tuple[Any, ...] = (None, True, "", "nan", "../../x", "\x1b[31m", "x" * 70_000, [], {}, [[1.5]], -1.5, 10**30)
TOKEN = re.compile(rb"[^\s,;:{}\[\]()\"'=|]+")


def mutate(rng: Random, name: str, content: bytes) -> bytes:
    """A file's bytes after one to four mutations; mostly one, since readers stop at the first fault."""
    for _ in range(rng.choice((1, 1, 1, 1, 2, 2, 3, 4))):
        content = _accident_of(name, content)(rng, content)[:MOST_BYTES]
    return content


def flip(rng: Random, content: bytes) -> bytes:
    """A file's bytes with one of them changed: anywhere, or near its ends, where headers stand."""
    last, near = len(content) - 1, min(512, len(content)) - 1
    place = rng.choice((rng.randint(0, last), rng.randint(0, last), rng.randint(0, near), last - rng.randint(0, near)))
    return content[:place] + bytes([(content[place] + rng.randrange(1, 256)) % 256]) + content[place + 1 :]


def _accident_of(name: str, content: bytes) -> Accident:
    if content.startswith(b"PK\x03\x04"):
        return _zip
    if content.startswith(NPY):
        return _npy
    if name.endswith(".jsonl") or content.lstrip()[:1] in (b"{", b"["):
        return _json
    return _bytes if b"\0" in content else _text


def _bytes(rng: Random, content: bytes) -> bytes:
    # Headers, which matter most, and ends are as likely as the rest.
    last = max(0, len(content) - 1)
    place = rng.choice((rng.randint(0, min(last, 64)), rng.randint(max(0, last - 512), last), rng.randint(0, last)))
    count, word = rng.choice((1, 4, 64, 512)), rng.choice(WORDS)
    head, tail = content[:place], content[place:]
    changed = (bytes([rng.randrange(256)]) + tail[1:], word + tail[len(word) :], b"", tail[count:])
    longer = (rng.randbytes(count) + tail, bytes(min(count, len(tail))) + tail[count:], tail + content)
    return head + rng.choice((*changed, *longer))


def _text(rng: Random, content: bytes) -> bytes:
    tokens = [found.span() for found in TOKEN.finditer(content[: 1 << 16])] or [(0, 0)]
    (start, stop), (other, end) = rng.choice(tokens), rng.choice(tokens)
    lines = content.splitlines(keepends=True) or [b""]
    line = rng.randrange(len(lines))
    fate = rng.randrange(10)
    if fate < 4:
        return content[:start] + rng.choice(WILD) + content[stop:]
    if fate == 4:
        return content[:start] + content[other:end] * rng.choice((1, 1, 50)) + content[stop:]
    if fate == 5:
        return b"".join(lines[:line] + lines[line + 1 :])
    if fate == 6:
        return b"".join(lines[:line] + [lines[line]] * rng.choice((2, 500)) + lines[line + 1 :])
    if fate == 7:
        return content[:start] + rng.choice((b"{", b"[", b"(", b'{"a":', content[start : start + 60])) * 20_000
    if fate == 8:
        text = content.decode("latin-1")
        returns = content.replace(b"\n", b"\r")
        return rng.choice((text.encode("utf-16"), returns, content.upper(), b"", b"\0" * 1000, content * 2))
    return _bytes(rng, content)


def _json(rng: Random, content: bytes) -> bytes:
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        return _text(rng, content)
    steps: list[tuple[Any, Any]] = []
    waiting = [document]
    while waiting and len(steps) < 2000:
        container = waiting.pop()
        keys = list(container) if isinstance(container, dict) else range(len(container))
        steps += [(container, key) for key in keys]
        waiting += [container[key] for key in keys if isinstance(container[key], (dict, list))]
    if not steps or rng.random() < 0.2:
        return _text(rng, content)
    container, key = rng.choice(steps)
    fate = rng.randrange(4)
    if fate == 0:
        del container[key]
    elif fate == 1:
        container[key] = [container[key]] * rng.choice((1, 2, 1000))
    else:
        container[key] = rng.choice(VALUES)
    return json.dumps(document, ensure_ascii=rng.random() < 0.8).encode("utf-8", "surrogatepass")


def _npy(rng: Random, content: bytes) -> bytes:
    # The header is text between a magic number with two bytes of length and the data.
    (length,) = struct.unpack("<H", content[8:10].ljust(2, b"\0"))
    header, data = content[10 : 10 + length], content[10 + length :]
    if rng.random() < 0.5 or content[6:7] != b"\x01":
        return content[: 10 + length] + _bytes(rng, data)
    header = _text(rng, header)[:65_535]
    return content[:8] + struct.pack("<H", len(header)) + header + data


def _zip(rng: Random, content: bytes) -> bytes:
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {info.filename: archive.read(info) for info in archive.infolist() if info.file_size < MOST_BYTES}
        victim = rng.choice(sorted(members))
    except Exception:  # an earlier accident has damaged it
        return _bytes(rng, content)
    fate = rng.randrange(8)
    if fate == 0:
        return _bytes(rng, content)
    if fate == 1:
        del members[victim]
    elif fate == 2:
        members[rng.choice(("../up.npy", "/absolute.npy", "fps.npy", "x" * 300))] = members.pop(victim)
    else:
        members[victim] = _accident_of(victim, members[victim])(rng, members[victim])
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, member in members.items():
            archive.writestr(name, member)
    return file.getvalue()
