"""A motion in a notebook: the player's page in a frame of its own."""

import html

from motionkit.core.errors import MotionkitError
from motionkit.core.motion import Motion
from motionkit.export.player.page import page_of
from motionkit.export.player.takes import packed_bytes, take_of

# A notebook keeps every output that it shows: a minute of 22 joints at 60 fps is about 0.7 MB.
MOST_BYTES = 2_000_000
HEIGHT = 560


def notebook_view(motion: Motion) -> str:
    """HTML with the moving skeleton, of a long motion its beginning; where nothing can be drawn, why."""
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
