"""Pickled dictionaries of arrays are put together from their opcodes; nothing in them runs."""

import io
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motionkit.core.errors import FormatError
from motionkit.io.arrays.pickled_data import PickleError, is_pickled, parse_pickle, read_pickled_dict

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


def same(found: object, expected: object) -> None:
    if isinstance(expected, np.ndarray) and expected.dtype == object:
        assert found == expected.tolist()
    elif isinstance(expected, np.ndarray):
        assert isinstance(found, np.ndarray)
        np.testing.assert_array_equal(found, expected)
    else:
        assert found == expected


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_a_pickled_dictionary_is_what_it_was(protocol: int) -> None:
    found = parse_pickle(io.BytesIO(pickle.dumps(RESULTS, protocol)))
    assert found.keys() == RESULTS.keys()
    for key, value in RESULTS.items():
        same(found[key], value)


def test_a_file_that_numpy_saved(tmp_path: Path) -> None:
    path = tmp_path / "results.npy"
    np.save(path, RESULTS)  # type: ignore[arg-type]
    assert is_pickled(path)
    found = read_pickled_dict(path)
    np.testing.assert_array_equal(found["motion"], MOTION)
    np.save(tmp_path / "plain.npy", MOTION)
    assert not is_pickled(tmp_path / "plain.npy")


class Payload:
    def __reduce__(self) -> tuple[object, ...]:
        return exec, ("import pathlib; pathlib.Path('ran').touch()",)


def test_code_is_named_and_never_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for protocol in (0, 1, 2, 3, 4, 5):
        with pytest.raises(PickleError):
            parse_pickle(io.BytesIO(pickle.dumps({"motion": Payload()}, protocol)))
    np.save("hostile.npy", {"motion": MOTION, "text": [Payload()]})  # type: ignore[arg-type]
    with pytest.raises(FormatError, match=r"hostile.npy: .*'builtins.exec', which would be code to run"):
        read_pickled_dict(Path("hostile.npy"))
    for value in (Path("a"), {1, 2}, np.zeros(2, dtype=[("a", "f4")]), len, np.ndarray):
        with pytest.raises(PickleError):
            parse_pickle(io.BytesIO(pickle.dumps({"value": value}, 4)))
    assert not Path("ran").exists()


def test_other_objects_than_dictionaries_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "list.npy"
    np.save(path, np.array(["a", "b"], dtype=object))
    with pytest.raises(FormatError, match="no dictionary of named arrays"):
        read_pickled_dict(path)


def test_shared_and_nested_lists_do_not_explode() -> None:
    bomb: list[object] = ["x"] * 10
    for _ in range(7):
        bomb = [bomb] * 10
    found = parse_pickle(io.BytesIO(pickle.dumps(bomb, 4)))
    assert found[0] is found[9]
    endless: list[object] = []
    endless.append(endless)
    with pytest.raises(PickleError, match="nested"):
        parse_pickle(io.BytesIO(pickle.dumps(endless, 4)))


@pytest.mark.parametrize(
    "opcodes",
    [
        b"\x8c\x04name\x93",  # STACK_GLOBAL: the name of a module
        b"\x8c\x05numpy\x8c\x05dtype\x93h\x29\x85R",  # a type's code
        b"\x8c\x07_codecs\x8c\x06encode\x93\x8c\x01ah\x29\x86R",  # an encoding
    ],
)
def test_shared_lists_are_never_written_out(opcodes: bytes) -> None:
    # Each pair holds the one before it twice: written out, the last has 2^40 leaves.
    pairs = b"]\x94" + b"".join(b"h" + bytes((level,)) + b"h" + bytes((level,)) + b"\x86\x94" for level in range(41))
    with pytest.raises(PickleError, match="a tuple where a text belongs"):
        parse_pickle(io.BytesIO(b"\x80\x04" + pairs + opcodes + b"."))


PLAIN_VALUES = st.lists(st.text() | st.integers(-(2**40), 2**40)) | st.dictionaries(
    st.text(), st.integers(0, 2**31) | st.text()
)


@given(value=PLAIN_VALUES, protocol=st.integers(2, pickle.HIGHEST_PROTOCOL))
def test_lists_and_dictionaries_of_words_are_read_whole(value: object, protocol: int) -> None:
    assert parse_pickle(io.BytesIO(pickle.dumps(value, protocol=protocol))) == value


CONTENT = pickle.dumps({key: RESULTS[key] for key in ("text", "lengths", "column", "num_repetitions")}, 4)


@given(st.data())
def test_damaged_pickles_are_refused_or_plain(data: st.DataObject) -> None:
    content = CONTENT
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(content)))
        stop = start + data.draw(st.sampled_from([0, 1, 2, 8]))
        content = content[:start] + data.draw(st.binary(max_size=6)) + content[stop:]
    try:
        found = parse_pickle(io.BytesIO(content))
    except PickleError:
        return
    assert found is None or isinstance(found, (dict, list, np.ndarray, str, bytes, int, float))
