"""The peers as stages: each learns from a tiny corpus, is loaded as an encoder, and refuses what it cannot take."""

from fractions import Fraction
from pathlib import Path

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
from motionkit.training.config import apply_overrides
from motionkit.training.loop import CheckpointError
from motionkit.training.run import RunFolder, StageContext
from tests.helpers.nerm_corpus import analytic_positions
from tests.helpers.tiny import write_store
from tests.helpers.tiny_temporal import SYSTEMS, TEMPORAL_PEERS

ON_GRIDS_ONLY = ("liif", "meta-sr", "a-liif", "lmf")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """All six trained into one run."""
    torch.set_num_threads(1)
    folder = tmp_path_factory.mktemp("peers")
    write_store(folder / "store")
    run = RunFolder(folder / "run")
    for name, system in SYSTEMS.items():
        context = StageContext(folder / "store", run, "tiny", seed=5, device="cpu")
        system.check(context, TEMPORAL_PEERS[name])
        system.train(context, TEMPORAL_PEERS[name])
    return run


def capture() -> Motion:
    grid = TimeGrid(Fraction(30), 46)
    return Motion(analytic_positions(grid.seconds(), 1), SMPL22, grid)


@pytest.mark.parametrize("name", SYSTEMS)
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


def test_a_run_of_another_peer_is_not_taken_for_this_one(run: RunFolder, tmp_path: Path) -> None:
    wrong = tmp_path / "liif" / "model.safetensors"
    wrong.parent.mkdir()
    wrong.write_bytes(run.stage("lmf").model_path.read_bytes())
    with pytest.raises(CheckpointError, match=r"expected .*'liif'"):
        encoder_loader("liif").load(tmp_path)


@pytest.mark.parametrize("name", SYSTEMS)
def test_weights_of_curves_are_pa_hires_alone(name: str) -> None:
    with pytest.raises(UsageError, match=r"leave training\.answer\.blended empty"):
        apply_overrides(SYSTEMS[name].stage.recipe("nano"), ["training.answer.blended=linear"])
