"""Numpy files: plain data is read as it was written; damaged and hostile files are refused with a reason."""

import io
import os
import pickle
import struct
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from motionkit.io import npy
from tests.helpers.refusal import refusal

POSES = np.random.default_rng(0).normal(size=(4, 22, 3)).astype(np.float32)
PATH = Path("a.npy")


def saved(array: object) -> bytes:
    file = io.BytesIO()
    np.save(file, array)  # type: ignore[arg-type]
    return file.getvalue()


def with_header(shape: str, content: bytes = b"", descr: str = "<f4") -> bytes:
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}}}".encode().ljust(501) + b"\n"
    return npy.MAGIC + b"\x01\x00" + len(header).to_bytes(2, "little") + header + content


NAN, FAR = POSES.copy(), POSES.copy()
NAN[3, 2, 1], FAR[2] = np.nan, 1e20
BAD_ARRAYS = [
    (b"HIERARCHY\n", "not-what-it-says", None),
    (saved(POSES)[:40], "truncated", None),
    (saved(POSES) + b"more", "truncated", None),
    (with_header("(9999999999, 22, 3)"), "truncated", None),
    (with_header("(-1, -2)", bytes(8)), "truncated", None),
    (with_header(f"({'1, ' * 70})", bytes(4)), "truncated", None),
    (with_header("(1000000000000,)", descr="<U0"), "not-a-number", None),
    (saved(POSES.astype(complex)), "not-a-number", None),
    (saved(POSES.astype(object)), "object-array", None),
    (saved(POSES[..., :2]), "channel-count", None),
    (saved(POSES[:0]), "no-frames", None),
    (saved(NAN), "nan", 3),
    (saved(FAR), "range", 2),
]


@pytest.mark.parametrize(("content", "reason", "frame"), BAD_ARRAYS)
def test_arrays_that_are_refused(content: bytes, reason: str, frame: int | None) -> None:
    error = refusal(npy.read_npy, PATH, content, (None, None, 3))
    assert (error.path, error.reason, error.frame) == (PATH, reason, frame)


def archive_of(members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as zipped:
        for name, content in members.items():
            zipped.writestr(f"{name}.npy", content)
    return file.getvalue()


def opened(data: bytes) -> npy.Archive:
    return npy.open_archive(Path("a.npz"), data)


WHOLE = archive_of({"poses": saved(POSES)})


def changed(data: bytes, *flips: tuple[int, int]) -> bytes:
    found = bytearray(data)
    for place, bits in flips:
        found[place] |= bits
    return bytes(found)


@pytest.mark.parametrize(
    ("data", "key", "reason"),
    [
        (b"\x93NUMPY" + WHOLE, "poses", "not-what-it-says"),
        (WHOLE[:-30], "poses", "truncated"),
        (archive_of({"poses": saved(POSES)}, zipfile.ZIP_STORED).replace(b"NUMPY", b"NUMPZ"), "poses", "truncated"),
        (WHOLE, "trans", "missing-key"),
        (WHOLE.replace(b"poses.npy", b"../po.npy"), "poses", "missing-key"),
        (archive_of({"poses": saved(np.zeros(15_600_000))}), "poses", "too-large"),
        (archive_of({"poses": saved(POSES)}, zipfile.ZIP_BZIP2), "poses", "unreadable"),
        (changed(WHOLE, (WHOLE.index(b"PK\x01\x02") + 8, 1), (6, 1)), "poses", "truncated"),  # encrypted
    ],
    ids=range(8),
)
def test_archives_that_are_refused_before_much_is_unpacked(data: bytes, key: str, reason: str) -> None:
    tracemalloc.start()
    try:
        assert refusal(lambda: opened(data).numbers(key, (None, None, 3))).reason == reason
        assert tracemalloc.get_traced_memory()[1] < 2**24
    finally:
        tracemalloc.stop()


RESULTS = {
    "motion": POSES,
    "text": ["a person walks", "走る", ""],
    "num_samples": 2,
    "num_repetitions": np.int64(2),
    "objects": np.array(["x", 1, None], dtype=object),
    "column": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "flags": np.array([True, False]),
}


@pytest.mark.parametrize("protocol", [2, 3, 4])
def test_a_pickled_dictionary_is_what_it_was(protocol: int) -> None:
    content = pickle.dumps(RESULTS, protocol)
    for written in (content, content.replace(b"numpy._core.", b"numpy.core.")) if protocol < 4 else (content,):
        found = npy.parse_pickle(written)
        assert found.keys() == RESULTS.keys()
        for key, value in RESULTS.items():
            np.testing.assert_array_equal(found[key], value)
            assert np.asarray(found[key]).dtype == np.asarray(value).dtype.newbyteorder("=")


def test_a_file_is_its_array_its_object_or_its_one_value() -> None:
    np.testing.assert_array_equal(npy.read_object(PATH, saved(RESULTS))["motion"], POSES)
    np.testing.assert_array_equal(npy.read_object(PATH, saved(POSES)), POSES)
    for value in ("male", 120, 59.94):
        assert npy.read_object(PATH, saved(value)) == value
        for protocol in (2, 3, 4, 5):
            pickled = with_header("()", pickle.dumps(np.array(value, dtype=object), protocol), "|O")
            assert opened(archive_of({"gender": pickled})).scalar("gender") == value


class Payload:
    def __init__(self, *call: object) -> None:
        self.call = call

    def __reduce__(self) -> tuple[object, ...]:
        return self.call[0], self.call[1:]


RUNS = "import pathlib; pathlib.Path('ran').touch()"
PAYLOADS = [
    Payload(exec, RUNS),
    Payload(os.system, "touch ran"),
    Payload(getattr, "a", "upper"),
    Payload(np.load, "hostile.npy"),
    Payload(np.frombuffer, b"a"),
    Path("a"),
    len,
    np.zeros(2, dtype=[("a", "f4")]),
]


@pytest.mark.parametrize("protocol", [0, pickle.HIGHEST_PROTOCOL])
@pytest.mark.parametrize("payload", PAYLOADS, ids=range(len(PAYLOADS)))
def test_whatever_else_a_pickle_names_is_refused(tmp_path, monkeypatch, payload, protocol):
    monkeypatch.chdir(tmp_path)
    content = with_header("()", pickle.dumps({"motion": [payload]}, protocol), "|O")
    assert refusal(npy.read_object, PATH, content).reason == "pickle"
    assert opened(archive_of({"gender": content})).scalar("gender") is None
    assert not Path("ran").exists()


ARRAY = b"cnumpy._core.multiarray\n_reconstruct\n)R"
OBJECTS = b"cnumpy\ndtype\n(X\x02\x00\x00\x00O8tR"
FLOATS = OBJECTS.replace(b"O8", b"f8")
# Each pair holds the one before it twice: written out, the last has 2^40 leaves.
PAIRS = b"]\x94" + b"".join(b"h" + bytes((level,)) + b"h" + bytes((level,)) + b"\x86\x94" for level in range(41))


@pytest.mark.parametrize(
    "opcodes",
    [
        # An array of objects with addresses for a list.
        ARRAY + b"(K\x01(K\x01t" + OBJECTS + b"\x89C\x08ADDRESSEtb.",
        # Objects' own flags withdrawn from their type, so that numpy would believe the addresses.
        ARRAY
        + b"(K\x01(K\x01t"
        + OBJECTS
        + b"(K\x03X\x01\x00\x00\x00|NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89C\x08ADDRESSEtb.",
        # Negative sizes whose product fits.
        ARRAY + b"(K\x01(J\xff\xff\xff\xffJ\xff\xff\xff\xfft" + FLOATS + b"\x89C\x08ADDRESSEtb.",
        # A length that is not there, and a far place in the memo.
        b"\x8e" + struct.pack("<Q", 2**40) + b"a.",
        b"N" + b"r" + struct.pack("<I", 2**32 - 1),
        # In place of a module's name and a type's code.
        PAIRS + b"\x8c\x04name\x93.",
        PAIRS + b"\x8c\x05numpy\x8c\x05dtype\x93h\x29\x85R.",
    ],
    ids=range(7),
)
def test_what_numpy_or_pickle_would_trust(opcodes: bytes) -> None:
    tracemalloc.start()
    with pytest.raises(npy.PickleError):
        npy.parse_pickle(b"\x80\x04" + opcodes)
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()
