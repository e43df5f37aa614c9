"""`motionkit --version`, alone and with everything that a report of a problem needs."""

from collections.abc import Callable

from motionkit.core import __version__
from tests.helpers.outcome import Outcome


def test_versions(motionkit: Callable[..., Outcome]) -> None:
    assert motionkit("--version").stdout == f"motionkit {__version__}\n"
    verbose = motionkit("--version", "--verbose")
    assert verbose.code == 0
    topics = {line.split()[0] for line in verbose.stdout.splitlines()}
    assert {"motionkit", "python", "torch", "threads", "extra"} <= topics
