"""A collector of what a table lacks, with the reasons."""

from collections.abc import Iterator
from contextlib import contextmanager

from motionkit.core.errors import MotionkitError


class Missing:
    """What a table lacks: a line for each, in order, without repetitions."""

    def __init__(self) -> None:
        self._lines: dict[str, None] = {}

    def add(self, *lines: str) -> None:
        """Add lines."""
        self._lines |= dict.fromkeys(lines)

    @contextmanager
    def skipping(self, label: str, errors: tuple[type[Exception], ...] = (MotionkitError,)) -> Iterator[None]:
        """Leave out what raises one of these errors, as "label: error"."""
        try:
            yield
        except errors as error:
            self.add(f"{label}: {error}")

    @property
    def lines(self) -> tuple[str, ...]:
        """All lines."""
        return tuple(self._lines)

    def clear(self) -> None:
        """Remove all lines."""
        self._lines.clear()
