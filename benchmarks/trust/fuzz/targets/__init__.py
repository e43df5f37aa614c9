"""All readers that the fuzz part tries."""

from benchmarks.trust.fuzz.target import Target
from benchmarks.trust.fuzz.targets import captures, samples, stores


def all_targets() -> tuple[Target, ...]:
    """Every reader, in order."""
    return (*captures.targets(), *samples.targets(), *stores.targets())
