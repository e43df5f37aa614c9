"""Requests of `motionkit generate`: prompts, motions per prompt, instants, joining.

Prompts are arguments or lines of a file, and keep their origin for messages.

A file of prompts has one motion per line:
- `.txt`: a text, nothing else;
- `.csv`: a header with `text` and/or `action`, and optionally `seconds`;
- `.jsonl`: an object with the same keys.
Empty lines are skipped. A line has a text or an action; without `seconds` its length is that of `--seconds`, or drawn.
"""

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

from motionkit.core.errors import UsageError, shown
from motionkit.core.files import parse_json
from motionkit.generate.constraints import Constraint
from motionkit.generate.long_motions import OVERLAP_SECONDS, Script
from motionkit.generate.models import GenerationRequest

COLUMNS = ("text", "action", "seconds")


@dataclass(frozen=True)
class Prompt:
    """A request and its origin, such as `prompts.csv, line 3`; empty for the command's arguments."""

    request: GenerationRequest
    where: str = ""


@dataclass(frozen=True)
class MotionsRequest:
    """`count` motions of each prompt, or with `join` of all prompts in sequence, under `constraints`.

    Poses are sampled at `times`, or at `fps` (None: the format's or the model's own). Pieces of joined motions overlap
    by `overlap_seconds`. Raises `UsageError` for instants outside a motion's duration, and for missing durations that
    are needed.
    """

    prompts: tuple[Prompt, ...]
    count: int = 1
    times: tuple[float, ...] = ()
    fps: Fraction | None = None
    join: bool = False
    overlap_seconds: float = OVERLAP_SECONDS
    constraints: tuple[Constraint, ...] = ()

    def __post_init__(self) -> None:
        for prompt in self.prompts if self.join else ():
            if prompt.request.duration_seconds is None:
                place = f"{prompt.where}: " if prompt.where else ""
                raise UsageError(f"{place}--join needs to know how long each text lasts: --seconds, or in --prompts")
        for prompts in self.scripts if self.times else ():
            lengths = [prompt.request.duration_seconds for prompt in prompts]
            length = None if None in lengths else sum(seconds for seconds in lengths if seconds is not None)
            place = f"{prompts[0].where}: " if len(prompts) == 1 and prompts[0].where else ""
            if length is None:
                raise UsageError(f"{place}--times needs --seconds: they are instants of a motion of a given length")
            outside = [instant for instant in self.times if not 0 <= instant <= length]
            if outside:
                raise UsageError(f"{place}--times: {outside[0]:g} s lies outside the motion's 0 … {length:g} s")

    @property
    def scripts(self) -> tuple[tuple[Prompt, ...], ...]:
        """The scripts: one prompt each, or all of them in sequence."""
        return (self.prompts,) if self.join else tuple((prompt,) for prompt in self.prompts)

    @cached_property
    def motions(self) -> list[Script]:
        """The script of each motion: motion i is of script i // count."""
        return [self.script_of(prompts) for prompts in self.scripts for _ in range(self.count)]

    def script_of(self, prompts: Sequence[Prompt]) -> Script:
        """The model's requests; constraints on a whole motion are attached to the first of its requests."""
        first, *others = (prompt.request for prompt in prompts)
        return (replace(first, constraints=self.constraints), *others)


def parse_times(times: str | None) -> tuple[float, ...]:
    """Parse `--times`, empty without it; raises `UsageError` unless it is a list of seconds."""
    if times is None:
        return ()
    try:
        return tuple(float(text) for text in times.split(","))
    except ValueError:
        raise UsageError(f"--times takes seconds separated by commas (0.5,1.25), not {times!r}") from None


def parse_prompts(
    file: Path | None, texts: Sequence[str], actions: Sequence[str], unconditional: bool, seconds: float | None
) -> list[Prompt]:
    """The prompts of a file, or one per text or action; raises `UsageError` unless exactly one kind is given."""
    if file is not None:
        if texts or actions or unconditional:
            raise UsageError("--prompts takes the place of texts, --action and --unconditional")
        return read_prompts(file, seconds)
    if sum((bool(texts), bool(actions), unconditional)) != 1:
        raise UsageError("give texts, or --action, or --unconditional, or --prompts: exactly one of them")
    if any(not text.strip() for text in (*texts, *actions)):
        raise UsageError("a text or action is empty; use --unconditional for motions without either")
    requests = [GenerationRequest(seconds, text=text) for text in texts]
    requests += [GenerationRequest(seconds, action=action) for action in actions]
    requests += [GenerationRequest(seconds)] if unconditional else []
    return [Prompt(request) for request in requests]


def read_prompts(path: Path, seconds: float | None = None) -> list[Prompt]:
    """Read a file of prompts; `seconds` is the length of those that state none (None: drawn).

    Raises `UsageError` with file and line for unreadable content, an unknown column, a line without a text or action
    or with both, seconds that are not positive, and a file without prompts.
    """
    suffix = path.suffix.lower()
    if suffix not in (".txt", ".csv", ".jsonl"):
        raise UsageError(f"{path}: prompts are a .txt (a text a line), a .csv or a .jsonl (text, action, seconds)")
    if suffix == ".csv":
        rows = list(read_csv(path))
    else:
        lines = [(number, line.strip()) for number, line in enumerate(read_text(path).splitlines(), start=1)]
        parse = _parse_object if suffix == ".jsonl" else lambda line, where: {"text": line}
        rows = [(number, parse(line, f"{path}, line {number}")) for number, line in lines if line]
    if not rows:
        raise UsageError(f"{path}: holds no prompts")
    wheres = [f"{path}, line {number}" for number, _ in rows]
    return [Prompt(_request(row, seconds, where), where) for (_, row), where in zip(rows, wheres, strict=True)]


def read_text(path: Path) -> str:
    """The text of a file in UTF-8, without a byte order mark; raises `UsageError`."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: not UTF-8 text ({error.reason} at byte {error.start})") from None


def read_csv(path: Path) -> Iterator[tuple[int, dict[str, str]]]:
    """The rows of a CSV with their line numbers; absent cells are empty.

    Raises `UsageError` with file and line for anything but a table, and for rows longer than the header.
    """
    reader = csv.DictReader(io.StringIO(read_text(path), newline=""), restkey="", restval="", strict=True)
    try:
        for row in reader:
            if "" in row:
                raise UsageError(f"{path}, line {reader.line_num}: more fields than the header names")
            yield reader.line_num, row
    except csv.Error as error:
        raise UsageError(f"{path}, line {reader.line_num}: not a CSV table ({error})") from None


def _parse_object(line: str, where: str) -> dict[str, Any]:
    try:
        row = parse_json(line)
    except ValueError as error:
        raise UsageError(f"{where}: not JSON ({error})") from None
    if not isinstance(row, dict):
        raise UsageError(f"{where}: expected an object with {', '.join(COLUMNS)}, not {type(row).__name__}")
    return row


def _request(row: Mapping[str, Any], default_seconds: float | None, where: str) -> GenerationRequest:
    unknown = [name for name in row if name not in COLUMNS]
    if unknown:
        raise UsageError(f"{where}: unknown column {shown(unknown[0])}, expected {', '.join(COLUMNS)}")
    text, action, seconds = (row.get(name) or "" for name in COLUMNS)
    if not isinstance(text, str) or not isinstance(action, str):
        raise UsageError(f"{where}: text and action are strings")
    if bool(text.strip()) == bool(action.strip()):
        raise UsageError(f"{where}: give a text or an action, {'not both' if text.strip() else 'there is neither'}")
    try:
        length = default_seconds if seconds in ("", None) else float(seconds)
    except (TypeError, ValueError):
        length = 0.0
    if isinstance(seconds, bool) or not (length is None or 0.0 < length < float("inf")):
        raise UsageError(f"{where}: seconds is a positive number, not {shown(seconds)}")
    return GenerationRequest(length, text.strip(), action.strip())
