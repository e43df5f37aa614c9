"""metrics.jsonl: one JSON object per logged step, with its extent recorded in checkpoints and summaries."""

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from motionkit.core.errors import DamagedFileError
from motionkit.core.files import naming, sync
from motionkit.core.plain_text import shown

# Called with a stage's name and logged metrics.
OnMetrics = Callable[[str, Mapping[str, float]], None]
HINT = "restore it from a copy, or train the stage again with --overwrite"


def ignore_metrics(stage: str, values: Mapping[str, float]) -> None:
    """Ignore metrics."""


class MetricsLog:
    """The log of a stage, which need not exist yet."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def append(self, values: Mapping[str, float]) -> None:
        """Add a line."""
        with naming(self.path), self.path.open("a", encoding="utf-8") as log:
            log.write(json.dumps(dict(values)) + "\n")

    def lines(self) -> list[dict[str, float]]:
        """All complete lines, oldest first, without a partial line of a crash or a concurrent write."""
        lines = self._content().decode("utf-8", errors="replace").splitlines()
        return [values for values in map(_values_of, lines) if values is not None]

    def extent(self) -> dict[str, Any]:
        """Flush the log; returns its length in bytes and sha256."""
        if self.path.is_file():
            sync(self.path)
        return _extent_of(self._content())

    def extent_until(self, step: int) -> dict[str, Any]:
        """Length and sha256 of the lines up to a step, for old checkpoints that did not record them."""
        content, kept = self._content(), 0
        for line in content.splitlines(keepends=True):
            values = _values_of(line.decode("utf-8", errors="replace"))
            if values is None or values["step"] > step or not line.endswith(b"\n"):
                break
            kept += len(line)
        return _extent_of(content[:kept])

    def check(self, extent: Any) -> None:
        """Raise `DamagedFileError` if the log does not begin with the recorded extent (from JSON)."""
        if not isinstance(extent, Mapping) or not isinstance(extent.get("bytes"), int):
            raise DamagedFileError(self.path, f"its length and sha256 were recorded as {shown(extent)}", HINT)
        found = _extent_of(self._content()[: extent["bytes"]])
        if found["bytes"] < extent["bytes"]:
            fault = f"it has {found['bytes']:,} bytes, expected {extent['bytes']:,}"
            raise DamagedFileError(self.path, fault if self.path.is_file() else "it is missing", HINT)
        if found != extent:
            raise DamagedFileError(self.path, "its content does not match its checksum", HINT)

    def cut(self, extent: Any) -> None:
        """Check the recorded extent and truncate the log to it; errors as in `check`."""
        self.check(extent)
        if self.path.is_file():
            with naming(self.path), self.path.open("r+b") as log:
                log.truncate(extent["bytes"])

    def _content(self) -> bytes:
        return self.path.read_bytes() if self.path.is_file() else b""


NOTHING_LOGGED: Mapping[str, Any] = {"bytes": 0, "sha256": hashlib.sha256().hexdigest()}


def _extent_of(content: bytes) -> dict[str, Any]:
    return {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}


def _values_of(line: str) -> dict[str, float] | None:
    try:
        values = json.loads(line)
    except (ValueError, RecursionError):
        return None
    whole = isinstance(values, dict) and "step" in values
    return values if whole and all(isinstance(value, (int, float)) for value in values.values()) else None
