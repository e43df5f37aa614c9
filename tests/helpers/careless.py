"""A command that loses what it had when it is killed, and one that takes care: what the drill is to tell apart."""

from pathlib import Path


def count_up(name: str) -> None:
    """Make a number greater by one, up to two, in its place."""
    path = Path(name)
    number = int(path.read_text()) if path.exists() else 0
    path.write_text("")
    with path.open("w") as handle:
        handle.write(str(min(number + 1, 2)))


def write_carefully(name: str) -> None:
    """Write a file beside its place first."""
    path = Path(name)
    pending = path.with_name(f".{path.name}.new")
    pending.write_text("x" * 10_000)
    pending.replace(path)
