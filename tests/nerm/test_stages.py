from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from eval.reconstruction import DISTANCE
from eval.tables.nerm import table4
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.store.writer import StoreWriter
from motionkit.training.config import apply_overrides
from motionkit.training.run import RunError, RunFolder
from motionkit.training.stage import StageContext
from nerm.field import load_field
from nerm.names import LOCAL
from nerm.recipes import NermConfig, demo
from nerm.stages import CODEBOOK, FIELD
from tests.helpers.nerm_corpus import analytic_positions
from tests.helpers.table_request import table_request

TINY = [
    "codebook.schedule.steps=10",
    "codebook.network.width=16",
    "codebook.network.code_dimension=16",
    "codebook.network.num_codes=16",
    "codebook.schedule.batch_size=8",
    "codebook.window_frames=32",
    "field.schedule.steps=40",
    "field.schedule.batch_size=8",
    "field.decoder.width=32",
    "field.decoder.num_layers=3",
    "field.encoder.num_queries=8",
    "field.encoder.num_frequencies=8",
    "field.windows.max_duration_seconds=3",
    "field.windows.stride_seconds=1",
    "field.precision=float32",
]


ROWS = [f"{LOCAL}: {each}" for each in ("training windows, from their μ", "held-out windows, encoded by optimisation")]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("stages") / "store"
    with StoreWriter.create(path) as writer:
        for index, rate in enumerate((120, 30, 60, 120, 120, 30)):
            grid = TimeGrid(Fraction(rate), 4 * rate + 1)
            positions = analytic_positions(grid.seconds(), index % 4)
            split = "test" if index >= 4 else "train"
            writer.add(Motion(positions, SMPL22, grid, split=split, sequence_id=f"walk-{index}"))
    return path


def _config() -> NermConfig:
    return apply_overrides(demo(), TINY)


@pytest.fixture(scope="module")
def run(store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("runs") / "tiny"
    context = StageContext(store, RunFolder(path), "demo", seed=1)
    CODEBOOK.train(context, _config())
    FIELD.train(context, _config())
    return path


def test_both_stages_leave_a_run_that_decodes(run: Path) -> None:
    trained = load_field(run)
    # Two of the four seconds are left after the first window of three: one more window a sequence, and no mirrors.
    assert len(trained.windows) == 4 * 2
    assert trained.max_training_fps == 120
    poses = trained.decode(trained.posterior_mean[:2], np.linspace(0, 3, 7), Fraction(120))
    assert poses.shape == (2, 7, 22, 3)
    summary = RunFolder(run).stage("field").read_summary()
    assert summary["step"] == 40
    assert {"loss", "reconstruction", "kl", "windows", "hours", "wall_seconds"} <= set(summary)
    assert sorted(entry.name for entry in (run / "codebook").iterdir()) == [
        "SHA256SUMS",
        "checkpoint.safetensors",
        "config.json",
        "metrics.jsonl",
        "model.safetensors",
        "summary.json",
    ]


def test_a_field_without_its_codebook_is_explained(store: Path, tmp_path: Path) -> None:
    with pytest.raises(RunError, match="needs the stage codebook"):
        FIELD.train(StageContext(store, RunFolder(tmp_path / "run"), "demo"), _config())


def test_table_4_is_built_from_a_store_and_a_run(store: Path, run: Path, tmp_path: Path) -> None:
    result = table4.TABLE.build(table_request(store, tmp_path, run=run))
    same, everything, paper, mre, paper_mre = result.blocks
    assert [row.name for row in same.rows] == ROWS
    assert set(same.rows[0].cells) == {"20 fps", "40 fps", "60 fps", "100 fps", "120 fps"}
    counts = [everything.rows[0].cells[column].details["windows"] for column in ("20 fps", "40 fps", "120 fps")]
    assert counts == [4.0, 3.0, 2.0]
    assert {row.origin for row in paper.rows} == {"paper"}
    assert paper.rows[-1].cells["20 fps"].value == pytest.approx(16.0)
    assert paper_mre.rows[-1].cells["20 fps"].value == pytest.approx(0.041)
    assert [row.name for row in mre.rows] == ROWS
    for row in mre.rows:
        # No vector is farther than its rms times the root of its 263 numbers.
        assert all(cell.details[DISTANCE] <= cell.value * 263**0.5 for cell in row.cells.values())
