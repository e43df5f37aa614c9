"""Table 2's rows: a model that is the real motion reaches the floor; one that is known at 20 fps does not."""

from collections.abc import Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eval.clip_fid import score
from eval.clip_fid.score import Protocol
from eval.report.results import Result
from eval.sets.motions import VARIANT_NOTES
from eval.sets.sets import RowId, Variant
from eval.tables import systems
from eval.tables.nerm import table2
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import rest_positions
from motionkit.fields.detail import fit_detail
from motionkit.fields.interpolation import interpolate
from motionkit.fields.motion_field import to_motion
from motionkit.generate.models import GenerationRequest
from motionkit.training.run import RunError
from tests.helpers.analytic import capture
from tests.helpers.scripted_model import PosesAt, ScriptedModel, install_models, trained_run
from tests.helpers.table_request import rows_of, table_request, write_takes

FPS = (Fraction(20), Fraction(60))
NERM, NERM_SLERP = "NeRM", "NeRM generated at 20 fps, SLERP"


def positions_at(times_seconds: np.ndarray, seed: int) -> np.ndarray:
    """A swinging, walking body as a function of time."""
    rng = np.random.default_rng(seed)
    rate, phase = rng.uniform(0.5, 6, (22, 3)), rng.uniform(0, 6, (22, 3))
    time = times_seconds[:, None, None]
    path = np.array([rng.normal(), 0.0, rng.normal()])
    return (rest_positions(SMPL22) + 0.05 * np.sin(2 * np.pi * rate * time + phase) + path * time).astype(np.float32)


def truth(request: GenerationRequest, chance: tuple[int, int]) -> PosesAt:
    """A model that knows every take by its caption."""
    return partial(positions_at, seed=int(request.text))


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    takes = (positions_at(np.arange(300) / 60, seed) for seed in range(24))
    return write_takes(tmp_path_factory.mktemp("table2") / "store", takes, Fraction(60), ("train", "test"))


@pytest.fixture(autouse=True)
def few_clips_and_copies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(score, "FIT_CLIPS", 1000)
    monkeypatch.setattr(table2, "MAX_COPIES", 3)


def build(store: Path, folder: Path, **changes: object) -> Result:
    protocol = Protocol(num_clips=400, replications=2, detailed_replications=1, resamplings=50)
    values: dict[str, object] = {"fps": FPS, "protocol": protocol, "features": ("kinematic",)} | changes
    return table2.TABLE.build(table_request(store, folder, **values))


def test_a_model_that_is_the_real_motion_reaches_the_floor(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install_models(monkeypatch, lambda run: ScriptedModel(truth))
    result = build(store, tmp_path, run=trained_run(tmp_path / "run"))
    rows = rows_of(result)
    floor = rows[str(systems.P1)]
    for column in ("20 fps", "60 fps"):
        assert rows[NERM][column] < 2 * floor[column]
    assert rows[NERM_SLERP]["60 fps"] > 3 * floor["60 fps"]
    assert rows[NERM_SLERP]["60 fps"] == pytest.approx(rows[str(systems.SLERP)]["60 fps"], rel=0.3)
    assert not result.missing
    copied = next(block for block in result.blocks if block.title == table2.COPIES)
    assert [row.name for row in copied.rows] == [str(table2.HELD_OUT), NERM]
    assert result.provenance["run"] == "run"
    assert len(set(result.blocks[0].provenance["fingerprints"].values())) == 2


def test_generations_of_a_model_count_as_its_motions_and_rows_are_compared(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install_models(monkeypatch, lambda run: ScriptedModel(truth))
    scores, differences, *_ = build(store, tmp_path, run=trained_run(tmp_path / "run"), draws=2).blocks
    row = next(row for row in scores.rows if row.name == NERM)
    assert [(cell.details["motions"], cell.details["takes"]) for cell in row.cells.values()] == [(24, 12)] * 2
    assert "a covariance is singular" in scores.note
    told = {row.name: row for row in differences.rows}
    assert "better: 60 fps" in told[f"{NERM} − {systems.SLERP}"].note
    assert "not told apart" in told[f"{NERM_SLERP} − {systems.SLERP}"].note
    for row in (systems.TRAINING, systems.TRAINING_CUT):
        training = next(each for each in scores.rows if each.name == str(row))
        assert training.cells["60 fps"].details["takes"] == 12


class Framed(ScriptedModel):
    """A model that generates frames at 20 fps."""

    def generate(self, requests: Sequence[GenerationRequest], **options: Any) -> list[Any]:
        fields = super().generate(requests, **options)
        return [interpolate(to_motion(field, Fraction(20)), "linear") for field in fields]


def test_a_model_of_frames_is_upsampled_as_vectors(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def absent(run: Path) -> ScriptedModel:
        raise RunError("its weights are gone")

    install_models(monkeypatch, lambda run: Framed(truth), absent)
    result = build(store, tmp_path, run=trained_run(tmp_path / "run"))
    rows = rows_of(result)
    vectors, upsampled, planted = (
        str(RowId(NERM, variant)) for variant in (Variant.AS_VECTORS, Variant.UPSAMPLED, Variant.PLANTED)
    )
    assert {NERM, planted, vectors} <= rows.keys() and upsampled not in rows
    # Velocities a frame that are left as they are carry the body three times as far.
    assert rows[vectors]["60 fps"] > rows[NERM]["60 fps"]
    assert "NeRM: its weights are gone" in result.missing


def test_a_run_that_has_learnt_detail_has_a_row_with_it(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install_models(monkeypatch, lambda run: ScriptedModel(truth))
    learnt = fit_detail([capture(Fraction(120), seconds=3.0, noise=0.002).joint_positions])
    monkeypatch.setattr("eval.tables.systems.load_detail", lambda run: learnt)
    run = trained_run(tmp_path / "run")
    (run / "detail").mkdir()
    (run / "detail" / "summary.json").touch()
    result = build(store, tmp_path, run=run)
    rows = rows_of(result)
    standing, fine = (str(RowId(NERM, variant)) for variant in (Variant.PLANTED, Variant.DETAILED))
    assert rows[fine]["20 fps"] == pytest.approx(rows[standing]["20 fps"])
    assert rows[fine]["60 fps"] != pytest.approx(rows[standing]["60 fps"])
    assert VARIANT_NOTES[Variant.DETAILED] in next(row for row in result.blocks[0].rows if row.name == fine).note
    assert fine not in rows_of(build(store, tmp_path, run=trained_run(tmp_path / "other")))
