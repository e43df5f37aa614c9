"""Walking a source: every real folder once, linked ones too, whatever loops the links make."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

HIDDEN = (".", "__")


def walk(
    root: Path, is_whole: Callable[[Path], bool], on_error: Callable[[OSError], None]
) -> Iterator[tuple[Path, list[Path]]]:
    """The folders below `root`, itself first, in sorted order, each with its files; hidden ones are left out.

    A folder that `is_whole` is not entered. Links to folders are followed once all real folders are done, so that a
    folder which is there both ways goes by its real path; one that was seen before, or that contains the source, is
    not followed. What cannot be listed goes to `on_error`.
    """
    seen: set[tuple[int, int]] = set()
    starts = [root]
    while starts:
        links: list[Path] = []
        for start in starts:
            for name, below, files in os.walk(start, onerror=on_error):
                folder = Path(name)
                below[:] = sorted(entry for entry in below if not entry.startswith(HIDDEN))
                status = folder.stat()
                if (status.st_dev, status.st_ino) in seen:
                    below.clear()
                    continue
                seen.add((status.st_dev, status.st_ino))
                if is_whole(folder):
                    below.clear()
                links += [folder / entry for entry in below if (folder / entry).is_symlink()]
                yield folder, [folder / entry for entry in sorted(files) if not entry.startswith(".")]
        starts = [link for link in links if not root.is_relative_to(link.resolve())]
