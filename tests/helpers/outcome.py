"""What a command left behind."""

from typing import NamedTuple


class Outcome(NamedTuple):
    """Exit code and what was printed."""

    code: int
    stdout: str
    stderr: str
