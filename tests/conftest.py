"""Shared fixtures: real captures are optional; tests that need them skip with a reason."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

# How fast an example runs is the machine's affair, and never a reason to fail. The same examples every time, so that
# what failed fails again; HYPOTHESIS_PROFILE=explore draws new ones.
settings.register_profile("motionkit", deadline=None, derandomize=True)
settings.register_profile("explore", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "motionkit"))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--record-golden", action="store_true", help="Write the losses of the tiny trainings instead of comparing them."
    )


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
