from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch

from eval.tables.nerm import reconstruction
from eval.tables.nerm.reconstruction import DISTANCE
from motionkit.store.reader import Store
from motionkit.training.run import RunError, RunFolder, StageContext
from nerm.denoiser import corpus_of
from nerm.model import load_field
from nerm.recipes import FIELD, LOCAL
from tests.helpers.table_request import table_request
from tests.helpers.tiny import NERM, STEPS, train_stage, write_store

ROWS = [f"{LOCAL}: {each}" for each in ("training windows, from their μ", "held-out windows, encoded by optimisation")]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_store(tmp_path_factory.mktemp("stages") / "store")


@pytest.fixture(scope="module")
def run(store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("runs") / "tiny"
    for stage in ("codebook", "field"):
        train_stage(stage, store, path)
    return path


def test_both_stages_leave_a_run_that_decodes(run: Path) -> None:
    trained = load_field(run)
    # Two of the four seconds are left after the first window of three: one more window a sequence, and no mirrors.
    assert len(trained.windows) == 4 * 2
    assert trained.max_training_fps == 120
    poses = trained.poses(trained.posterior_mean[1], np.linspace(0, 3, 7), Fraction(120))
    assert poses.joint_positions.shape == (7, 22, 3)
    summary = RunFolder(run).stage("field").read_summary()
    assert summary["step"] == STEPS
    assert {"loss", "reconstruction", "kl", "windows", "hours", "wall_seconds"} <= set(summary)


def test_a_field_without_its_codebook_is_explained(store: Path, tmp_path: Path) -> None:
    with pytest.raises(RunError, match="needs the stage codebook"):
        FIELD.train(StageContext(store, RunFolder(tmp_path / "run"), "tiny"), NERM)


def test_table_4_is_built_from_a_store_and_a_run(store: Path, run: Path, tmp_path: Path) -> None:
    result = reconstruction.TABLE_4.build(table_request(store, tmp_path, run=run))
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


def test_the_denoiser_learns_variations_and_draws_each_caption_equally_often(
    store: Path, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    field, opened, settings = load_field(run), Store.open(store), replace(NERM.denoiser, variations=2, balanced=True)
    plain = corpus_of(field, opened, None, NERM.denoiser, 0)
    assert plain.weights is None
    # Four motions do not hold their variations: all are left out.
    assert torch.equal(corpus_of(field, opened, None, settings, 0).means, plain.means)
    monkeypatch.setattr("nerm.denoiser.FARTHEST", np.inf)
    corpus = corpus_of(field, opened, None, settings, 0)
    count = len(plain.means)
    assert torch.equal(corpus.means[:count], plain.means) and corpus.weights is not None
    assert {3 * count} == {len(corpus.means), len(corpus.log_variances), len(corpus.weights)}
    shares = torch.zeros(len(corpus.conditions.sizes.actions)).index_add(0, corpus.conditions.action, corpus.weights)
    torch.testing.assert_close(shares, torch.ones_like(shares))
