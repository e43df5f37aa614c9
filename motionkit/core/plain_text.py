"""Parsing of untrusted text: TOML, JSON, integers; and safe display of such text.

Python's own parsers raise several kinds of error (nesting too deep, numbers of thousands of digits) and return integers
that no array can hold. Here every fault is a `ValueError`.
"""

import json
import re
import reprlib
import tomllib
from collections.abc import Callable, Iterable
from typing import Any

# Numbers of more digits are beyond 64 bits.
MOST_DIGITS = 18
LONGEST_TOML = 1_000_000
SHOWN_LETTERS = 80
# C0 and C1 controls, direction marks and overrides, line separators, zero-width characters, lone surrogates.
UNSAFE_LETTERS = re.compile("[\x00-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028-\u202e\u2060-\u2069\ufeff\ud800-\udfff]")


def whole_number(text: str) -> int | None:
    """The integer of 1 to 18 decimal digits; None for any other text, including signs."""
    return int(text) if text.isdecimal() and len(text) <= MOST_DIGITS else None


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML; raises `ValueError` for anything else, also if it is nested too deep."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("nested too deep") from None


def parse_json(text: str, object_pairs_hook: Callable[[list[tuple[str, Any]]], Any] | None = None) -> Any:
    """Parse JSON, with integers beyond 64 bits as floats; the hook is that of `json.loads`.

    Raises `json.JSONDecodeError` with the position, or another `ValueError`: nested too deep, or a lone surrogate.
    """
    try:
        value = json.loads(text, parse_int=_bounded, object_pairs_hook=object_pairs_hook)
        if "\\ud" in text or "\\uD" in text:
            json.dumps(value, ensure_ascii=False).encode("utf-8")
    except RecursionError:
        raise ValueError("nested too deep") from None
    except UnicodeEncodeError as error:
        raise ValueError(f"{error.object[error.start]!r} is half a character") from None
    return value


def shown(value: object, limit: int = SHOWN_LETTERS) -> str:
    """A value for a message: its `repr`, cut to `limit` letters and some items."""
    short = reprlib.Repr()
    short.maxstring = short.maxlong = short.maxother = limit
    try:
        text = short.repr(value)
    except ValueError:
        text = "a number of thousands of digits"
    return text if len(text) <= limit else f"{text[:limit]}…"


def suggestion(word: str, known: Iterable[str]) -> str:
    """` (did you mean fps?)` if a word is close to a known one, or begins with one; else empty."""
    import difflib

    plain, words = word.strip().casefold(), sorted(known)
    begun = [each for each in words if each == plain or (len(each) > 2 and plain.startswith(each))]
    near = begun or difflib.get_close_matches(plain, words, 1)
    return f" (did you mean {near[0]}?)" if near else ""


def printable(text: str) -> str:
    """A text as one line that is safe on a terminal: control characters as escapes (`\\x1b`, `\\n`).

    Also direction marks, and bytes of a file name that are not UTF-8.
    """
    return UNSAFE_LETTERS.sub(lambda found: found[0].encode("unicode_escape", "surrogatepass").decode("ascii"), text)


def markdown_text(text: str) -> str:
    """A text as one line of Markdown that shows it as it is: characters with a meaning there are escaped."""
    return re.sub(r"[\\`*_\[\]<>|~&!$]", r"\\\g<0>", printable(text))


def spreadsheet_text(text: str) -> str:
    """A text for a cell of a CSV file: an apostrophe goes before what a spreadsheet would run as a formula."""
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t", "\r")) else text


def shortened(text: str, limit: int) -> str:
    """A text of at most about `limit` characters, shortened in the middle, since the end has the advice."""
    if len(text) <= limit:
        return text
    return f"{text[: limit // 2]} … ({len(text) - limit:,} letters left out) … {text[-(limit - limit // 2) :]}"


def _bounded(digits: str) -> int | float:
    return int(digits) if len(digits) <= MOST_DIGITS else float(digits)
