"""Files that `motionkit complete` and `motionkit plant` have made beside their sources: they are no captures."""

import re
from pathlib import Path

COMPLETED, PLANTED = "completed", "planted"
MADE_FOLDER = re.compile(rf"({COMPLETED}|{PLANTED})-[\d.-]+fps")


def folder_of_made(fps: str, made: str = COMPLETED) -> str:
    """The name of the folder for completed or planted arrays of a framerate, beside those that they were made of."""
    return f"{made}-{fps.replace('/', '-')}fps"


def is_made(path: Path) -> bool:
    """Whether a file, by its name or its folder's, was made: `walk.completed.bvh`, `planted-60fps/walk.npy`."""
    name = path.name.rpartition(".")[0] if path.suffix else path.name
    return name.endswith((f".{COMPLETED}", f".{PLANTED}")) or MADE_FOLDER.fullmatch(path.parent.name) is not None
