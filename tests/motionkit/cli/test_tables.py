"""Tables fit the terminal that they are printed on, and lose nothing by it."""

import io

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motionkit.cli.console import LineConsole
from motionkit.cli.tables import print_table


def printed(width: int, columns: list[str], rows: list[tuple[str, list[str]]]) -> list[str]:
    file = io.StringIO()
    print_table(columns, rows, LineConsole(file=file, width=width))
    return [line.rstrip() for line in file.getvalue().splitlines()]


def test_five_framerates_stand_beside_each_other_in_80_columns() -> None:
    fps = [f"{rate} fps" for rate in (20, 40, 60, 100, 120)]
    name = "real, disjoint halves of the takes (P2)"
    lines = printed(80, fps, [(name, ["0.420 ± 0.306", "2.42 ± 1.52", "–", "16.8 ± 1.8", "1.72"])])
    assert max(map(len, lines)) <= 80
    assert {"20", "40", "60", "100", "120", "0.420", "±0.306", "–", "1.72"} <= set(" ".join(lines).split())
    assert lines.count("") == 1, "one piece"


@given(
    st.integers(60, 120),
    st.lists(st.tuples(st.floats(1e-7, 1e6), st.floats(1e-7, 1e3)), min_size=1, max_size=12),
)
def test_every_number_is_there_whole_and_no_line_is_too_long(width: int, numbers: list[tuple[float, float]]) -> None:
    texts = [f"{value:.3g} ± {half:.3g}" for value, half in numbers]
    columns = [f"column {at}" for at in range(len(texts))]
    lines = printed(width, columns, [("a system of a rather long name, planted", texts)])
    assert max(map(len, lines)) <= width
    words = " ".join(lines).split()
    for text in texts:
        value, _, half = text.partition(" ± ")
        assert value in words and f"±{half}" in words


@pytest.mark.parametrize("text", ["a\x1b[2Jb", "[bold]x"])
def test_names_are_shown_and_not_obeyed(text: str) -> None:
    lines = "\n".join(printed(80, [text], [(text, ["1"])]))
    assert "\x1b" not in lines and lines.count(text.replace("\x1b", r"\x1b")) == 2
