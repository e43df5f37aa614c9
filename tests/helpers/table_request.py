"""A table's configuration from what a test says."""

from pathlib import Path
from typing import Any

from eval.tables.table import EvalConfig

NAMES = {"features": "evaluators", "names": "evaluators", "published": "protocol"}


def table_request(store: Path, results: Path, **values: Any) -> EvalConfig:
    """The configuration with these values; `features` are the evaluators' names, `published` is the protocol's."""
    if "protocol" in values:
        values["clips"] = values.pop("protocol")
    return EvalConfig(store=store, results=results, **{NAMES.get(name, name): value for name, value in values.items()})
