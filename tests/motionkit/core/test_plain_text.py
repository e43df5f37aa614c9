import json

import pytest

from motionkit.core.errors import shown
from motionkit.core.files import parse_json, parse_toml, whole_number

DIGITS = "9" * 5000


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("0", 0),
        ("007", 7),
        ("٣", 3),
        ("9" * 18, 10**18 - 1),
        ("9" * 19, None),
        (DIGITS, None),
        ("", None),
        ("-1", None),
    ],
)
def test_whole_numbers(text: str, number: int | None) -> None:
    assert whole_number(text) == number


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a = ", "Invalid value"),
        (f"a = {DIGITS}", "limit"),
        (f"a = {'[' * 3000}", "nested too deep"),
    ],
)
def test_every_fault_of_toml_is_a_value_error(text: str, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        parse_toml(text)
    assert parse_toml("a = [true, 1.5]") == {"a": [True, 1.5]}


@pytest.mark.parametrize(
    ("text", "says"),
    [("[" * 100_000, "nested too deep"), (r'["\ud800"]', "half a character"), (r'{"\uDfff": 1}', "half a character")],
)
def test_every_fault_of_json_is_a_value_error(text: str, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        parse_json(text)


def test_json_is_read_as_json_reads_it_but_for_huge_whole_numbers() -> None:
    text = r'{"a": [1, -2, 2.5, null, true, "\ud83d\ude00"], "b": {"c": 999999999999999999}}'
    assert parse_json(text) == json.loads(text)
    assert parse_json(f"[{DIGITS}, -{DIGITS}]") == [float("inf"), float("-inf")]
    with pytest.raises(json.JSONDecodeError):
        parse_json("[1")


def test_values_in_messages_are_cut() -> None:
    assert shown("a" * 20) == repr("a" * 20)
    assert shown("a" * 2000) == f"'{'a' * 37}...{'a' * 38}'"
    assert "digits" in shown(16**5000)  # Python 3.14 has words of its own
    nested: list[object] = ["a"]
    for _ in range(40):
        nested = [nested] * 40  # whole, it would be 40 ** 40 letters
    assert len(shown(nested)) <= 81
