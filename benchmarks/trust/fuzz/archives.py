"""Mutations of zip archives: damaged, lost or renamed members, wrong directories, and bombs."""

import io
import struct
import zipfile
import zlib
from collections.abc import Callable
from functools import cache
from random import Random

from benchmarks.trust.fuzz.arrays import NPY
from benchmarks.trust.fuzz.binary import mutate_bytes

Accident = Callable[[Random, bytes], bytes]
ZIP = b"PK\x03\x04"
NAMES = ("../up.npy", "/absolute.npy", "x", "", "a/b.npy", "fps.npy", "poses.npy", "x" * 300, "\x1b[31m.npy")
# Longer members are bombs, and are not unpacked.
MOST_MEMBER_BYTES = 8 << 20
BOMB_BLOCKS = 1280
BOMB_SHAPES = ("(5084252, 22, 3)", "(335544320,)", "()")


def mutate_zip(rng: Random, content: bytes, accident_of: Callable[[str, bytes], Accident]) -> bytes:
    """An archive after a mutation of a member, with a valid checksum, or of the archive itself."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {
                info.filename: archive.read(info) for info in archive.infolist() if info.file_size < MOST_MEMBER_BYTES
            }
    except (zipfile.BadZipFile, zlib.error, OSError, ValueError, RuntimeError, NotImplementedError, EOFError):
        return mutate_bytes(rng, content)
    if not members or rng.random() < 0.15:
        return mutate_bytes(rng, content)
    victim = rng.choice(sorted(members))
    fate = rng.randrange(12)
    if fate < 6:
        members[victim] = accident_of(victim, members[victim])(rng, members[victim])
    elif fate == 6:
        del members[victim]
    elif fate == 7:
        members[rng.choice(NAMES)] = members.pop(victim)
    elif fate == 8:
        members[victim] = members[rng.choice(sorted(members))]
    elif fate == 9:
        return _with_bomb(members, victim, rng.choice(BOMB_SHAPES))
    elif fate == 10:
        members[rng.choice(NAMES)] = content
    if fate == 11:
        return _lying(rng, members, victim)
    return zipped(members, zipfile.ZIP_DEFLATED if rng.random() < 0.3 else zipfile.ZIP_STORED)


def zipped(members: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> bytes:
    """An archive of these members."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, member in members.items():
            archive.writestr(zipfile.ZipInfo(name), member, method, 1)
    return file.getvalue()


def _lying(rng: Random, members: dict[str, bytes], victim: str) -> bytes:
    """An archive whose directory states other sizes, another method or flag than a member has."""
    content = bytearray(zipped(members))
    offset = content.find(b"PK\x01\x02")
    while victim.encode() not in content[offset + 46 : offset + 46 + 300] and offset >= 0:
        following = content.find(b"PK\x01\x02", offset + 4)
        if following < 0:
            break
        offset = following
    field, size = rng.choice(((8, 2), (10, 2), (16, 4), (20, 4), (24, 4), (28, 2), (30, 2), (42, 4)))
    value = rng.choice((0, 1, 8, 99, 65_535, 2**31 - 1, 2**32 - 1)) & (256**size - 1)
    content[offset + field : offset + field + size] = value.to_bytes(size, "little")
    return bytes(content)


def _with_bomb(members: dict[str, bytes], victim: str, shape: str) -> bytes:
    """An archive of a megabyte of which one member unpacks to more than a gigabyte of zeros, as its header says."""
    rest = zipped({name: member for name, member in members.items() if name != victim})
    start = rest.find(b"PK\x01\x02") if len(members) > 1 else 0
    end = rest.find(b"PK\x05\x06")
    packed, checksum, size = _bomb(shape)
    name = victim.encode()
    facts = struct.pack("<HHHHIIIHH", 0, 8, 0, 33, checksum, len(packed), size, len(name), 0)
    local = b"PK\x03\x04" + struct.pack("<H", 20) + facts + name + packed
    entry = b"PK\x01\x02" + struct.pack("<HH", 20, 20) + facts + struct.pack("<HHHII", 0, 0, 0, 0, start) + name
    directory = (rest[start:end] if len(members) > 1 else b"") + entry
    closing = struct.pack("<HHHHIIH", 0, 0, len(members), len(members), len(directory), start + len(local), 0)
    return rest[:start] + local + directory + b"PK\x05\x06" + closing


def prepare_bombs() -> None:
    """Create the bombs once for all processes that are forked later."""
    for shape in BOMB_SHAPES:
        _bomb(shape)


@cache
def _bomb(shape: str) -> tuple[bytes, int, int]:
    """A packed member, its checksum, its size unpacked."""
    text = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    head = NPY + b"\x01\x00" + struct.pack("<H", len(text)) + text.encode()
    packer, block = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS), bytes(1 << 20)
    packed = packer.compress(head) + packer.flush(zlib.Z_FULL_FLUSH)
    # After a full flush a block is packed without regard to what came before: it can be repeated.
    packed += (packer.compress(block) + packer.flush(zlib.Z_FULL_FLUSH)) * BOMB_BLOCKS
    packed += packer.flush()
    checksum = zlib.crc32(head)
    for _ in range(BOMB_BLOCKS):
        checksum = zlib.crc32(block, checksum)
    return packed, checksum, len(head) + BOMB_BLOCKS * len(block)
