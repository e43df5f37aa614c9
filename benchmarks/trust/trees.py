"""A folder's contents as a mapping that is equal for two runs of the same command."""

import hashlib
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

# Times, and checksums of files that hold them: of the document itself, of metrics.jsonl.
VOLATILE = frozenset(("checksum", "cpu_seconds", "metrics", "metrics.jsonl", "time", "wall_seconds"))
TIMED = (".jsonl", "summary.json")
SHOWN = 3


def tree(folder: Path, digits: int | None = None) -> dict[str, str]:
    """Every file and folder below a folder with a digest of its content, as far as it does not depend on the clock.

    With `digits`, numbers in logs are rounded to so many, for sums whose order depends on the clock.
    """
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        found[name] = f"-> {path.readlink()}" if path.is_symlink() else "/" if path.is_dir() else _digest(path, digits)
    return found


def difference(found: Mapping[str, str], expected: Mapping[str, str]) -> str:
    """The differences of two trees, in a few words; empty if there are none."""
    lines = []
    for words, names in (
        ("left over", sorted(found.keys() - expected.keys())),
        ("missing", sorted(expected.keys() - found.keys())),
        ("different", sorted(name for name in found.keys() & expected.keys() if found[name] != expected[name])),
    ):
        if names:
            more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
            lines.append(f"{words}: {', '.join(names[:SHOWN])}{more}")
    return "; ".join(lines)


def copy(source: Path, target: Path) -> None:
    """Copy a folder over whatever was at the target."""
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(source, target, symlinks=True)


def _digest(path: Path, digits: int | None) -> str:
    if path.name.endswith(".lock"):
        return "lock"  # it holds the number of a process
    content = path.read_bytes()
    if path.suffix in (".json", ".jsonl"):
        content = _without_clocks(path.name, content, digits)
    if path.suffix == ".safetensors":
        content = _without_log(content)
    return hashlib.sha256(content).hexdigest()


def _without_clocks(name: str, content: bytes, digits: int | None) -> bytes:
    try:
        documents = [json.loads(part) for part in (content.splitlines() if name.endswith(".jsonl") else [content])]
    except ValueError:
        return content
    dropped = VOLATILE | {"seconds"} if name.endswith(TIMED) else VOLATILE
    rounded = digits if name.endswith(".jsonl") else None
    return json.dumps([_kept(document, dropped, rounded) for document in documents], sort_keys=True).encode()


def _without_log(content: bytes) -> bytes:
    """A safetensors file without the checksum of the log that its description may hold, and without its own."""
    end = 8 + int.from_bytes(content[:8], "little")
    try:
        header = json.loads(content[8:end])
        metadata = header.pop("__metadata__")
        description = _kept(json.loads(metadata["description"]), VOLATILE, None)
    except (KeyError, ValueError):
        return content
    return json.dumps([header, description], sort_keys=True).encode() + content[end:]


def _kept(value: Any, dropped: frozenset[str], digits: int | None) -> Any:
    if isinstance(value, dict):
        return {name: _kept(each, dropped, digits) for name, each in value.items() if name not in dropped}
    if isinstance(value, list):
        return [_kept(each, dropped, digits) for each in value]
    return float(f"{value:.{digits}g}") if isinstance(value, float) and digits is not None else value
