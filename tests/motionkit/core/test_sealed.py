import json
import pickle
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motionkit.core.checksums import CHECKSUM, read_json, sealed, unsealed, write_json
from motionkit.core.errors import DamagedFileError

DOCUMENT = {"name": "nano", "steps": 1200, "rate": 1e-3, "parts": {"b": [1, None], "a": "ü"}, "done": True}
HINT = "train it again"

json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(st.text().filter(lambda name: name != CHECKSUM), json_values, max_size=4))
def test_what_is_sealed_is_read_again(document: dict[str, object]) -> None:
    assert unsealed(json.loads(json.dumps(sealed(document)))) == document


def test_keys_that_are_numbers_are_sealed_as_a_reader_sees_them() -> None:
    document = {"counts": {2: "a", 10: "b"}}
    assert unsealed(json.loads(json.dumps(sealed(document)))) == {"counts": {"2": "a", "10": "b"}}


def test_every_flipped_bit_is_noticed_or_changes_no_value(tmp_path: Path) -> None:
    path = tmp_path / "config.json"
    write_json(path, DOCUMENT)
    whole = path.read_bytes()
    noticed = 0
    for place in range(len(whole)):
        for bit in range(8):
            damaged = bytearray(whole)
            damaged[place] ^= 1 << bit
            path.write_bytes(damaged)
            try:
                assert read_json(path, HINT) == DOCUMENT
            except DamagedFileError:
                noticed += 1
    assert noticed > 7 * len(whole)


def test_a_damaged_file_is_named_with_what_mends_it(tmp_path: Path) -> None:
    path = tmp_path / "config.json"
    write_json(path, DOCUMENT)
    path.write_text(path.read_text().replace("1200", "1201"))
    with pytest.raises(DamagedFileError, match=r"config\.json is damaged \(its content .*\): train it again"):
        read_json(path, HINT)


@pytest.mark.parametrize("text", ["[1]", "{", '{"a": NaN}', '{"a": 1e999}', "\udc80", '{"a": ' + "[" * 100_000])
def test_what_is_no_whole_json_object_is_damaged(tmp_path: Path, text: str) -> None:
    path = tmp_path / "config.json"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(DamagedFileError, match="train it again"):
        read_json(path, HINT)


def test_a_file_of_before_there_were_checksums_is_read(tmp_path: Path) -> None:
    path = tmp_path / "config.json"
    path.write_text(json.dumps(DOCUMENT))
    assert read_json(path, HINT) == DOCUMENT


def test_numbers_that_are_not_finite_are_refused() -> None:
    with pytest.raises(ValueError, match="JSON compliant"):
        sealed({"loss": float("nan")})


def test_the_error_travels_between_processes() -> None:
    error = DamagedFileError("a.json", "it is empty", HINT)
    assert str(pickle.loads(pickle.dumps(error))) == str(error)  # noqa: S301
