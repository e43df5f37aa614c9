"""Requests of `motionkit generate`: prompts, motions per prompt, instants, joining, constraints.

A file of prompts has one motion per line: a `.txt` a text, a `.csv` the columns `text` and/or `action`, and optionally
`seconds`. Empty lines are skipped. A line has a text or an action; without `seconds` its length is that of `--seconds`,
or drawn. Prompts keep their origin for messages.

A path is a CSV with the columns `x` and `z` (metres), optionally `seconds` and `heading_degrees`. Without seconds it
is walked evenly over the whole motion. A pose is `SECONDS=FILE`, or `SECONDS=FILE@INSTANT` of a file of several
frames; a joint is `NAME@SECONDS=x,y,z` or `NAME@FROM-TO=x,y,z`.
"""

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path

import numpy as np

from motionkit.core.errors import MotionkitError, UsageError, shown
from motionkit.core.shapes import Float64
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import map_joints
from motionkit.generate.constraints import Constraint
from motionkit.generate.long_motions import Script
from motionkit.generate.models import GenerationRequest
from motionkit.io.files import read

PROMPT_COLUMNS = ("text", "action", "seconds")
PATH_COLUMNS = ("seconds", "x", "z", "heading_degrees")
_JOINT = re.compile(r"(?P<joint>[^@=]+)@(?P<start>[\d.]+)(-(?P<end>[\d.]+))?=(?P<place>.+)")


@dataclass(frozen=True)
class Prompt:
    """A request, and its origin as messages begin with it: `prompts.csv, line 3: `, or nothing for an argument."""

    request: GenerationRequest
    where: str = ""


@dataclass(frozen=True)
class MotionsRequest:
    """`count` motions of each prompt, or with `join` of all prompts in sequence, under `constraints`.

    Poses are sampled at `times`, or at `fps` (None: the format's or the model's own). Raises `UsageError` for instants
    outside a motion's duration, and for missing durations that are needed.
    """

    prompts: tuple[Prompt, ...]
    count: int = 1
    times: tuple[float, ...] = ()
    fps: Fraction | None = None
    join: bool = False
    constraints: tuple[Constraint, ...] = ()

    def __post_init__(self) -> None:
        for prompt in self.prompts if self.join else ():
            if prompt.request.duration_seconds is None:
                raise UsageError(
                    f"{prompt.where}--join needs to know how long each text lasts: --seconds, or in --prompts"
                )
        for prompts in self.scripts if self.times else ():
            lengths = [prompt.request.duration_seconds for prompt in prompts]
            length = None if None in lengths else sum(seconds for seconds in lengths if seconds is not None)
            place = prompts[0].where if len(prompts) == 1 else ""
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
    if suffix not in (".txt", ".csv"):
        raise UsageError(f"{path}: prompts are a .txt (a text a line) or a .csv (text, action, seconds)")
    if suffix == ".csv":
        rows = list(read_csv(path))
    else:
        lines = enumerate(read_text(path).splitlines(), start=1)
        rows = [(number, {"text": line}) for number, line in lines if line.strip()]
    if not rows:
        raise UsageError(f"{path}: holds no prompts")
    wheres = [f"{path}, line {number}: " for number, _ in rows]
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


def _request(row: Mapping[str, str], default_seconds: float | None, where: str) -> GenerationRequest:
    unknown = [name for name in row if name not in PROMPT_COLUMNS]
    if unknown:
        raise UsageError(f"{where}unknown column {shown(unknown[0])}, expected {', '.join(PROMPT_COLUMNS)}")
    text, action, seconds = (row.get(name, "").strip() for name in PROMPT_COLUMNS)
    if bool(text) == bool(action):
        raise UsageError(f"{where}give a text or an action, {'not both' if text else 'there is neither'}")
    length = _number(seconds, f"{where}seconds") if seconds else default_seconds
    if length is not None and length <= 0:
        raise UsageError(f"{where}seconds is a positive number, not {shown(seconds)}")
    return GenerationRequest(length, text, action)


def _number(cell: str, place: str) -> float:
    if not _is_number(cell):
        raise UsageError(f"{place} is a number, not {shown(cell)}")
    return float(cell)


@dataclass(frozen=True, eq=False)
class PathTable:
    """The points of a path: (x, z) in metres, seconds, heading (radians); None if not given."""

    name: str
    places: Float64[np.ndarray, "points 2"]
    seconds: Float64[np.ndarray, "points"] | None
    heading: Float64[np.ndarray, "points"] | None

    def constraint(self, duration_seconds: float | None) -> Constraint:
        """The path constraint for a motion's duration; raises `UsageError` if that is unknown but needed."""
        seconds = self.seconds
        if seconds is None:
            if duration_seconds is None:
                raise UsageError(
                    f"{self.name}: without a column 'seconds' the path is walked evenly, which needs --seconds"
                )
            steps = np.linalg.norm(np.diff(self.places, axis=0), axis=1)
            if not steps.all():
                raise UsageError(f"{self.name}: the same point twice; a path that rests says so by its seconds")
            seconds = np.concatenate(([0.0], steps.cumsum())) * (duration_seconds / steps.sum())
        return Constraint.path(self.places, seconds, self.heading, self.name)


def read_path(path: Path) -> PathTable:
    """Read a CSV of a path; raises `UsageError` with file and line for a row that is not of numbers."""
    rows = []
    for line, cells in read_csv(path):
        if not {"x", "z"} <= cells.keys() <= set(PATH_COLUMNS):
            raise UsageError(f"{path}, line 1: expected the columns x and z, perhaps seconds and heading_degrees")
        rows.append([_number(cell, f"{path}, line {line}: {name}") for name, cell in cells.items()])
    if len(rows) < 2:
        raise UsageError(f"{path}: a path has two points or more, not {len(rows)}")
    column = dict(zip(cells, np.array(rows).T, strict=True))
    heading = np.radians(column["heading_degrees"]) if "heading_degrees" in column else None
    return PathTable(path.name, np.stack((column["x"], column["z"]), axis=1), column.get("seconds"), heading)


def parse_constraints(
    path: PathTable | None,
    is_joined: bool,
    prompts: Sequence[Prompt],
    poses: Sequence[str] | None,
    places: Sequence[str] | None,
    *,
    placed: bool = False,
) -> tuple[Constraint, ...]:
    """All constraints of a motion; raises what reading them raises."""
    lengths = [prompt.request.duration_seconds for prompt in prompts]
    length = lengths[0] if len(set(lengths)) == 1 else None
    if is_joined:
        length = None if None in lengths else sum(each or 0.0 for each in lengths)
    of_path = [] if path is None else [path.constraint(length)]
    return (*of_path, *(parse_pose(each, placed=placed) for each in poses or ()), *map(parse_joint, places or ()))


def parse_pose(given: str, *, placed: bool = False) -> Constraint:
    """Parse the pose of `SECONDS=FILE` or `SECONDS=FILE@INSTANT`, in the 22-joint layout.

    Raises `UsageError` for another form, a file of several frames without an instant, and an instant outside it.
    """
    from scipy.interpolate import interp1d

    stated, separator, name = given.partition("=")
    if not separator or not name or not _is_number(stated):
        raise UsageError(f"--pose takes SECONDS=FILE or SECONDS=FILE@INSTANT (2.0=clip.bvh@1.5), not {given!r}")
    file, _, last = name.rpartition("@")
    seconds, instant = float(stated), float(last) if file and _is_number(last) else None
    path = Path(name if instant is None else file)
    motion = read(path)
    try:
        positions = map_joints(motion, SMPL22.name).astype(np.float64)
    except MotionkitError as error:
        raise UsageError(f"{path}: {error}") from None
    times = motion.timegrid.seconds()
    if instant is None and len(times) > 1:
        raise UsageError(
            f"{path} holds {len(times):,} frames: say which by its second (--pose {stated}={path}@{times[0]:g})"
        )
    if instant is not None and not times[0] - 1e-6 <= instant <= times[-1] + 1e-6:
        raise UsageError(f"{path}: {instant:g} s lies outside its {times[0]:g} … {times[-1]:g} s")
    pose = positions[0]
    if instant is not None and len(times) > 1:
        pose = interp1d(times, positions, axis=0)(np.clip(instant, times[0], times[-1]))
    return Constraint.pose(pose, seconds, placed=placed, name=f"{name} at {seconds:g} s")


def parse_joint(given: str) -> Constraint:
    """Parse the joint of `NAME@SECONDS=x,y,z` or `NAME@FROM-TO=x,y,z`; raises `UsageError` for another form."""
    match = _JOINT.fullmatch(given)
    numbers = [match["start"], match["end"] or match["start"], *match["place"].split(",")] if match else []
    if match is None or len(numbers) != 5 or not all(map(_is_number, numbers)):
        raise UsageError(f"--joint takes NAME@FROM-TO=x,y,z (left_foot@1.0-1.4=0.2,0.05,1), not {given!r}")
    start, end, x, y, z = map(float, numbers)
    if end < start:
        raise UsageError(f"--joint {given}: {end:g} s lies before {start:g} s")
    return Constraint.joint(match["joint"], (x, y, z), start, end, name=given)


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False
