"""Table 3's rows: a model that does as it is told scores like real motion, one that doesn't scores nothing."""

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from eval.actions.published import StgcnNetwork
from eval.actions.sets import with_rotations
from eval.report.results import Result, to_markdown
from eval.sets.sets import sample_set
from eval.tables.nerm import table3
from eval.text_motion.guo import GuoFiles
from motionkit.core import kinematics
from motionkit.core.errors import UsageError
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.generate.models import GenerationRequest, SamplingOptions
from motionkit.io import uestc
from motionkit.io.smpl_body import SMPL
from motionkit.store.reader import Store
from motionkit.store.writer import StoreWriter
from tests.helpers.acting import ACTIONS, acted, acted_at
from tests.helpers.scripted_model import PosesAt, ScriptedModel, install_models, trained_run
from tests.helpers.table_request import rows_of, table_request

EACH = 12
FPS = Fraction(20)


def actor(*, obeys: bool = True) -> ScriptedModel:
    """Does what it is told, or always the action after it."""

    def act(request: GenerationRequest, chance: tuple[int, int]) -> PosesAt:
        # The store spells its actions in its own way; a model knows them as the store does.
        place = [spelt(action) for action in ACTIONS].index(request.action) + (not obeys)
        return partial(acted_at, action=ACTIONS[place % 3], seed=10_000 * (chance[0] + 1) + chance[1])

    return ScriptedModel(act, max_duration_seconds=2.0)


def knows_nothing(request: GenerationRequest, chance: tuple[int, int]) -> PosesAt:
    raise UsageError(f"the model knows no action {request.action!r}")


def spelt(action: str) -> str:
    return action.replace(" ", "_").title()


def write_store(path: Path, splits: Sequence[str] = ("train", "test")) -> Path:
    with StoreWriter.create(path) as writer:
        for seed in range(EACH * 3 * len(splits)):
            action, frames = ACTIONS[seed % 3], 30 + 10 * (seed % 4)
            grid = TimeGrid(FPS, frames)
            motion = Motion(acted(action, seed, frames), SMPL22, grid, action=spelt(action))
            writer.add(replace(motion, split=splits[seed % len(splits)], sequence_id=f"{seed:03d}"))
        odd = Motion(acted("nod", 1, 40), SMPL22, TimeGrid(FPS, 40), action="yawn", split=splits[-1], sequence_id="odd")
        writer.add(odd)
    return path


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_store(tmp_path_factory.mktemp("table3") / "store")


def build(store: Path, folder: Path, **changes: object) -> Result:
    return table3.TABLE.build(table_request(store, folder, **changes))


def with_model(monkeypatch: pytest.MonkeyPatch, folder: Path, model: ScriptedModel) -> Path:
    install_models(monkeypatch, lambda run: model)
    return trained_run(folder / "runs" / "nano")


def test_a_model_that_obeys_scores_like_real_motion(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = with_model(monkeypatch, tmp_path, actor())
    result = build(store, tmp_path, run=run, published="native,a2m,actor", draws=2)
    titles = [block.title.split(" (")[0] for block in result.blocks]
    scored = [rows for index in range(len(titles)) if "real (test)" in (rows := rows_of(result, index))]
    assert len(scored) == 3
    for rows in scored:
        assert set(rows) == {"real (test)", "NeRM", "NeRM, planted"}
        real, model = rows["real (test)"], rows["NeRM"]
        assert real["Accuracy"] > 0.9 and model["Accuracy"] > 0.9
        assert set(real) == {"FID (train)", "Accuracy", "Diversity", "MultiModality"}
        assert model["FID (test)"] < 10 and 0.5 < model["Diversity"] / real["Diversity"] < 2
    assert result.blocks[0].rows[1].cells["FID (test)"].ci95 is not None
    assert result.blocks[0].rows[0].cells["Accuracy"].ci95 is None
    assert any("yawn (1)" in line for line in result.missing)
    by_action = {row.name: row for row in result.blocks[titles.index("Accuracy by action")].rows}
    assert set(by_action) == {"Nod (12)", "Shuffle_Left (12)", "Shuffle_Right (12)"}
    assert titles[-2:] == ["Printed in the NeRM paper for UESTC", "Printed in the NeRM paper for HumanAct12"]
    text = to_markdown(result)
    assert "protocol 'a2m' counts 3,000 motions, here are 36" in text and "1.96 · variance" in text


def test_a_model_that_does_something_else_is_found_out(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = rows_of(build(store, tmp_path, run=with_model(monkeypatch, tmp_path, actor(obeys=False))))
    # All actions are still there, each under another's name: FID cannot see it.
    assert rows["NeRM"]["Accuracy"] < 0.1 and rows["NeRM"]["FID (test)"] < 10


class Choosy(ScriptedModel):
    """Says before it begins that it does not know the last action."""

    name = "Choosy"

    def check(self, request: GenerationRequest, sampling: SamplingOptions = SamplingOptions()) -> None:
        if request.action == spelt(ACTIONS[2]):
            raise UsageError(f"no {request.action}")


class Deaf(ScriptedModel):
    """Knows no conditions, and says so."""

    name, unconditional = "Deaf", True


def test_models_are_asked_for_what_all_of_them_know(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nods(request: GenerationRequest, chance: tuple[int, int]) -> PosesAt:
        assert not request.action
        return partial(acted_at, action="nod", seed=chance[1])

    made = (actor(), Choosy(actor().script, 2.0), Deaf(nods, 2.0))
    install_models(monkeypatch, *(lambda run, model=model: model for model in made))  # type: ignore[misc]
    result = build(store, tmp_path, run=trained_run(tmp_path / "runs" / "nano"))
    rows = rows_of(result)
    assert {model.asked for model in made} == {24}
    assert min(rows[name]["Accuracy"] for name in ("NeRM", "Choosy")) > 0.9 and rows["Deaf"]["Accuracy"] == 0.5
    assert f"Choosy knows no {spelt(ACTIONS[2])}: no model is asked for that" in result.missing


def test_samples_of_another_system_are_a_row(store: Path, tmp_path: Path) -> None:
    folder = tmp_path / "theirs"
    folder.mkdir()
    lines = ["file,action"]
    for index in range(9):
        np.save(folder / f"{index}.npy", acted(ACTIONS[index % 3], 777 + index))
        lines.append(f"{index}.npy,{ACTIONS[index % 3]}")
    (folder / "actions.csv").write_text("\n".join(lines) + "\n")
    (folder / "samples.toml").write_text("fps = 20\n")
    assert rows_of(build(store, tmp_path, samples={"theirs": folder}))["theirs"]["Accuracy"] > 0.8
    (folder / "actions.csv").unlink()
    without = build(store, tmp_path, samples={"theirs": folder})
    assert "theirs" not in rows_of(without)
    assert any("theirs: --samples theirs: 9 of 9 motions have no action" in line for line in without.missing)


def test_what_cannot_be_scored_is_said(store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = build(store, tmp_path, run=tmp_path / "nowhere")
    assert any("there is no run" in line for line in result.missing)
    run = with_model(monkeypatch, tmp_path, ScriptedModel(knows_nothing))
    assert any("the model knows no action" in line for line in build(store, tmp_path, run=run).missing)
    for changes, message in (
        ({"features": ("best",)}, "no recogniser of actions 'best'"),
        ({"features": ("linear", "uestc")}, "one recogniser"),
        ({"published": "t2m"}, "no action protocol 't2m'"),
        ({"features": ("humanact12",)}, "needs the file of its weights"),
        ({"guo": GuoFiles(tmp_path / "some.tar")}, "--weights"),
    ):
        with pytest.raises(UsageError, match=message):
            build(store, tmp_path, **changes)
    untrained = write_store(tmp_path / "untrained", ("test",))
    with pytest.raises(UsageError, match="has no training split, and 'linear' is fitted on one"):
        build(untrained, tmp_path)


def turning(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=(1, 24, 3)) + 0.02 * rng.normal(size=(90, 24, 3)).cumsum(axis=0)
    return kinematics.rotation_vector_to_quaternion(vectors.astype(np.float32))


def test_rotations_come_from_the_store_at_the_recognisers_framerate(tmp_path: Path) -> None:
    body = SMPL.skeleton("smpl", np.concatenate((SMPL22.offsets.cumsum(axis=0), np.ones((2, 3)))))
    with StoreWriter.create(tmp_path / "store") as writer:
        for index in range(8):
            rotations, root, grid = (
                turning(index),
                np.zeros((90, 3), np.float32),
                TimeGrid(Fraction(60 - index % 2 * 30), 90),
            )
            motion = Motion(kinematics.forward_kinematics(rotations, root, body), body, grid, rotations, root)
            split = ("train", "test")[index // 2 % 2]
            writer.add(replace(motion, action=uestc.ACTIONS[index // 4], split=split, sequence_id=str(index)))
    store = Store.open(tmp_path / "store")
    frames = [np.zeros((count, 22, 3), np.float32) for count in (45, 90)]
    found = with_rotations(store, sample_set("two", Fraction(30), frames, ["0", "1"])).local_rotations
    assert found is not None and found.shape == (135, 24, 4)
    np.testing.assert_allclose(np.abs((found[:45] * turning(0)[::2]).sum(-1)), 1.0, atol=1e-3)
    np.testing.assert_allclose(np.abs((found[45:] * turning(1)).sum(-1)), 1.0, atol=1e-4)
    torch.manual_seed(0)
    torch.save(StgcnNetwork(SMPL.parents, 6, 40).state_dict(), tmp_path / "uestc.tar")
    result = build(store.path, tmp_path, features=("uestc",), guo=GuoFiles(tmp_path / "uestc.tar"))
    assert set(rows_of(result)["real (test)"]) == {"FID (train)", "Accuracy", "Diversity", "MultiModality"}
    assert [block.title[:40] for block in result.blocks[2:]] == ["Printed in the NeRM paper for UESTC (Wei"]
