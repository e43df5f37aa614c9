"""What the benchmarks' commands share: arguments, the quickest of some repeats, figures as JSON and as a table."""

import argparse
import json
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from eval.report.results import provenance


def arguments_parser(description: str | None) -> argparse.ArgumentParser:
    """A parser whose help is a module's text as it stands."""
    return argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)


def best_cpu_seconds(work: Callable[[], object], repeats: int) -> float:
    """Processor time of the quickest of some repeats."""
    found = []
    for _ in range(repeats):
        begun = time.process_time()
        work()
        found.append(time.process_time() - begun)
    return min(found)


def print_json(figures: Mapping[str, Any], store: Path | None = None, runs: Sequence[Path] = ()) -> None:
    """Figures on stdout, with what they are of."""
    print(json.dumps({**figures, "provenance": provenance(store, runs)}, indent=2, ensure_ascii=False))


def print_table_and_json(table: Table, figures: Mapping[str, Any], store: Path | None = None) -> None:
    """A table on stderr, its figures on stdout."""
    Console(stderr=True).print(table)
    print_json(figures, store)
