"""Progress, warnings and errors: reports to a callback, nothing on the terminal."""

import pickle
import subprocess
import sys

import pytest

from motionkit.core.errors import FormatError
from motionkit.core.progress import Progress, task, tracked


def test_a_task_reports_its_state_after_every_change() -> None:
    reports: list[Progress] = []
    with task(reports.append, "read", note="first") as work:
        work.set_total(5)
        work.advance(3)
        work.note("last")
    assert reports == [
        Progress("read", note="first"),
        Progress("read", 0, 5, "first"),
        Progress("read", 3, 5, "first"),
        Progress("read", 3, 5, "last"),
        Progress("read", 3, 5, "last", finished=True),
    ]


def test_a_task_that_fails_or_is_left_is_finished() -> None:
    reports: list[Progress] = []
    with pytest.raises(KeyError), task(reports.append, "read", 2):
        raise KeyError
    assert [report.finished for report in reports] == [False, True]
    for _ in tracked(reports.append, "read", "ab", 2):
        break
    assert reports[-1] == Progress("read", 0, 2, finished=True)


def test_a_warning_names_the_line_that_led_to_it() -> None:
    code = "from motionkit.core import progress\n\nprogress.warn('a cache is damaged')"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stderr.startswith("<string>:3: MotionkitWarning")


def test_format_errors_survive_the_way_between_processes() -> None:
    error = FormatError("expected 66 numbers, found 65", path="a.bvh", reason="channel-count", line=12, frame=3)
    twin = pickle.loads(pickle.dumps(error))  # noqa: S301
    assert str(twin) == str(error) == "a.bvh, line 12, frame 3: expected 66 numbers, found 65"
    assert twin.reason == "channel-count"
