"""A table's request from what a test wants to say, wherever it stands in the request."""

from dataclasses import fields
from pathlib import Path
from typing import Any

from eval.tables.registry import (
    ClipFidSettings,
    Evaluated,
    Evaluators,
    PublishedProtocol,
    RealMotions,
    TableRequest,
)

PARTS = {
    "real": RealMotions,
    "evaluated": Evaluated,
    "evaluators": Evaluators,
    "clip_fid": ClipFidSettings,
    "published": PublishedProtocol,
}


def table_request(store: Path, results: Path, **values: Any) -> TableRequest:
    """The request with these values of its parts' fields (`run`, `split`, `protocol` …) and of its own.

    `features` are the evaluators' names, `published` is the protocol's.
    """
    values |= {"store": store}
    for field, short in (("names", "features"), ("name", "published")):
        if short in values:
            values[field] = values.pop(short)
    parts: dict[str, Any] = {}
    for part, kind in PARTS.items():
        names = [field.name for field in fields(kind) if field.name in values]
        parts[part] = kind(**{name: values.pop(name) for name in names})
    return TableRequest(results=results, **parts, **values)
