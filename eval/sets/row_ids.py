"""The identity of a table's row: a system, and how its motions were made or changed."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from motionkit.core.errors import UsageError


class Variant(Enum):
    """How a row's motions were made or changed; the value is the pattern of its name, {} being the system."""

    AS_IS = "{}"
    PLANTED = "{}, planted"
    DETAILED = "{}, planted, with detail"
    UPSAMPLED = "{} generated at 20 fps, SLERP"
    AS_VECTORS = "{} as vectors (handicapped)"
    HELD_OUT = "{}, held out"
    INDEPENDENT_DRAWS = "{}, independent draws (P1)"
    HALVES = "{}, disjoint halves of the takes (P2)"
    KEPT_AT_20 = "{} kept at 20 fps, SLERP"
    KEPT_AS_VECTORS = "{} kept at 20 fps, as vectors (handicapped)"
    AS_GENERATOR = "{}, as a generator"


@dataclass(frozen=True)
class RowId:
    """A row's system and variant; `str` is its name in the table."""

    system: str
    variant: Variant = Variant.AS_IS

    def __str__(self) -> str:
        return self.variant.value.format(self.system)


REAL, TRAINING_TAKES = RowId("real"), RowId("training takes")


def check_sample_names(samples: Iterable[str], systems: Iterable[str] = ()) -> None:
    """Raise `UsageError` for samples with a row named like another one: of these systems, of real motion, of samples.

    The systems' rows are those of every variant, the samples' as they are and planted.
    """
    systems = (REAL.system, TRAINING_TAKES.system, *systems)
    names = {str(RowId(system, variant)) for system in systems for variant in Variant}
    for system in samples:
        own = {str(RowId(system)), str(RowId(system, Variant.PLANTED))}
        if duplicates := sorted(own & names):
            raise UsageError(f"--samples {system}=…: there is a row {duplicates[0]!r} already; choose another name")
        names |= own
