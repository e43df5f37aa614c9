"""One hostile thing: how it is put into a good folder, and the commands that meet it there."""

import json
import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Arguments = tuple[str, ...]
Spoil = Callable[[Path, Path], None]
# Colours, a window's title, line breaks, a C1 control and a turned direction of writing.
EVIL = "\x1b[31mred\x1b]0;title\x07\r\n\x9b2J\u202e"


@dataclass(frozen=True)
class Scene:
    """What a stranger may send.

    `spoil` changes a folder of good things (`inside`), and may point at what lies in another (`outside`), which holds
    the same good things and belongs to somebody else. `commands` are run in `inside`, each in a copy of its own.
    """

    name: str
    spoil: Spoil
    commands: tuple[Arguments, ...]


def link(path: Path, target: Path) -> None:
    """Put a symbolic link in the place of whatever is there; it is relative, as an archive holds it."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.symlink_to(os.path.relpath(target, path.parent))


def links(places: Mapping[str, str]) -> Spoil:
    """Links at places inside that lead to places outside; a place may be a pattern of things that are there."""

    def spoil(inside: Path, outside: Path) -> None:
        for place, target in places.items():
            found = sorted(inside.glob(place)) if "*" in place else [inside / place]
            assert found, place
            for path in found:
                link(path, next(iter(sorted(outside.glob(target)))) if "*" in target else outside / target)

    return spoil


def text(place: str, content: str | bytes) -> Spoil:
    """A file of this content."""

    def spoil(inside: Path, outside: Path) -> None:
        path = inside / place
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())

    return spoil


def edited(place: str, edit: Callable[[dict[str, Any]], None]) -> Spoil:
    """A JSON file that is changed; its folder has no record of sha256."""

    def spoil(inside: Path, outside: Path) -> None:
        document = json.loads((inside / place).read_bytes())
        edit(document)
        (inside / place).write_text(json.dumps(document))
        (inside / place).with_name("SHA256SUMS").unlink(missing_ok=True)

    return spoil
