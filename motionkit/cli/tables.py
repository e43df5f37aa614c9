"""Tables of numbers on a terminal, split into several if the columns do not fit."""

from collections.abc import Iterator, Sequence

from rich.console import Console
from rich.table import Table

from motionkit.cli.console import stdout
from motionkit.core.plain_text import printable

LONGEST_NAME = 30
GAP = 2


def print_table(columns: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]], console: Console = stdout) -> None:
    """Print each row's name and a number (or a dash) per column; numbers only break before their ±."""
    names = [printable(name) for name, _ in rows]
    cells = [[printable(text).replace("± ", "±") for text in numbers] for _, numbers in rows]
    titles = [printable(column) for column in columns]
    label = min(LONGEST_NAME, max(map(len, names), default=0))
    room = console.width - label - GAP
    texts = [(title, *(row[at] for row in cells)) for at, title in enumerate(titles)]
    widths = [max(map(len, each)) for each in texts]
    if sum(widths) + GAP * len(widths) > room:
        widths = [max(len(word) for text in each for word in text.split(" ")) for each in texts]
    for piece in _pieces(widths, room):
        table = Table(box=None, padding=(0, GAP, 0, 0), pad_edge=False, show_edge=False)
        table.add_column("", width=label, overflow="fold")
        for at in piece:
            table.add_column(titles[at], justify="right", width=widths[at], overflow="fold")
        for name, row in zip(names, cells, strict=True):
            table.add_row(name, *(row[at] for at in piece))
        console.print(table, soft_wrap=False)
        console.print("")


def _pieces(widths: Sequence[int], room: int) -> Iterator[list[int]]:
    """Groups of columns that fit the width, in order; at least one each."""
    piece: list[int] = []
    used = 0
    for at, width in enumerate(widths):
        if piece and used + width + GAP > room:
            yield piece
            piece, used = [], 0
        piece.append(at)
        used += width + GAP
    if piece:
        yield piece
