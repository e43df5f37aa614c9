"""`motionkit.viz.view`: a page of motions in memory or in files; and the display in notebooks."""

import html
import webbrowser
from pathlib import Path

from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.motion import Motion
from motionkit.core.progress import warn
from motionkit.io.registry import ReadOptions
from motionkit.store.named_motions.holes import ReadClip
from motionkit.store.named_motions.reading import FoundMotion, existing_path
from motionkit.viz.player.page import page_of
from motionkit.viz.player.takes import packed_bytes, take_of
from motionkit.viz.view import MOST_MOTIONS
from motionkit.viz.view.job import Stretch, ViewSource, find_sources, page_path, read_takes, write_view


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
    sources: list[ViewSource] = []
    problems: list[str] = []
    for motion in motions:
        if isinstance(motion, Motion):
            sources.append(_in_memory(motion))
            continue
        named = existing_path(motion)
        found, failed = find_sources([str(named)], ReadOptions(), named)
        sources += found
        problems += map(str, failed)
    if len(sources) > MOST_MOTIONS or not motions:
        raise UsageError(f"a page shows 1 to {MOST_MOTIONS} motions, not {len(sources):,}")
    takes, failures = read_takes(sources, Stretch(), lambda: None)
    problems += [message if name in message else f"{name}: {message}" for name, message in failures]
    if not takes:
        raise MotionkitError("; ".join(problems))
    for problem in problems:
        warn(problem)
    written = write_view(page_path(None if path is None else Path(path), sources), takes, Stretch()).path
    if open:
        webbrowser.open(written.absolute().as_uri())
    return written


def _in_memory(motion: Motion) -> ViewSource:
    name = motion.sequence_id or "motion"
    beside = Path(name.replace("/", "_").lstrip(".") or "motion")
    return FoundMotion(name, name, beside, lambda: ReadClip.whole(motion))


# A notebook keeps every output that it shows: a minute of 22 joints at 60 fps is about 0.7 MB.
MOST_BYTES = 2_000_000
HEIGHT = 560


def notebook_view(motion: Motion) -> str:
    """HTML with the moving skeleton, of the beginning for a long motion; the reason if nothing can be drawn."""
    num_frames = max(1, min(motion.num_frames, MOST_BYTES // packed_bytes(1, motion.skeleton.num_joints)))
    take = take_of(motion, motion.sequence_id or "motion").frames(0, num_frames)
    shown = f"Shown: the first {take.duration_seconds:.4g} of {motion.duration_seconds:.4g} s."
    try:
        page = page_of(take.name, [take], note=shown if num_frames < motion.num_frames else "")
    except MotionkitError as error:
        return f"<pre>{html.escape(f'{motion!r}: {error}')}</pre>"
    # Scripts run in an origin of their own, from which they reach nothing of the notebook.
    inside = page.replace("&", "&amp;").replace('"', "&quot;")
    return (
        f'<iframe title="{html.escape(take.name)}" srcdoc="{inside}" sandbox="allow-scripts" '
        f'style="width: 100%; height: {HEIGHT}px; border: 0"></iframe>'
    )
