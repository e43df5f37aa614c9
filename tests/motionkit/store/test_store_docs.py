"""docs/store.md: its columns are the files' columns, and its example reads the frames that motionkit reads."""

import re
from dataclasses import replace

import numpy as np
import pytest

from motionkit.store import Store
from motionkit.store.schema import SEGMENTS, SEQUENCES
from tests.helpers.repository import REPOSITORY

PAGE = REPOSITORY / "docs" / "store.md"


@pytest.mark.parametrize(
    ("heading", "schema"), [("## sequences.parquet", SEQUENCES), ("## segments/part-NNNNN.parquet", SEGMENTS)]
)
def test_the_tables_name_every_column(heading, schema):
    section = PAGE.read_text(encoding="utf-8").split(heading)[1].split("\n## ")[0]
    first_cells = re.findall(r"^\| (`[^|]*) \|", section, re.MULTILINE)
    assert re.findall(r"`(\w+)`", " ".join(first_cells)) == schema.names


def test_the_example_in_python_runs(small_store, monkeypatch):
    (example,) = re.findall(r"## In Python\n\n```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    monkeypatch.chdir(small_store.parent)
    motion = replace(Store.open(small_store).read(3), sequence_id="cmu/asfamc/01/01_01", split="train")
    cache_rows = {"sequence": np.zeros(4, np.int64), "start_frame": np.zeros(4, np.int64)}
    names: dict[str, object] = {"motion": motion, **cache_rows}
    exec(example, names)
    assert len(names["store"]) == 7 and "cmu/asfamc/01/01_01" in names["store"]


def test_the_example_reads_the_frames(small_store, monkeypatch):
    (example,) = re.findall(
        r"## Reading it without motionkit\n\n```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL
    )
    assert small_store.name == "store"
    monkeypatch.chdir(small_store.parent)
    names: dict[str, object] = {}
    exec(example.replace("sequence_index = 7", "sequence_index = 3"), names)
    assert len(names["sequences"]) == 6
    np.testing.assert_array_equal(names["positions"], Store.open(small_store).read(3).joint_positions)
