"""The peers as stages: each learns from a tiny corpus, is loaded as an encoder, and refuses what it cannot take."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from motionkit.core.errors import UsageError
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.edit.encoders import encoder_loader
from motionkit.fields.completion import complete, upsample
from motionkit.fields.motion_field import Observation
from motionkit.training.config import apply_overrides, flatten
from motionkit.training.run import RunFolder
from motionkit.training.stage import Stage, StageContext
from motionkit.training.tensors import CheckpointError, load_tensors
from pahires.recipes import base as pahires_base
from pahires.recipes import nano as pahires_nano
from peers.settings import EdsrConfig
from peers.stages import A_LIIF, DELTA_INTERP, LIIF, LMF, META_SR, TS_FORMER
from tests.helpers.nerm_corpus import analytic_positions
from tests.helpers.tiny import write_store
from tests.helpers.tiny_temporal import TEMPORAL_PEERS

TINY: dict[str, tuple[Stage[Any], Any]] = {
    stage.name: (stage, TEMPORAL_PEERS[stage.name]) for stage in (LIIF, META_SR, A_LIIF, LMF, DELTA_INTERP, TS_FORMER)
}
ON_GRIDS_ONLY = ("liif", "meta-sr", "a-liif", "lmf")


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("peers") / "store"
    write_store(path)
    return path


def train(store: Path, run: str, name: str) -> RunFolder:
    stage, config = TINY[name]
    folder = RunFolder(store.parent / run)
    context = StageContext(store, folder, "tiny", seed=5, device="cpu")
    stage.check(context, config)
    stage.train(context, config)
    return folder


@pytest.fixture(scope="module")
def run(store: Path) -> RunFolder:
    """All six trained into one run."""
    for name in TINY:
        train(store, "run", name)
    return RunFolder(store.parent / "run")


def capture() -> Motion:
    grid = TimeGrid(Fraction(30), 46)
    return Motion(analytic_positions(grid.seconds(), 1), SMPL22, grid)


@pytest.mark.parametrize("name", TINY)
def test_a_tiny_training_learns(run: RunFolder, name: str) -> None:
    metrics = run.stage(name).read_metrics()
    assert [int(line["step"]) for line in metrics] == [50, 60]
    assert metrics[1]["loss"] < 0.9 * metrics[0]["loss"]


@pytest.mark.parametrize("name", ON_GRIDS_ONLY)
def test_a_trained_grid_peer_upsamples_and_refuses_gaps(run: RunFolder, name: str) -> None:
    encoder, motion = encoder_loader(name).load(run.path), capture()
    assert encoder.name == encoder_loader(name).title
    made = upsample(motion, Fraction(60), encoder)
    assert made.num_frames == 91
    np.testing.assert_array_equal(made.joint_positions[::2], motion.joint_positions)
    observed = np.ones(46, bool)
    observed[20:23] = False
    with pytest.raises(
        ValueError, match=r"evenly spaced frames, but the gaps .* from 0\.0333 to 0\.1333 s: use frames of one"
    ):
        complete(motion, encoder, observed=observed)
    # Every 1.2-th real frame: gaps of one and of two frames.
    kept = np.floor(np.arange(38) * 1.2 + 1e-9).astype(int)
    field = encoder.encode(Observation.of(motion).rows(kept))
    assert np.isfinite(field.query(motion.timegrid.seconds()[:45]).joint_positions).all()


@pytest.mark.parametrize("name", ["delta-interp", "ts-former"])
def test_a_trained_inbetweener_fills_a_gap_at_any_framerate(run: RunFolder, name: str) -> None:
    encoder, motion = encoder_loader(name).load(run.path), capture()
    observed = np.ones(46, bool)
    observed[20:28] = False
    made = complete(motion, encoder, observed=observed)
    np.testing.assert_array_equal(made.joint_positions[observed], motion.joint_positions[observed])
    field = encoder.encode(Observation.of(motion, observed))
    finer = field.query(20 / 30 + np.arange(17) / 60.0).joint_positions
    np.testing.assert_allclose(finer[::2][:8], made.joint_positions[20:28], atol=1e-4)


def test_a_training_is_the_same_again_dropout_too(store: Path, run: RunFolder) -> None:
    torch.rand(7)
    again, _ = load_tensors(train(store, "again", "delta-interp").stage("delta-interp").model_path)
    first, _ = load_tensors(run.stage("delta-interp").model_path)
    assert again.keys() == first.keys()
    for key, tensor in first.items():
        torch.testing.assert_close(again[key], tensor, rtol=0, atol=0)


def test_a_run_of_another_peer_is_not_taken_for_this_one(run: RunFolder, tmp_path: Path) -> None:
    wrong = tmp_path / "liif" / "model.safetensors"
    wrong.parent.mkdir()
    wrong.write_bytes(run.stage("lmf").model_path.read_bytes())
    with pytest.raises(CheckpointError, match=r"expected .*'liif'"):
        encoder_loader("liif").load(tmp_path)


@pytest.mark.parametrize("name", ON_GRIDS_ONLY)
def test_grid_peers_refuse_to_be_trained_on_gaps(name: str) -> None:
    stage = TINY[name][0]
    with pytest.raises(
        UsageError, match=r"evenly spaced frames: training\.tasks\.gap and training\.tasks\.scattered must be 0"
    ):
        apply_overrides(stage.recipe("nano"), ["training.tasks.gap=1"])


@pytest.mark.parametrize("name", TINY)
def test_weights_of_curves_are_pa_hires_alone(name: str) -> None:
    with pytest.raises(UsageError, match=r"leave training\.answer\.blended empty"):
        apply_overrides(TINY[name][0].recipe("nano"), ["training.answer.blended=linear"])


def test_recipes_have_published_sizes_and_say_which_width_is_fair() -> None:
    for name, (stage, _) in TINY.items():
        assert (stage.name, stage.in_all) == (name, False)
        assert set(stage.recipes) == {"nano", "base", "paper"}
        if name in ON_GRIDS_ONLY:
            paper = stage.recipe("paper").training.schedule
            assert (paper.epochs, paper.batch_size, paper.learning_rate) == (1000, 16, 1e-4)
            assert (paper.kind, paper.drop, paper.drop_every) == ("steps", 0.5, 0.2)
            for recipe in ("base", "paper"):
                assert stage.recipe(recipe).network.encoder == EdsrConfig(16, 64)
        for recipe, same in (("nano", pahires_nano()), ("base", pahires_base())):
            training = stage.recipe(recipe).training
            # But for rates, for what PA-HiRes alone has, and for what Δ-Interp published.
            kept = {"schedule.learning_rate", "answer.sizing", "answer.blended", "loss.balance_floor"}
            kept |= {"answer.form", "answer.base"} if stage is DELTA_INTERP else set()
            answer, loss = training.answer, training.loss
            assert (answer.sizing, answer.blended, loss.balance_floor) == ("gap", (), 1.0)
            for key, value in flatten(same.training).items():
                if not key.startswith("tasks.") and key not in {"schedule.steps", *kept}:
                    assert flatten(training)[key] == value, (name, recipe, key)
            assert sum(training.tasks.shares) == 1 == max(training.tasks.shares)
            share = np.dot(training.tasks.shares, same.training.tasks.shares) / sum(same.training.tasks.shares)
            steps = 8000 if recipe == "nano" else same.training.schedule.steps
            assert training.schedule.steps == round(steps * share)
            assert (training.tasks.num_frames, training.tasks.num_queries) == (
                same.training.tasks.num_frames,
                same.training.tasks.num_queries,
            )
    for stage in (LMF, A_LIIF):
        assert {recipe: stage.recipe(recipe).network.width for recipe in stage.recipes} == {
            "nano": 64,
            "base": 64,
            "paper": 16,
        }
