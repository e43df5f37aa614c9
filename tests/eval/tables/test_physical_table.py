"""The physical table: real motion, a model that knows it and samples, with takes, motions and intervals."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from eval.metrics.physical import slide_speed
from eval.metrics.registry import find_metric
from eval.sets.sets import sample_set
from eval.tables.physical import PER_FRAME, TABLE, measured
from motionkit.fields.motion_field import to_motion
from motionkit.generate.models import GenerationRequest
from tests.helpers.analytic import analytic_motion
from tests.helpers.scripted_model import PosesAt, ScriptedModel, install_models, trained_run
from tests.helpers.table_request import table_request, write_takes

SECONDS = 4.0


def performance(seed: int):
    return analytic_motion("walk", SECONDS + 0.1, seed)


def sliding_truth(request: GenerationRequest, chance: tuple[int, int]) -> PosesAt:
    """A model that knows every take by its caption, and lets it drift."""

    def poses_at(times_seconds: np.ndarray) -> np.ndarray:
        positions = performance(int(request.text)).query(times_seconds).joint_positions.copy()
        positions[..., 0] += (0.3 * times_seconds)[:, None].astype(np.float32)
        return positions

    return poses_at


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    takes = (to_motion(performance(seed), Fraction(60)).joint_positions for seed in range(4))
    return write_takes(tmp_path_factory.mktemp("physical") / "store", takes, Fraction(60))


def cells(result, block: int) -> dict[str, dict]:
    return {row.name: dict(row.cells) for row in result.blocks[block].rows}


def test_rows_of_real_motion_and_of_a_model_that_slides(store: Path, tmp_path: Path, monkeypatch) -> None:
    install_models(monkeypatch, lambda run: ScriptedModel(sliding_truth))
    request = table_request(store, tmp_path, run=trained_run(tmp_path / "run"), fps=(Fraction(20), Fraction(60)))
    result = TABLE.build(request)
    detail = result.blocks[-1]
    assert detail.title == "Detail profile, 60 fps" and detail.rows[-1].name == "NeRM, planted"
    ours, differences, published, _, faster = (cells(result, block) for block in range(5))
    assert result.blocks[0].title == "Per second, at 20 fps"
    assert list(published["real"]) == [metric.title for metric in PER_FRAME]
    assert {row.note for row in result.blocks[0].rows} == {"4 takes, 4 motions, 17 s"}
    speed = "Skating speed"
    assert ours["real"][speed].value < 0.03 < 0.2 < ours["NeRM"][speed].value
    assert ours["NeRM"][speed].value == pytest.approx(faster["NeRM"][speed].value, rel=0.05)
    difference = differences["NeRM − real"][speed]
    assert difference.value == pytest.approx(ours["NeRM"][speed].value - ours["real"][speed].value)
    assert result.blocks[1].rows[0].note.startswith("higher: Skating speed, ")
    assert 0 < ours["NeRM"][speed].ci95 < 0.1
    # Only bands of frames that hold 20 Hz have jitter.
    assert "Jitter of 10 to 20 Hz" not in ours["real"] and "Jitter of 10 to 20 Hz" in faster["real"]
    units = {measure.column: measure.unit for measure in result.blocks[0].metrics}
    assert units[speed] == "m/s" and units["PhysDiff Float"] == "mm"


def test_a_mean_weighs_motions_by_their_seconds_and_leaves_out_those_without(store: Path) -> None:
    walking = to_motion(performance(0), Fraction(30)).joint_positions
    drifting = walking.copy()
    drifting[..., 0] += (0.3 * np.arange(len(walking)) / 30.0)[:, None].astype(np.float32)
    hopping = walking.copy()
    hopping[::2, :, 1] += 1.0
    samples = sample_set("x", Fraction(30), [walking, drifting[:61], hopping], ["a", "b", "c"])
    found = measured(samples)
    speeds = found.values["slide_speed"]
    alone = [slide_speed(walking, 30), slide_speed(drifting[:61], 30)]
    assert speeds[:2] == pytest.approx(alone, abs=1e-11) and np.isnan(speeds[2])
    mean = found.mean(find_metric("slide_speed"))
    seconds = np.array([len(walking), 61]) / 30.0
    assert mean.value == pytest.approx(float((speeds[:2] * seconds).sum() / seconds.sum()))
    nothing = measured(samples.select([2]))
    assert nothing.mean(find_metric("slide_speed")) is None
