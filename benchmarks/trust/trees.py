"""What a folder and a store hold, equal for two runs of the same command."""

import hashlib
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core.errors import MotionkitError
from motionkit.store import Store
from motionkit.store.schema import MANIFEST_FILE
from motionkit.store.validate import faults

# Times, and checksums of files that hold them: of the document itself, of metrics.jsonl.
VOLATILE = frozenset(("checksum", "cpu_seconds", "metrics", "metrics.jsonl", "time", "wall_seconds"))
TIMED = (".jsonl", "summary.json")
SHOWN = 3


def tree(folder: Path) -> dict[str, str]:
    """Every file and folder below a folder with a digest of its content, as far as it does not depend on the clock."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        found[name] = f"-> {path.readlink()}" if path.is_symlink() else "/" if path.is_dir() else _digest(path)
    return found


def difference(found: Mapping[str, str], expected: Mapping[str, str]) -> str:
    """The differences of two trees, in a few words; empty if there are none."""
    lines = []
    for words, names in (
        ("left over", found.keys() - expected.keys()),
        ("missing", expected.keys() - found.keys()),
        ("different", {name for name in found.keys() & expected.keys() if found[name] != expected[name]}),
    ):
        if names:
            more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
            lines.append(f"{words}: {', '.join(sorted(names)[:SHOWN])}{more}")
    return "; ".join(lines)


def copy(source: Path, target: Path) -> None:
    """Copy a folder over whatever was at the target."""
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(source, target, symlinks=True)


def _digest(path: Path) -> str:
    if path.name.endswith(".lock"):
        return "lock"  # it holds the number of a process
    if path.name == "SHA256SUMS":
        return "sums"  # of files that hold times
    content = path.read_bytes()
    try:
        if path.suffix in (".json", ".jsonl"):
            dropped = VOLATILE | {"seconds"} if path.name.endswith(TIMED) else VOLATILE
            documents = [json.loads(part) for part in (content.splitlines() if path.suffix == ".jsonl" else [content])]
            content = json.dumps([_kept(each, dropped) for each in documents], sort_keys=True).encode()
        elif path.suffix == ".safetensors":
            end = 8 + int.from_bytes(content[:8], "little")
            header = json.loads(content[8:end])
            description = json.loads(header.pop("__metadata__")["description"])
            content = json.dumps([header, _kept(description, VOLATILE)], sort_keys=True).encode() + content[end:]
    except (KeyError, ValueError):
        pass  # as it stands
    return hashlib.sha256(content).hexdigest()


def _kept(value: Any, dropped: frozenset[str]) -> Any:
    if isinstance(value, dict):
        return {name: _kept(each, dropped) for name, each in value.items() if name not in dropped}
    return [_kept(each, dropped) for each in value] if isinstance(value, list) else value


def look(path: Path) -> dict[str, Any]:
    """What a reader finds in a store: its fingerprint, a digest of every motion, and `validate`'s faults."""
    if not (path / MANIFEST_FILE).exists():
        return {}
    try:
        store = Store.open(path)
        return {"fingerprint": store.fingerprint, "content": content_of(store), "faults": list(faults(path))}
    except MotionkitError as error:
        return {"unreadable": str(error)}


def content_of(store: Store) -> str:
    """A digest of the content of a store's sequences, independent of its parts and indices."""
    found = hashlib.sha256()
    for motion in store.read_many(store.select()):
        facts = (motion.sequence_id, motion.fps, motion.split, motion.action, motion.captions)
        found.update(repr(facts).encode() + np.ascontiguousarray(motion.joint_positions).tobytes())
    return found.hexdigest()
