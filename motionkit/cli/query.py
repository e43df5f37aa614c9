"""`motionkit query`: SQL over a store."""

import json
import math
from pathlib import Path
from typing import Annotated, Any

import typer

from motionkit.cli.console import print_json, stdout
from motionkit.core.errors import printable
from motionkit.core.files import default_path

LONG_LIST = 6
WIDEST = 100_000


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
    rows = [{name: _plain(value) for name, value in row.items()} for row in result.to_pylist()]
    if as_json:
        print_json(rows)
    else:
        _print_table(result.column_names, rows)


def _print_table(names: list[str], rows: list[dict[str, Any]]) -> None:
    """A table if it fits the width (80 columns without a terminal), else a block of lines for each row."""
    from rich.table import Table
    from rich.text import Text

    table = Table()
    for name in names:
        numeric = all(isinstance(row[name], int | float) and not isinstance(row[name], bool) for row in rows)
        table.add_column(Text(printable(name)), justify="right" if numeric and rows else "left", no_wrap=True)
    for row in rows:
        table.add_row(*(Text(printable(_short(row[name]))) for name in names))
    unlimited = stdout.options.update(max_width=WIDEST, width=WIDEST)
    if not rows or stdout.measure(table, options=unlimited).maximum <= stdout.width:
        stdout.print(table)
        return
    for number, row in enumerate(rows, start=1):
        stdout.print(f"row {number:,}")
        for name in names:
            stdout.print(f"  {name:{max(map(len, names))}}  {_short(row[name])}".rstrip())


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


def _short(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list) and len(value) > LONG_LIST and not isinstance(value[0], str):
        return f"[{', '.join(_short(each) for each in value[:3])}, … {len(value):,} values]"
    return json.dumps(value, ensure_ascii=False) if isinstance(value, list | dict) else str(value)
