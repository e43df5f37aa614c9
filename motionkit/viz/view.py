"""Pages of moving motions: of files, of motions in memory, and in notebooks (docs/view.md)."""

import html
import webbrowser
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motionkit.core.errors import MotionkitError, UsageError, describe, printable
from motionkit.core.files import write_whole
from motionkit.core.motion import Motion
from motionkit.core.progress import warn
from motionkit.edit.motions import MotionSource, find_motions
from motionkit.io.files import existing_path
from motionkit.io.registry import ReadOptions
from motionkit.viz import MOST_MOTIONS
from motionkit.viz.player import Panel, check_places, packed_bytes, page_of, panel_of

PAGE_SUFFIX = ".view.html"
# Names combined from many files may exceed the system's limit, which is in bytes.
LONGEST_STEM_BYTES = 160
# A notebook keeps every output that it shows: a minute of 22 joints at 60 fps is about 0.7 MB.
MOST_NOTEBOOK_BYTES, NOTEBOOK_HEIGHT = 2_000_000, 560


def view(*motions: Motion | str | Path, path: str | Path | None = None, open: bool = False) -> Path:
    """Write a page on which motions move side by side, each at its native framerate, and return its path.

    `motions` are motions, files, or folders of files. The page is one file that loads nothing from elsewhere: open it
    in any browser, or `open` it in the one of this machine. It is written to `path` (a file, or a folder), by default
    to NAME.view.html in the current folder; an existing page is replaced. What cannot be shown is left out with a
    warning. Raises `UsageError` for no motion and for more than 24, `MotionkitError` where none can be shown.

    >>> motion = mk.read("walk.bvh")
    >>> mk.view(motion, motion.resample(24), path="compared.html").name
    'compared.html'
    """
    sources: list[MotionSource] = []
    problems: list[str] = []
    for motion in motions:
        if isinstance(motion, Motion):
            sources.append(MotionSource.of(motion))
            continue
        named = existing_path(motion)
        more, failed = find_motions([str(named)], ReadOptions(), named)
        sources += more
        problems += map(str, failed)
    if len(sources) > MOST_MOTIONS or not motions:
        raise UsageError(f"a page shows 1 to {MOST_MOTIONS} motions, not {len(sources):,}")
    panels, failures = read_panels(sources, Interval(), lambda: None)
    problems += [message if name in message else f"{name}: {message}" for name, message in failures]
    if not panels:
        raise MotionkitError("; ".join(problems))
    for problem in problems:
        warn(problem)
    written = page_path(None if path is None else Path(path), sources)
    write_view(written, panels, Interval())
    if open:
        webbrowser.open(written.absolute().as_uri())
    return written


def notebook_view(motion: Motion) -> str:
    """HTML with the moving skeleton, of the beginning for a long motion; the reason if nothing can be drawn.

    Notebooks call it for a motion that a cell ends with.

    >>> mk.notebook_view(mk.read("walk.bvh"))[:7]
    '<iframe'
    """
    num_frames = max(1, min(motion.num_frames, MOST_NOTEBOOK_BYTES // packed_bytes(1, motion.skeleton.num_joints)))
    panel = panel_of(motion, motion.sequence_id or "motion").frames(0, num_frames)
    note = f"Shown: the first {panel.duration_seconds:.4g} of {motion.duration_seconds:.4g} s."
    try:
        page = page_of(panel.name, [panel], note=note if num_frames < motion.num_frames else "")
    except MotionkitError as error:
        return f"<pre>{html.escape(f'{motion!r}: {error}')}</pre>"
    # Scripts run in an origin of their own, from which they reach nothing of the notebook.
    inside = page.replace("&", "&amp;").replace('"', "&quot;")
    return (
        f'<iframe title="{html.escape(panel.name)}" srcdoc="{inside}" sandbox="allow-scripts" '
        f'style="width: 100%; height: {NOTEBOOK_HEIGHT}px; border: 0"></iframe>'
    )


@dataclass(frozen=True)
class Interval:
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

    def of(self, panel: Panel) -> Panel:
        """The frames inside; raises `MotionkitError` if there are none."""
        begin = -np.inf if self.from_seconds is None else self.from_seconds
        end = np.inf if self.to_seconds is None else self.to_seconds
        seconds = panel.frame_seconds()
        first, stop = np.searchsorted(seconds, (begin - 1e-6, end - 1e-6)).tolist()
        if first >= stop:
            raise MotionkitError(f"it has no frame{self}: its frames are at {seconds[0]:g} to {seconds[-1]:.6g} s")
        return panel.frames(first, stop)

    def __str__(self) -> str:
        begin = "" if self.from_seconds is None else f" from {self.from_seconds:g} s"
        return begin + ("" if self.to_seconds is None else f" to {self.to_seconds:g} s")


def spread(sources: Sequence[MotionSource], limit: int) -> list[MotionSource]:
    """At most `limit` sources in order: stored ones of unlike framerate, source and action, of others the first."""
    of_kind: dict[tuple[str, ...], deque[int]] = {}
    for number, source in enumerate(sources):
        of_kind.setdefault(source.kind, deque()).append(number)
    chosen: list[int] = []
    uses: Counter[tuple[int, str]] = Counter()
    while len(chosen) < min(limit, len(sources)):
        kind = min(of_kind, key=lambda kind: sum(uses[pair] for pair in enumerate(kind)))
        chosen.append(of_kind[kind].popleft())
        uses.update(enumerate(kind))
        if not of_kind[kind]:
            del of_kind[kind]
    return [sources[number] for number in sorted(chosen)]


def read_panels(
    sources: Sequence[MotionSource], interval: Interval, advance: Callable[[], None]
) -> tuple[list[Panel], list[tuple[str, str]]]:
    """The panels of sources, and name and message of each that cannot be shown."""
    panels: list[Panel] = []
    failures: list[tuple[str, str]] = []
    # File names without folders, if these are unique.
    are_unique = len({source.short_name for source in sources}) == len(sources)
    for source in sources:
        try:
            panel = interval.of(source.load().panel(source.short_name if are_unique else source.name))
            check_places(panel)
        except (MotionkitError, OSError) as error:
            failures.append((source.name, describe(error)))
        else:
            panels.append(panel)
        advance()
    return panels, failures


def page_path(out: Path | None, sources: Sequence[MotionSource], suffix: str = PAGE_SUFFIX) -> Path:
    """The page's or the film's file: `out`, a name in it if it is a folder, or NAME.view.html (NAME.mp4) here."""
    first = sources[0].beside.name
    stem = first if len(sources) == 1 else f"{first}-and-{len(sources) - 1}-more"
    short = printable(stem).encode(errors="replace")[:LONGEST_STEM_BYTES].decode(errors="ignore")
    name = f"{short or 'motion'}{suffix}"
    if out is None:
        return Path(name)
    return out / name if out.is_dir() else out


def write_view(path: Path, panels: Sequence[Panel], interval: Interval) -> None:
    """Write the page of panels; raises `MotionkitError`."""
    title = panels[0].name if len(panels) == 1 else f"{len(panels)} motions"
    write_whole(path, page_of(title, panels, note=f"Shown{interval}." if str(interval) else ""))
