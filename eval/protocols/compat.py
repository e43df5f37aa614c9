"""Known bugs of published evaluations: off in every protocol, on by name for whoever wants their numbers."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from motionkit.errors import UsageError


@dataclass(frozen=True)
class KnownBug:
    """A fault of published code that changes numbers; `part` is what has to know of it."""

    name: str
    part: Literal["scores", "evaluator"]
    description: str


FLOAT32_DISTANCES = KnownBug(
    "float32-distances",
    "scores",
    "R-Precision and MM-Dist from √(a² + b² − 2ab) in float32: equal vectors give NaN, which ranks last and makes "
    "MM-Dist NaN; ties go to the candidate that comes first",
)
NAN_IS_BEST = KnownBug(
    "nan-is-best",
    "scores",
    "the same distances, and NaN becomes 0: a distance that cannot be computed is the best match",
)
PADDING_LEAK = KnownBug(
    "padding-leak",
    "evaluator",
    "the motion encoder's last valid step sees three frames past a motion's end, whatever stands there",
)
KNOWN_BUGS = (FLOAT32_DISTANCES, NAN_IS_BEST, PADDING_LEAK)


def chosen_bugs(protocol: str, has: Sequence[str], asked: Sequence[str]) -> tuple[KnownBug, ...]:
    """The bugs that were asked for by name. Raises `UsageError` for one that the protocol's code does not have."""
    for name in asked:
        if name not in has:
            raise UsageError(
                f"--compat {name}: the evaluation of protocol {protocol!r} has no such bug; "
                f"it has {', '.join(has) or 'none that is known here'}"
            )
    return tuple(bug for bug in KNOWN_BUGS if bug.name in asked)
