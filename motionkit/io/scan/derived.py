"""Recognises outputs of `motionkit complete` and `motionkit plant` beside their sources, which are no captures."""

import re
from pathlib import Path

COMPLETED, PLANTED = "completed", "planted"
DERIVED_FOLDER = re.compile(rf"({COMPLETED}|{PLANTED})-[\d.-]+fps")


def derived_folder(fps: str, made: str = COMPLETED) -> str:
    """The name of the folder for completed or planted arrays of a framerate, beside their sources."""
    return f"{made}-{fps.replace('/', '-')}fps"


def is_derived(path: Path) -> bool:
    """Whether a file is such an output, by its name or its folder's: `walk.completed.bvh`, `planted-60fps/walk.npy`."""
    name = path.name.rpartition(".")[0] if path.suffix else path.name
    return name.endswith((f".{COMPLETED}", f".{PLANTED}")) or DERIVED_FOLDER.fullmatch(path.parent.name) is not None
