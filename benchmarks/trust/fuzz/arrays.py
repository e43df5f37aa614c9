"""Mutations of numpy's files: invalid headers, extreme numbers, malicious pickles."""

import ast
import pickletools
import struct
import warnings
from contextlib import suppress
from random import Random

import numpy as np

from benchmarks.trust.fuzz.binary import mutate_bytes
from benchmarks.trust.fuzz.text import mutate_text

NPY = b"\x93NUMPY"
TYPES = (
    *("<f4", "<f8", ">f4", ">f8", "<f2", "<f16", "<c8", "<i8", "<u8", "|i1", "|u1", "|b1", "|O", "<U5", "|S3", "|S0"),
    *("|V12", "<M8[s]", "<m8[ns]", "f4", "O", "", "x", "<f5", "<U1000000000", [("a", "<f4")], [["a", "<f4"]], 4, None),
    *([("a", "|O"), ("b", "<f4", (3,))], "<f4,<f4", "(3,)f4", "<f4" * 1000),
)
SIZES = (0, 1, 2, 3, 21, 22, 24, 263, -1, 10**6, 4 * 10**8, 2**31, 2**63 - 1, 2**64, 10**30, 1.5, True, "3", None)
FLOATS = (np.nan, np.inf, -np.inf, 3e38, -3e38, 1e-40, 0.0, 1e6, -1.0, 1e20)
LONG = b"9" * 5000
# Calls, strings longer than the file, recursive lists, and forty lists that each hold the previous one twice.
SNIPPETS = (
    *(b"(" * 5000, b"]" * 5000, b"}" * 300, b"2" * 3000, b"0", b"00000", b"N", b"(]", b"K\xff", b"\x93", b"P1\n", b"Q"),
    *(b"X\xff\xff\xff\x7f", b"B\xff\xff\xff\xff", b"\x8e" + b"\xff" * 7 + b"\x7f", b"\x8a\xff" + b"\xff" * 255),
    *(b"cos\nsystem\n", b"c__builtin__\neval\n", b"cnumpy\ndtype\n", b"R", b"b", b"s", b"u", b"e", b"t", b"\x85"),
    *(b"]qch\x63a", b"]qd(hdhde", b"]q\x64" + b"".join(b"]q%c(h%ch%ce" % (n + 1, n, n) for n in range(100, 140))),
    *(b"(K\x01K\x02d", b"h\xff", b"j\xff\xff\xff\x7f", b"I" + LONG + b"\n", b"L" + LONG + b"L\n", b"Fnan\n"),
    *(b"S'\\x'\n", b"V\\ud800\n", b"C\x05", b"\x95" + b"\xff" * 8),
)


def mutate_npy(rng: Random, content: bytes) -> bytes:
    """A .npy file after one mutation, mostly of its header, with consistent or inconsistent data."""
    if not content.startswith(NPY) or len(content) < 12 or rng.random() < 0.2:
        return mutate_bytes(rng, content)
    wide = content[6] >= 2
    start = 12 if wide else 10
    (length,) = struct.unpack("<I" if wide else "<H", content[8:start])
    text, data = content[start : start + length], content[start + length :]
    try:
        header = ast.literal_eval(text.decode("latin-1"))
        shape, kind = header["shape"], header["descr"]
    except (ValueError, SyntaxError, KeyError, TypeError, RecursionError, MemoryError):
        return mutate_bytes(rng, content)
    fate = rng.randrange(8)
    if fate == 0:
        header["descr"] = rng.choice(TYPES)
    elif fate <= 2 and isinstance(shape, tuple):
        header["shape"] = _wild_shape(rng, shape)
    elif fate == 3:
        header["fortran_order"] = rng.choice((True, 1, None, "yes"))
    elif fate == 4:
        return NPY + content[6:8] + _packed(mutate_text(rng, text), wide) + data
    elif fate == 5:
        version = rng.choice((b"\x01\x00", b"\x02\x00", b"\x03\x00", b"\x04\x00", b"\x00\x00", b"\xff\xff"))
        return NPY + version + _packed(text, version[0] in (2, 3)) + data
    elif fate == 6:
        header.pop(rng.choice(list(header)))
        header |= {"x": 1} if rng.random() < 0.3 else {}
    else:
        return content[: start + length] + _wild_data(rng, data, kind)
    return (
        NPY + content[6:8] + _packed(repr(header).encode("latin-1", "replace").ljust(length - 1) + b"\n", wide) + data
    )


def _packed(text: bytes, wide: bool) -> bytes:
    return struct.pack("<I", len(text)) + text if wide else struct.pack("<H", min(len(text), 65_535)) + text


def _wild_shape(rng: Random, shape: tuple[object, ...]) -> object:
    sizes = list(shape)
    fate = rng.randrange(6)
    if fate <= 2 and sizes:
        sizes[rng.randrange(len(sizes))] = rng.choice(SIZES)
    elif fate == 3:
        sizes.insert(rng.randint(0, len(sizes)), rng.choice((0, 1, 1, 2)))
    elif fate == 4:
        return rng.choice(((), (0,), (2**62, 4, 0), tuple(reversed(shape)), (1,) * 70, [3, 4], 5, None))
    elif sizes:
        sizes.pop(rng.randrange(len(sizes)))
    return tuple(sizes)


def _wild_data(rng: Random, data: bytes, kind: object) -> bytes:
    try:
        dtype = np.dtype(kind)  # type: ignore[call-overload]
    except (TypeError, ValueError):
        return mutate_bytes(rng, data)
    if dtype.kind not in "fiu" or len(data) < dtype.itemsize:
        return mutate_bytes(rng, data)
    values = np.frombuffer(data[: len(data) // dtype.itemsize * dtype.itemsize], dtype).copy()
    place = rng.randrange(len(values))
    stop = place + rng.choice((1, 1, 3, 66, len(values)))
    with np.errstate(all="ignore"):
        if dtype.kind == "f":
            values[place:stop] = np.array(rng.choice(FLOATS)).astype(dtype)
        else:
            values[place:stop] = rng.choice((0, 1, np.iinfo(dtype).max, np.iinfo(dtype).min))
    return values.tobytes()


def mutate_pickle(rng: Random, content: bytes) -> bytes:
    """A pickle, alone or in a .npy file, after one mutation of its opcodes."""
    start = content.find(b"\x80", 10) if content.startswith(NPY) else 0
    if start < 0 or rng.random() < 0.25:
        return mutate_bytes(rng, content)
    head, body = content[:start], content[start:]
    places: list[int] = []
    # pickletools warns of odd escapes in the strings of an input.
    with suppress(ValueError, IndexError, OverflowError), warnings.catch_warnings(action="ignore"):
        places.extend(position for _, _, position in pickletools.genops(body) if position is not None)
    if len(places) < 3:
        return mutate_bytes(rng, content)
    place = rng.randrange(len(places) - 1)
    begin, end = places[place], places[place + 1]
    fate = rng.randrange(4)
    if fate == 0:
        body = body[:begin] + body[end:]
    elif fate == 1:
        body = body[:begin] + body[begin:end] * rng.choice((2, 3, 200)) + body[end:]
    elif fate == 2:
        body = body[:begin] + rng.choice(SNIPPETS) + body[rng.choice((begin, end)) :]
    else:
        other = rng.randrange(len(places) - 1)
        body = body[:begin] + body[places[other] : places[other + 1]] + body[end:]
    return head + body
