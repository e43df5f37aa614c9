"""Reads motions, cuts them to the requested stretch, and writes a page or film of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core.errors import FormatError, MotionkitError, UsageError, describe
from motionkit.core.framerate import format_fps
from motionkit.core.plain_text import printable
from motionkit.io.reading import read_document
from motionkit.io.registry import ReadOptions, SourceItem
from motionkit.store.named_motions.holes import ReadClip, read_with_holes
from motionkit.store.named_motions.reading import FoundMotion, Readers, find_motions, find_stored
from motionkit.viz.player.page import check_places, write_page
from motionkit.viz.player.takes import Take, take_of

ViewSource = FoundMotion[ReadClip]


def find_sources(names: Sequence[str], options: ReadOptions, store: Path) -> tuple[list[ViewSource], list[FormatError]]:
    """The motions of these names, and problems of others. Raises `UsageError` for an unknown name."""
    readers = Readers(partial(_read, options=options), ReadClip.whole)
    return find_motions(names, options, store, readers)


def stored_where(store: Path, where: str) -> list[ViewSource]:
    """The stored sequences that match a condition, in the store's order; raises `StoreError` or `UsageError`."""
    return find_stored(store, where, ReadClip.whole)


def _read(item: SourceItem, options: ReadOptions) -> ReadClip:
    # As in `complete`: lost frames and skeletons that are not human are shown too.
    document = read_document(item, options)
    return ReadClip(document.motion(), document.seen) if document is not None else read_with_holes(item, options)


SUFFIX = ".view.html"
# Names combined from many files may exceed the system's limit, which is in bytes.
LONGEST_STEM_BYTES = 160


@dataclass(frozen=True)
class Stretch:
    """A half-open interval in seconds of a motion's own time; None is its beginning or its end.

    Raises `UsageError` for an empty one.
    """

    from_seconds: float | None = None
    to_seconds: float | None = None

    def __post_init__(self) -> None:
        begin, end = self.from_seconds, self.to_seconds
        if any(each is not None and not np.isfinite(each) for each in (begin, end)):
            raise UsageError("--from and --to are seconds")
        if begin is not None and end is not None and begin >= end:
            raise UsageError(f"--from {begin:g} --to {end:g} holds nothing: it ends before it begins")

    def of(self, take: Take) -> Take:
        """The frames inside; raises `MotionkitError` if there are none."""
        begin = -np.inf if self.from_seconds is None else self.from_seconds
        end = np.inf if self.to_seconds is None else self.to_seconds
        seconds = take.frame_seconds()
        first, stop = np.searchsorted(seconds, (begin - 1e-6, end - 1e-6)).tolist()
        if first >= stop:
            raise MotionkitError(
                f"it has no frame from {_instant(begin)} to {_instant(end)}: its frames are at {seconds[0]:g} to "
                f"{seconds[-1]:.6g} s"
            )
        return take.frames(first, stop)


@dataclass(frozen=True)
class Viewed:
    """A written page: its file, its size in bytes, its takes."""

    path: Path
    num_bytes: int
    takes: tuple[Take, ...]

    def plain(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "page": str(self.path),
            "bytes": self.num_bytes,
            "motions": [
                {
                    "name": take.name,
                    "fps": format_fps(take.fps),
                    "first_frame": take.first_frame,
                    "num_frames": take.num_frames,
                    "start_seconds": take.start_seconds,
                    "duration_seconds": take.duration_seconds,
                    "num_joints": take.skeleton.num_joints,
                }
                for take in self.takes
            ],
        }


def read_takes(
    sources: Sequence[ViewSource],
    stretch: Stretch,
    advance: Callable[[], None],
    drawn: Callable[[Take], Take] = lambda take: take,
) -> tuple[list[Take], list[tuple[str, str]]]:
    """The takes of sources, and name and message of each that cannot be shown.

    `drawn` may add drawings to a whole take.
    """
    takes: list[Take] = []
    failures: list[tuple[str, str]] = []
    # File names without folders, if these are unique.
    unique = len({source.short for source in sources}) == len(sources)
    for source in sources:
        try:
            take = stretch.of(drawn(_take(source.read(), source.short if unique else source.name)))
            check_places(take)
        except (MotionkitError, OSError) as error:
            failures.append((source.name, describe(error)))
        else:
            takes.append(take)
        advance()
    return takes, failures


def _take(read: ReadClip, name: str) -> Take:
    take = take_of(read.motion, name)
    uneven = read.uneven_seconds
    if uneven is not None:
        take = replace(take, uneven_seconds=uneven, start_seconds=float(uneven[0]))
    return take if read.seen.all() else replace(take, seen=read.seen)


def page_path(out: Path | None, sources: Sequence[ViewSource], suffix: str = SUFFIX) -> Path:
    """The page's or the film's file: `out`, a name in it if it is a folder, or NAME.view.html (NAME.mp4) here."""
    first = sources[0].beside.name
    stem = first if len(sources) == 1 else f"{first}-and-{len(sources) - 1}-more"
    short = printable(stem).encode(errors="replace")[:LONGEST_STEM_BYTES].decode(errors="ignore")
    name = f"{short or 'motion'}{suffix}"
    if out is None:
        return Path(name)
    return out / name if out.is_dir() else out


def write_view(path: Path, takes: Sequence[Take], stretch: Stretch) -> Viewed:
    """Write the page of takes; raises `MotionkitError`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    title = takes[0].name if len(takes) == 1 else f"{len(takes)} motions"
    parts = [
        f"from {stretch.from_seconds:g} s" if stretch.from_seconds is not None else "",
        f"to {stretch.to_seconds:g} s" if stretch.to_seconds is not None else "",
    ]
    note = " ".join(part for part in ("Shown", *parts) if part) + "." if any(parts) else ""
    return Viewed(path, write_page(path, title, takes, note=note), tuple(takes))


def _instant(seconds: float) -> str:
    return f"{seconds:g} s" if np.isfinite(seconds) else "its end" if seconds > 0 else "its beginning"
