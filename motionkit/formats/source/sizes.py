"""How long a sequence may be: the memory that reading it takes grows with its frames and joints (docs/formats.md)."""

from pathlib import Path

from motionkit.core.errors import FormatError

# 9.7 hours at 120 fps; and frames × joints, of each of which reading takes at most 60 bytes: 4 GB.
MAX_FRAMES = 1 << 22
MAX_POSES = 1 << 26


def check_size(num_frames: int, num_joints: int, path: Path) -> None:
    """Raise `FormatError` (`too-large`) beyond 4,194,304 frames, and beyond 67,108,864 frames × joints."""
    most = min(MAX_FRAMES, MAX_POSES // max(1, num_joints))
    if num_frames > most:
        raise FormatError(
            f"{num_frames:,} frames of {num_joints} joints, expected at most {most:,} frames of so many joints; cut it "
            "into several files (docs/formats.md, Long takes)",
            path=path,
            reason="too-large",
        )
