"""What a command left behind."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Outcome:
    """Exit code and what was printed."""

    code: int
    stdout: str
    stderr: str

    @property
    def error_lines(self) -> list[str]:
        """What was told about faults; a warning is none (of the small BVH: that it lacks a right side)."""
        return [line for line in self.stderr.splitlines() if not line.startswith("warning: ")]
