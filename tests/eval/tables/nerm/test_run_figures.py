"""Figures 5 and 8 with several systems: one that fails or is absent is named, and the others have their rows."""

from fractions import Fraction
from pathlib import Path

import pytest

from eval.clip_fid import score
from eval.clip_fid.score import Protocol
from eval.tables.nerm import figures
from eval.tables.table import EvalConfig
from motionkit.core.errors import UsageError
from motionkit.generate.models import GenerationRequest
from motionkit.training.run import RunError
from tests.helpers.nerm_corpus import analytic_positions
from tests.helpers.scripted_model import PosesAt, ScriptedModel, install_models, trained_run
from tests.helpers.table_request import table_request
from tests.helpers.tiny_peers import write_captioned_store


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_captioned_store(tmp_path_factory.mktemp("figures") / "store", held_out=2)


def free(request: GenerationRequest, chance: tuple[int, int]) -> PosesAt:
    return lambda times: analytic_positions(times, chance[1] % 4)


def told(request: GenerationRequest, chance: tuple[int, int]) -> PosesAt:
    if not request.text:
        raise UsageError("it was told nothing")
    return free(request, chance)


class Told(ScriptedModel):
    name, always_conditioned = "Told", True


class Broken(ScriptedModel):  # first, since parts of tables are kept by the stages, which these share
    name = "Broken"


def absent(run: Path) -> ScriptedModel:
    raise RunError("its weights are gone")


def request(store: Path, folder: Path, monkeypatch: pytest.MonkeyPatch, *models: ScriptedModel) -> EvalConfig:
    monkeypatch.setattr(score, "FIT_CLIPS", 400)
    install_models(monkeypatch, *(lambda run, model=model: model for model in models), absent)  # type: ignore[misc]
    protocol = Protocol(num_clips=100, replications=2, detailed_replications=1, resamplings=20)
    run = trained_run(folder / "run")
    return table_request(store, folder / "results", run=run, fps=(Fraction(60),), protocol=protocol)


def test_who_never_learnt_to_do_without_a_condition_is_given_any(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted = request(store, tmp_path, monkeypatch, Broken(told), ScriptedModel(free), Told(told))
    result = figures.FIGURE_5.build(wanted)
    rows = {row.name: row for row in result.blocks[0].rows if row.origin == "ours"}
    assert list(rows) == [f"{name}, unconditional{form}" for name in ("NeRM", "Told") for form in ("", ", planted")]
    assert all(row.cells for row in rows.values())
    assert figures.ANY_CONDITION in rows["Told, unconditional"].note
    assert {"Broken: it was told nothing", "NeRM: its weights are gone"} <= set(result.missing)
    with pytest.raises(RunError, match="Broken: it was told nothing"):
        figures.FIGURE_5.build(request(store, tmp_path / "none", monkeypatch, Broken(told)))
