"""Whitespace-separated tables of numbers, fast where they are regular and exact about what is wrong where they aren't.

The fast way marks every line's end with a NaN, turns each separator into a newline and lets Arrow's CSV reader parse
one long column; a table is regular exactly when the NaNs fall where they should.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float64

from motionkit.errors import FormatError

SEPARATORS_TO_NEWLINES = bytes.maketrans(b" \t\r", b"\n\n\n")
LARGEST_VALUE = 1e9


def parse_column(separated: bytes) -> Float64[np.ndarray, "values"] | None:
    """Numbers of a text with one to a line (empty lines are skipped); None where something is not a number."""
    import pyarrow as pa
    from pyarrow import csv

    if not separated.strip():
        return np.empty(0)
    try:
        table = csv.read_csv(
            pa.py_buffer(separated),
            read_options=csv.ReadOptions(use_threads=False, column_names=["value"], block_size=len(separated) + 1),
            parse_options=csv.ParseOptions(delimiter=",", quote_char=False, ignore_empty_lines=True),
            convert_options=csv.ConvertOptions(column_types={"value": pa.float64()}, null_values=[]),
        )
    except pa.ArrowInvalid:
        return None
    return np.asarray(table.column(0).to_numpy(), dtype=np.float64)


def parse_table(
    text: bytes, *, num_rows: int, num_columns: int, path: Path, first_line: int
) -> Float64[np.ndarray, "rows columns"]:
    """The numbers of `num_rows` lines with `num_columns` numbers each; empty lines are skipped.

    `first_line` is the 1-based line of the file where `text` begins. Raises `FormatError` (`truncated`,
    `channel-count`, `frame-count`, `not-a-number`, `nan`, `range`) naming the line and the frame.
    """
    smallest = 2 * num_rows * num_columns - 1
    if smallest > len(text):
        raise FormatError(
            f"{num_rows} frames of {num_columns} channels are declared, which takes at least {smallest} bytes, but the "
            f"file has {len(text)} left; the file was cut off or its header is wrong",
            path=path,
            reason="truncated",
            line=first_line,
        )
    marked = text.strip().replace(b"\n", b" nan ").translate(SEPARATORS_TO_NEWLINES) + b"\nnan\n"
    values = parse_column(marked)
    if values is not None and values.size == num_rows * (num_columns + 1):
        table = values.reshape(num_rows, num_columns + 1)
        finite = np.isfinite(table)
        if finite[:, :-1].all() and not finite[:, -1].any() and np.abs(table[:, :-1]).max(initial=0.0) < LARGEST_VALUE:
            return table[:, :-1]
    return _parse_slowly(text, num_rows, num_columns, path, first_line)


def format_table(table: Float64[np.ndarray, "rows columns"]) -> bytes:
    """One line of numbers a row, separated by spaces, each with as many digits as it needs."""
    import pyarrow as pa
    from pyarrow import csv

    columns = pa.table({str(column): values for column, values in enumerate(np.ascontiguousarray(table.T))})
    buffer = pa.BufferOutputStream()
    csv.write_csv(columns, buffer, csv.WriteOptions(include_header=False, delimiter=" ", quoting_style="none"))
    return bytes(buffer.getvalue().to_pybytes())


def _parse_slowly(
    text: bytes, num_rows: int, num_columns: int, path: Path, first_line: int
) -> Float64[np.ndarray, "rows columns"]:
    rows: list[list[float]] = []
    line_number = first_line
    for line_number, line in enumerate(text.splitlines(), start=first_line):
        words = line.split()
        if not words:
            continue
        frame = len(rows)
        if frame == num_rows:
            raise FormatError(
                f"a line of numbers after the {num_rows} declared frames; expected the end of the file",
                path=path,
                reason="frame-count",
                line=line_number,
            )
        if len(words) != num_columns:
            raise FormatError(
                f"{len(words)} numbers, expected {num_columns} (one for each channel)",
                path=path,
                reason="channel-count",
                line=line_number,
                frame=frame,
            )
        rows.append([parse_number(word, path, line_number, frame) for word in words])
    if len(rows) < num_rows:
        raise FormatError(
            f"the file ends after {len(rows)} frames, expected {num_rows}",
            path=path,
            reason="truncated",
            line=line_number,
            frame=len(rows),
        )
    return np.array(rows, dtype=np.float64).reshape(num_rows, num_columns)


def parse_number(word: bytes | str, path: Path, line: int, frame: int | None = None) -> float:
    """One finite number of a sane size; raises `FormatError` (`not-a-number`, `nan`, `range`) naming the place."""
    shown = word.decode("utf-8", "backslashreplace") if isinstance(word, bytes) else word
    try:
        if "_" in shown:
            raise ValueError
        value = float(shown)
    except ValueError:
        raise FormatError(
            f"{shown[:40]!r} where a number was expected", path=path, reason="not-a-number", line=line, frame=frame
        ) from None
    if not np.isfinite(value):
        raise FormatError(
            f"{shown} where a finite number was expected", path=path, reason="nan", line=line, frame=frame
        )
    if abs(value) >= LARGEST_VALUE:
        raise FormatError(
            f"{value:g} is beyond ±{LARGEST_VALUE:g}; no channel of a body is",
            path=path,
            reason="range",
            line=line,
            frame=frame,
        )
    return value
