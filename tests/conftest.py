"""Shared fixtures: real captures are optional; tests that need them skip with a reason."""

import os
import signal
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import jaxtyping
import pytest
from hypothesis import settings

from motionkit.core.errors import MotionkitWarning

# How fast an example runs is the machine's affair, and never a reason to fail. The same examples every time, so that
# what failed fails again; HYPOTHESIS_PROFILE=explore draws new ones.
settings.register_profile("motionkit", deadline=None, derandomize=True)
settings.register_profile("explore", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "motionkit"))


# A shell's background jobs ignore Ctrl-C, and so would all that the tests start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--record-golden", action="store_true", help="Write the losses of the tiny trainings instead of comparing them."
    )


@pytest.fixture(autouse=True)
def own_warnings_are_no_errors() -> None:
    """What motionkit says to people, as of a damaged cache that it makes anew; a test that is about one asks for it."""
    warnings.simplefilter("default", MotionkitWarning)


@pytest.fixture
def unchecked_annotations() -> Iterator[None]:
    """As for users: annotations are checked in tests alone."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture(scope="session")
def captures() -> Path:
    """Folder of the real captures (MOTIONKIT_CAPTURES)."""
    folder = os.environ.get("MOTIONKIT_CAPTURES")
    if not folder or not Path(folder).is_dir():
        pytest.skip("needs real captures: set MOTIONKIT_CAPTURES to their folder")
    return Path(folder)


@pytest.fixture(scope="session")
def golden_humanml3d(captures: Path) -> Path:
    """Folder with the published clip 012314 of HumanML3D: joints, 263-vectors, Mean, Std."""
    folder = captures / "golden" / "humanml3d"
    if not folder.is_dir():
        pytest.skip(f"needs the published HumanML3D clip in {folder}")
    return folder


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], None]:
    """`install(module, source)`: a package with a plugin module, as an installer would leave it."""

    def bring(module: str, source: str) -> None:
        site = tmp_path / f"site-{module}"
        metadata = site / f"{module}-1.0.dist-info"
        metadata.mkdir(parents=True)
        (site / f"{module}.py").write_text(source, encoding="utf-8")
        (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n", encoding="utf-8")
        (metadata / "entry_points.txt").write_text(f"[motionkit.plugins]\n{module} = {module}\n", encoding="utf-8")
        monkeypatch.syspath_prepend(str(site))

    return bring
