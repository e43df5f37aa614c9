"""`motionkit doctor` on a new machine, and on one with a damaged store."""

import json
from collections.abc import Callable
from pathlib import Path

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
