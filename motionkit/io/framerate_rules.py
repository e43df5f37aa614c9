"""Corrections of framerates that files state wrongly: the user's rules, and those shipped with motionkit.

A rule has globs of files (`pathlib.PurePath.match`), the wrong framerate that they state (`stated`; omitted: any), the
right one, and its source. The user's rules come first, and the first matching rule applies; an explicit framerate
(--fps, or the column fps of an annotation CSV) overrides all rules. The shipped ones are framerate_rules.toml.
"""

from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from importlib import resources
from pathlib import Path, PurePosixPath
from typing import Any

from motionkit.core.errors import UsageError
from motionkit.core.files import read_at_most
from motionkit.core.framerate import parse_fps
from motionkit.core.plain_text import LONGEST_TOML, parse_toml, shown
from motionkit.io import source_file

KEYS = frozenset({"files", "stated", "fps", "reason", "source"})
SHIPPED = "framerate_rules.toml"


@dataclass(frozen=True)
class FramerateRule:
    """Files whose framerate is `fps` although they state `stated` (None: any).

    `where` names the rule for logs: its file's name and its number.
    """

    files: tuple[str, ...]
    fps: Fraction
    stated: Fraction | None
    source: str
    where: str


def read_rules(path: Path) -> tuple[FramerateRule, ...]:
    """The rules of a TOML file in its order; raises `UsageError` that names the file, the rule and the fault."""
    try:
        text = read_at_most(path, LONGEST_TOML).decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    return parse_rules(text, str(path))


@cache
def shipped_rules() -> tuple[FramerateRule, ...]:
    """The corrections that motionkit ships, each with its source."""
    return parse_rules((resources.files(__package__) / SHIPPED).read_text(encoding="utf-8"), "shipped")


def parse_rules(text: str, name: str) -> tuple[FramerateRule, ...]:
    """The rules in TOML text; `name` is for messages. Raises `UsageError`."""
    try:
        content = parse_toml(text)
    except ValueError as error:
        raise UsageError(f"{name} is no TOML file ({error}): expected tables [[rule]], see docs/formats.md") from None
    tables = content.get("rule")
    if set(content) != {"rule"} or not isinstance(tables, list):
        raise UsageError(f"{name}: expected tables [[rule]] with files, fps and, if you like, stated, reason, source")
    return tuple(_rule(table, name, number) for number, table in enumerate(tables, start=1))


def matching_rules(path: Path, root: Path, rules: tuple[FramerateRule, ...]) -> tuple[FramerateRule, ...]:
    """The rules whose globs match a file's path, relative to the parent folder of its source."""
    place = PurePosixPath(root.name, path.relative_to(root).as_posix())
    return tuple(rule for rule in rules if any(map(place.match, rule.files)))


def corrected_fps(fps: Fraction, rules: tuple[FramerateRule, ...]) -> tuple[Fraction, list[str]]:
    """The framerate by the first rule that applies to the file's own, and a log line naming the rule if it changes."""
    rule = next((rule for rule in rules if rule.stated in (None, fps)), None)
    if rule is None:
        return fps, []
    by = f" by rule ({rule.where}{f', {rule.source}' if rule.source else ''})"
    return rule.fps, source_file.replaced_fps(rule.fps, fps, by=by)


def _rule(table: Any, name: str, number: int) -> FramerateRule:
    where = f"{name}, rule {number}"
    if not isinstance(table, dict) or not {"files", "fps"} <= set(table) <= KEYS:
        given = ", ".join(table)[:200] if isinstance(table, dict) else shown(table)
        raise UsageError(
            f"{where}: has {given or 'nothing'}; expected files and fps, and any of stated, reason, source"
        )
    globs = [table["files"]] if isinstance(table["files"], str) else table["files"]
    if not isinstance(globs, list) or not globs or not all(isinstance(glob, str) and glob for glob in globs):
        raise UsageError(f"{where}: files must be a glob in quotes, or a list of them, not {shown(globs)}")
    for glob in globs:
        try:
            PurePosixPath().match(glob)
        except ValueError as error:
            raise UsageError(f"{where}: files: {error}") from None
    for key in ("reason", "source"):
        if not isinstance(table.get(key, ""), str):
            raise UsageError(f"{where}: {key} must be text in quotes, not {shown(table[key])}")
    stated = None if "stated" not in table else _rate(table["stated"], where, "stated")
    return FramerateRule(
        tuple(globs),
        _rate(table["fps"], where, "fps"),
        stated,
        table.get("source", ""),
        f"{Path(name).name}, rule {number}",
    )


def _rate(value: Any, where: str, key: str) -> Fraction:
    if isinstance(value, bool) or not isinstance(value, (str, int, float)):
        raise UsageError(f"{where}: {key} must be a framerate such as 120 or '30000/1001', not {shown(value)}")
    try:
        return parse_fps(value)
    except ValueError as error:
        raise UsageError(f"{where}: {key}: {error}") from None
