"""The result of a check."""

from dataclasses import dataclass
from typing import Literal

State = Literal["good", "note", "problem"]


@dataclass(frozen=True)
class Finding:
    """A fact about a topic ("disk", "store" …), and advice, or "" if nothing needs to be done.

    A "problem" makes commands fail, or their results wrong; a "note" is information.
    """

    topic: str
    fact: str
    state: State = "good"
    remedy: str = ""
