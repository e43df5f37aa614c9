"""`motionkit doctor` on a new machine, and on one with a damaged store."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers.outcome import Outcome
from tests.helpers.tiny import write_store

TOPICS = ["python", "packages", "devices", "threads", "disk", "disk", "extras", "store", "runs"]


def test_everything_is_looked_at_and_problems_end_with_1(motionkit: Callable[..., Outcome], tmp_path: Path) -> None:
    places = ("--store", tmp_path / "store", "--runs", tmp_path / "runs")
    new = motionkit("doctor", *places, "--json")
    topics = [each["topic"] for each in json.loads(new.stdout)["findings"]]
    assert [topic for topic in TOPICS if topic not in topics] in ([], ["extras"])
    store = write_store(tmp_path / "store")
    (store / "manifest.json").write_text("{")
    damaged = motionkit("doctor", *places)
    assert damaged.code == 1
    assert f"! store     {store / 'manifest.json'} is damaged" in damaged.stdout


@pytest.mark.parametrize(("chosen", "spins"), [({}, False), ({"OMP_WAIT_POLICY": "ACTIVE"}, True)])
def test_threads_wait_without_spinning_unless_the_environment_says_so(
    tmp_path: Path, chosen: dict[str, str], spins: bool
) -> None:
    others = {name: value for name, value in os.environ.items() if name != "OMP_WAIT_POLICY"}
    command = [sys.executable, "-m", "motionkit", "doctor", "--store", tmp_path / "store", "--runs", tmp_path / "runs"]
    environment = {**others, **chosen, "OMP_DISPLAY_ENV": "VERBOSE"}
    shown = subprocess.run(command, env=environment, capture_output=True, text=True, check=False).stderr
    found = re.search(r"GOMP_SPINCOUNT = '(\d+)'", shown)
    if found is None:
        pytest.skip("torch is not built with GNU's OpenMP, which prints its settings")
    assert (int(found[1]) > 0) == spins
