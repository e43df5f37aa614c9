"""Lists of plugins in place of the installed packages'."""

from typing import Any

import pytest

from motionkit.core import plugins


def install_only(monkeypatch: pytest.MonkeyPatch, **lists: Any) -> None:
    """Let these be all that is installed of their kinds: `STAGES={"walk": STAGE}`."""
    installed = plugins.listed
    monkeypatch.setattr(
        plugins, "listed", lambda kind, foreign=False: [lists[kind]] if kind in lists else installed(kind, foreign)
    )
