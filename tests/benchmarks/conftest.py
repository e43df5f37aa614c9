"""One server of commands for all drills: each would import everything anew."""

from collections.abc import Iterator

import pytest

from benchmarks.trust.process import Commands


@pytest.fixture(scope="session")
def commands() -> Iterator[Commands]:
    with Commands() as running:
        yield running
