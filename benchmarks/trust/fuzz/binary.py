"""Mutations of arbitrary bytes: flips, losses, extreme values of machine words."""

import struct
from collections.abc import Callable
from random import Random

WILD_WORDS = tuple(
    struct.pack(order + code, value)
    for order in "<>"
    for code, values in (
        ("b", (-1, 0, 1, 127, -128)),
        ("h", (-1, 0, 1, 32767, -32768)),
        ("i", (-1, 0, 1, 2**31 - 1, -(2**31))),
        ("q", (-1, 0, 2**63 - 1, -(2**63), 2**40)),
        ("f", (float("nan"), float("inf"), -1.0, 0.0, 3e38, 1e-45)),
        ("d", (float("nan"), float("inf"), -1.0, 0.0, 1e308)),
    )
    for value in values
)


def mutate_bytes(rng: Random, content: bytes) -> bytes:
    """The bytes after one mutation."""
    return rng.choice(ACCIDENTS)(rng, content)


def place_in(rng: Random, content: bytes) -> int:
    """A position to mutate: headers, which matter most, and ends are as likely as the rest."""
    last = max(0, len(content) - 1)
    region = rng.randrange(4)
    if region == 0:
        return rng.randint(0, min(last, 64))
    if region == 1:
        return rng.randint(0, min(last, 1024))
    if region == 2:
        return rng.randint(max(0, last - 512), last)
    return rng.randint(0, last)


def _flip(rng: Random, content: bytes) -> bytes:
    if not content:
        return content
    changed = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 8))):
        changed[place_in(rng, content)] = rng.choice((0, 1, 127, 128, 255, rng.randrange(256)))
    return bytes(changed)


def _bit(rng: Random, content: bytes) -> bytes:
    if not content:
        return content
    changed = bytearray(content)
    changed[place_in(rng, content)] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _word(rng: Random, content: bytes) -> bytes:
    word, place = rng.choice(WILD_WORDS), place_in(rng, content)
    return content[:place] + word + content[place + len(word) :]


def _truncate(rng: Random, content: bytes) -> bytes:
    return content[: rng.choice((place_in(rng, content), rng.randint(0, len(content))))]


def _lose(rng: Random, content: bytes) -> bytes:
    place = place_in(rng, content)
    return content[:place] + content[place + rng.choice((1, 2, 4, 8, 64, 512)) :]


def _insert(rng: Random, content: bytes) -> bytes:
    place = place_in(rng, content)
    return content[:place] + rng.randbytes(rng.choice((1, 2, 4, 8, 64))) + content[place:]


def _zeros(rng: Random, content: bytes) -> bytes:
    place, count = place_in(rng, content), rng.choice((8, 64, 512, 4096))
    return content[:place] + bytes(min(count, len(content) - place)) + content[place + count :]


def _move(rng: Random, content: bytes) -> bytes:
    source, target, count = place_in(rng, content), place_in(rng, content), rng.choice((4, 16, 64, 512))
    piece = content[source : source + count]
    return content[:target] + piece + content[target + len(piece) :]


def _extend(rng: Random, content: bytes) -> bytes:
    return content + rng.choice((b"\0", bytes(512), content[-64:], content, rng.randbytes(16)))


ACCIDENTS: tuple[Callable[[Random, bytes], bytes], ...] = (
    *(_flip, _flip, _bit, _word, _word, _word, _truncate, _lose, _insert, _zeros, _move, _extend),
)
