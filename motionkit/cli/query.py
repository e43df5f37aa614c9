"""`motionkit query`: SQL over a store."""

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from motionkit.cli import console
from motionkit.core.files import default_path


def query(
    sql: Annotated[str, typer.Argument(help="One SQL statement, in duckdb's dialect.", show_default=False)],
    store: Annotated[Path | None, typer.Option(help="Store to ask.", show_default="./store")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the rows as JSON.")] = False,
) -> None:
    """Query a store in SQL: the tables sequences, motions and skeletons; nothing can be changed.

    Example: motionkit query "SELECT fps, count(*) FROM sequences GROUP BY fps"
    """
    from motionkit.store import Store

    result = Store.open(store or default_path("store")).query(sql)
    if as_json:
        console.print_json([_plain(row) for row in result.to_pylist()])
    else:
        console.print_text(result.to_pandas().to_string(index=False, line_width=console.stdout.width))


def _plain(value: Any) -> Any:
    """Convert NaN, decimals, dates and bytes to JSON values."""
    if isinstance(value, dict):
        return {str(name): _plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if type(value).__name__ == "Decimal":
        return int(value) if value == int(value) else float(value)
    return value.hex() if isinstance(value, bytes) else str(value)
