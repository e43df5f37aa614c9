"""What a check found."""

from dataclasses import dataclass
from typing import Literal

State = Literal["good", "note", "problem"]


@dataclass(frozen=True)
class Finding:
    """One fact about a topic ("disk", "store" …), and what to do about it, "" where nothing needs to be done.

    A "problem" makes commands fail, or their results wrong; a "note" is worth knowing.
    """

    topic: str
    fact: str
    state: State = "good"
    remedy: str = ""
