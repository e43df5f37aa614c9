"""Tables of a test's size: what is most of their seconds is done with few motions and clips."""

import pytest

from eval.clip_fid import score
from eval.tables.nerm import table2


def make_tables_small(patch: pytest.MonkeyPatch) -> None:
    """Search few motions for copies and fit clip-FID on few clips; tests/eval knows enough of both."""
    patch.setattr(table2, "MAX_COPIES", 3)
    patch.setattr(score, "FIT_CLIPS", 256)
