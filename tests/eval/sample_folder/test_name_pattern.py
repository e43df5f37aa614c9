import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.sample_folder.manifest import ANY, DIGIT_FIELDS, FIELDS, parse_name_pattern

EXPRESSIONS = {field: r"\d+" if field in DIGIT_FIELDS else ".*?" if field == ANY else ".+?" for field in FIELDS}

patterns = st.lists(
    st.sampled_from([*(f"{{{field}}}" for field in FIELDS), "{any}", "_", "1", "a", "a_", "len"]), max_size=8
).filter(lambda parts: all(parts.count(f"{{{field}}}") < 2 for field in FIELDS if field != ANY))


@settings(max_examples=500)
@given(parts=patterns, name=st.text(alphabet="a1_2n", max_size=10))
def test_finds_what_a_regular_expression_finds(parts: list[str], name: str) -> None:
    expression = "".join(
        (EXPRESSIONS[part[1:-1]] if part == "{any}" else f"(?P<{part[1:-1]}>{EXPRESSIONS[part[1:-1]]})")
        if part.startswith("{")
        else re.escape(part)
        for part in parts
    )
    expected = re.fullmatch(expression, name)
    assert parse_name_pattern("".join(parts)).match(name) == (expected and expected.groupdict())


# Each of these took longer than anybody waits as a regular expression.
@pytest.mark.parametrize(
    ("text", "fits"),
    [
        ("{any}" * 40 + "zz", "azz"),
        ("{any}a" * 40 + "zz", "a" * 60 + "zz"),
        ("{group}{any}{caption}{any}{action}{any}{repeat}{num_frames}zz", "abc12zz"),
        ("{any}" * 199 + "zz", "zz"),
    ],
)
def test_hostile_patterns_come_to_an_end(text: str, fits: str) -> None:
    pattern = parse_name_pattern(text)
    assert pattern.match("a1" * 125) is None
    assert pattern.match(fits) is not None


def test_longer_patterns_are_refused() -> None:
    with pytest.raises(ValueError, match="expected at most 1,000"):
        parse_name_pattern("a" * 1001)
