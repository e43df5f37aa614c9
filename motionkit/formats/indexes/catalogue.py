"""All kinds of index, told apart by content."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from motionkit.core.errors import FormatError
from motionkit.formats.indexes import babel, humanml3d_index, tmr_annotations
from motionkit.formats.indexes.entries import Index
from motionkit.formats.source import source_file

# What has to be read of a JSON index to know its first value, whose captions may be long.
HEAD_BYTES = 1 << 16

JSON_KINDS: tuple[tuple[Callable[[Any], bool], Callable[[Path], Index]], ...] = (
    (tmr_annotations.recognise, tmr_annotations.read_tmr_annotations),
    (babel.recognise, babel.read_babel),
)


def read_index(path: Path) -> Index:
    """Read an index of any kind: HumanML3D's index.csv, TMR's annotations, BABEL's labels.

    Bad entries become its `problems`. Raises `FormatError` (`index`, `encoding`, `empty`, `unreadable`) for a file that
    is none.
    """
    head = source_file.read_bytes(path)[:HEAD_BYTES].decode("utf-8-sig", errors="replace")
    if humanml3d_index.recognise(head):
        return humanml3d_index.read_humanml3d_index(path)
    first = _first_value(head)
    for recognise, read in JSON_KINDS:
        if recognise(first):
            return read(path)
    raise FormatError(
        f"looks like {source_file.describe_content(head.encode())}, expected an index: HumanML3D's index.csv (columns "
        f"{', '.join(humanml3d_index.COLUMNS)}), TMR's annotations (path, annotations) or BABEL's labels (feat_p)",
        path=path,
        reason="index",
    )


def _first_value(head: str) -> Any:
    # The value of the first name of a JSON object, parsed from the beginning of the file; None where there is none.
    found = re.match(r'\s*\{\s*"(?:[^"\\]|\\.)*"\s*:\s*', head)
    if found is None:
        return None
    try:
        return json.JSONDecoder().raw_decode(head, found.end())[0]
    except (ValueError, RecursionError):
        return None
