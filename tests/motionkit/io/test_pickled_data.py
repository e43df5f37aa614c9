"""Pickles of plain data are read as they were written; nothing else in them is called."""

import os
import pickle
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motionkit.core.errors import FormatError
from motionkit.io.npy import object_content
from motionkit.io.pickled_data import PickleError, parse_pickle, read_pickled_dict

MOTION = np.random.default_rng(0).normal(size=(4, 22, 3, 7)).astype(np.float32)
RESULTS = {
    "motion": MOTION,
    "text": ["a person walks", "走る", "a person walks", ""],
    "lengths": np.array([7, 5, 7, 3]),
    "num_samples": 2,
    "num_repetitions": np.int64(2),
    "scale": 2.5,
    "names": np.array(["ab", "c"]),
    "objects": np.array(["x", 1, None], dtype=object),
    "nothing": None,
    "column": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "big": np.arange(3, dtype=">i4"),
    "flags": np.array([True, False]),
}


def read_saved(path: Path) -> dict[str, object]:
    content = object_content(path.read_bytes())
    assert content is not None
    return read_pickled_dict(path, content)


@pytest.mark.parametrize("protocol", [2, 3, 4])
def test_a_pickled_dictionary_is_what_it_was(protocol: int) -> None:
    found = parse_pickle(pickle.dumps(RESULTS, protocol))
    assert found.keys() == RESULTS.keys()
    for key, value in RESULTS.items():
        np.testing.assert_array_equal(found[key], value)
        assert np.asarray(found[key]).dtype == np.asarray(value).dtype.newbyteorder("=")


def test_names_of_numpy_1_are_known() -> None:
    content = pickle.dumps({"motion": MOTION}, 2).replace(b"numpy._core.", b"numpy.core.")
    np.testing.assert_array_equal(parse_pickle(content)["motion"], MOTION)


def test_a_file_that_numpy_saved(tmp_path: Path) -> None:
    path = tmp_path / "results.npy"
    np.save(path, RESULTS)  # type: ignore[arg-type]
    np.testing.assert_array_equal(read_saved(path)["motion"], MOTION)
    np.save(tmp_path / "plain.npy", MOTION)
    assert object_content((tmp_path / "plain.npy").read_bytes()) is None


class Payload:
    def __init__(self, *call: object) -> None:
        self.call = call

    def __reduce__(self) -> tuple[object, ...]:
        return self.call[0], self.call[1:]


RUNS = "import pathlib; pathlib.Path('ran').touch()"
PAYLOADS = [
    Payload(exec, RUNS),
    Payload(eval, "1"),
    Payload(os.system, "touch ran"),
    Payload(getattr, "a", "upper"),
    Payload(np.load, "hostile.npy"),
    Payload(np.frombuffer, b"a"),
    Path("a"),
    len,
    np.zeros(2, dtype=[("a", "f4")]),
]


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
@pytest.mark.parametrize("payload", PAYLOADS, ids=range(len(PAYLOADS)))
def test_whatever_else_is_named_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, payload: object, protocol: int
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(PickleError):
        parse_pickle(pickle.dumps({"motion": [payload]}, protocol))
    assert not Path("ran").exists()


def test_the_refusal_names_the_file_and_the_call(tmp_path: Path) -> None:
    path = tmp_path / "hostile.npy"
    np.save(path, {"motion": MOTION, "text": [PAYLOADS[0]]})  # type: ignore[arg-type]
    with pytest.raises(FormatError, match=r"hostile.npy: .*'builtins.exec', which would be code to run"):
        read_saved(path)


def test_other_objects_than_dictionaries_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "list.npy"
    np.save(path, np.array(["a", "b"], dtype=object))
    with pytest.raises(FormatError, match="no dictionary of named arrays"):
        read_saved(path)


ARRAY = b"cnumpy._core.multiarray\n_reconstruct\n)R"
OBJECTS = b"cnumpy\ndtype\n(X\x02\x00\x00\x00O8tR"


@pytest.mark.parametrize(
    "opcodes",
    [
        # An array of objects with addresses for a list; and one with a list that is too short.
        ARRAY + b"(K\x01(K\x01t" + OBJECTS + b"\x89C\x08ADDRESSEtb.",
        ARRAY + b"(K\x01(K\x02t" + OBJECTS + b"\x89]K\x01atb.",
        # Objects' own flags withdrawn from their type, so that numpy would believe the addresses.
        ARRAY
        + b"(K\x01(K\x01t"
        + OBJECTS
        + b"(K\x03X\x01\x00\x00\x00|NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89C\x08ADDRESSEtb.",
        # A shape that its bytes do not fill, or of negative sizes whose product fits.
        ARRAY + b"(K\x01(J\xff\xff\xff\x7ft" + OBJECTS.replace(b"O8", b"f8") + b"\x89C\x08ADDRESSEtb.",
        ARRAY + b"(K\x01(J\xff\xff\xff\xffJ\xff\xff\xff\xfft" + OBJECTS.replace(b"O8", b"f8") + b"\x89C\x08ADDRESSEtb.",
        # The state of a function.
        b"c_codecs\nencode\n}X\x01\x00\x00\x00aK\x01sb.",
        # Lengths that are not there: of a bytearray, of bytes, of a text; and a far place in the memo.
        b"\x96" + struct.pack("<Q", 2**40) + b"a.",
        b"\x8e" + struct.pack("<Q", 2**40) + b"a.",
        b"X" + struct.pack("<I", 2**31) + b"a.",
        b"N" + b"r" + struct.pack("<I", 2**32 - 1),
    ],
)
def test_what_numpy_or_pickle_would_trust(opcodes: bytes) -> None:
    tracemalloc.start()
    with pytest.raises(PickleError):
        parse_pickle(b"\x80\x04" + opcodes)
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


def test_shared_lists_are_never_written_out() -> None:
    # Each pair holds the one before it twice: written out, the last has 2^40 leaves.
    pairs = b"]\x94" + b"".join(b"h" + bytes((level,)) + b"h" + bytes((level,)) + b"\x86\x94" for level in range(41))
    for opcodes in (
        b"\x8c\x04name\x93",  # STACK_GLOBAL: the name of a module
        b"\x8c\x05numpy\x8c\x05dtype\x93h\x29\x85R",  # a type's code
        b"\x8c\x07_codecs\x8c\x06encode\x93\x8c\x01ah\x29\x86R",  # an encoding
    ):
        with pytest.raises(PickleError):
            parse_pickle(b"\x80\x04" + pairs + opcodes + b".")


PLAIN_VALUES = st.lists(st.text() | st.integers(-(2**40), 2**40)) | st.dictionaries(
    st.text(), st.integers(0, 2**31) | st.text()
)


@given(value=PLAIN_VALUES, protocol=st.integers(2, pickle.HIGHEST_PROTOCOL))
def test_lists_and_dictionaries_of_words_are_read_whole(value: object, protocol: int) -> None:
    assert parse_pickle(pickle.dumps(value, protocol=protocol)) == value


CONTENT = pickle.dumps({key: RESULTS[key] for key in ("text", "lengths", "column", "num_repetitions")}, 4)


@given(st.data())
def test_damaged_pickles_are_refused_or_plain(data: st.DataObject) -> None:
    content = CONTENT
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(content)))
        stop = start + data.draw(st.sampled_from([0, 1, 2, 8]))
        content = content[:start] + data.draw(st.binary(max_size=6)) + content[stop:]
    try:
        found = parse_pickle(content)
    except PickleError:
        return
    assert found is None or isinstance(found, (dict, list, set, tuple, np.ndarray, str, bytes, int, float))
