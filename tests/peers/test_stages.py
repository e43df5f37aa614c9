"""Peers from a store to motion: what they learn from, that they resume, answer, and refuse."""

import os
import shutil
import signal
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch

from motionkit.core.errors import UsageError
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.features import native
from motionkit.fields.motion_field import Observation
from motionkit.fields.resample import upsample
from motionkit.generate.models import GenerationRequest, GenerativeModel, SamplingOptions, load_model
from motionkit.store.reader import Store
from motionkit.training import loop
from motionkit.training.config import apply_overrides
from motionkit.training.loop import step_generator
from motionkit.training.run import RunError, RunFolder, StageContext, loader_named
from peers.motions import MotionCorpus, open_corpus
from tests.helpers.completing import complete
from tests.helpers.nerm_corpus import analytic_positions
from tests.helpers.tiny_peers import STAGES, tiny_config, train_peer, write_captioned_store
from tests.helpers.tiny_temporal import SYSTEMS, TEMPORAL_PEERS

ON_GRIDS_ONLY = ("liif", "meta-sr", "a-liif", "lmf")
MODELS = ("mdm", "mdm-50", "mld", "inr-mlp", "actor", "t2m", "camdm", "flow", "jl2p", "hier", "nemf")
DETERMINISTIC = ("jl2p", "hier")
# How those are sampled that have so many steps.
FEW_STEPS = dict.fromkeys(("mdm", "mdm-50", "mld", "camdm"), SamplingOptions(steps=4))


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_captioned_store(tmp_path_factory.mktemp("generative") / "store")


@pytest.fixture(scope="module")
def run(store: Path) -> Path:
    """All systems trained into one run."""
    torch.set_num_threads(1)
    run = store.parent / "run"
    for name in STAGES:
        train_peer(name, store, run)
    for name, system in SYSTEMS.items():
        context = StageContext(store, RunFolder(run), "tiny", seed=5, device="cpu")
        system.check(context, TEMPORAL_PEERS[name])
        system.train(context, TEMPORAL_PEERS[name])
    return run


@pytest.mark.parametrize("name", ["mdm-50", "mld", "inr-mlp", "t2m"])
def test_an_interrupted_training_equals_an_uninterrupted_one(
    name: str, store: Path, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupting(seed: int, purpose: str, step: int) -> torch.Generator:
        if step == 3:
            os.kill(os.getpid(), signal.SIGINT)
        return step_generator(seed, purpose, step)

    for earlier in STAGES[name].earlier:
        shutil.copytree(run / earlier, tmp_path / earlier)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(loop, "step_generator", interrupting)
        train_peer(name, store, tmp_path)
    train_peer(name, store, tmp_path, resume=True)
    again, whole = (RunFolder(each).stage(name) for each in (tmp_path, run))
    assert again.model_path.read_bytes() == whole.model_path.read_bytes()


def corpus_of(store: Path, **changed: object) -> MotionCorpus:
    config = tiny_config("mdm", **changed)
    return open_corpus(Store.open(store), config.motions, config.conditions, None)


def test_crops_are_vectors_at_the_peers_framerate(store: Path) -> None:
    corpus = corpus_of(store)
    rows = torch.arange(len(corpus))
    batch = corpus.batch(rows, torch.Generator().manual_seed(0), drop=0.0)
    assert set((batch.lengths % 4).tolist()) == {0} and len(set(batch.lengths.tolist())) > 1
    vectors = corpus.scaling.invert(batch.rows)
    for row in range(len(rows)):
        own = int(batch.lengths[row])
        assert not batch.rows[row, own:].any()
        kind, begin = int(batch.conditions.action[row]), corpus.poses.windows.start_seconds[row]
        # Vectors of the whole take at 60 fps, of which a crop is every third.
        whole = native.vectors(analytic_positions(np.arange(241) / 60, kind), "smpl22", Fraction(60))
        starts = np.arange(round(begin * 60), 241 - 3 * (own - 1), 3)
        errors = [np.abs(whole[start : start + 3 * own : 3] - vectors[row, :own].numpy()).max() for start in starts]
        assert min(errors) < 1e-4


@pytest.mark.parametrize("name", MODELS)
def test_a_model_answers_requests(run: Path, name: str) -> None:
    model = load_model(name, run)
    assert isinstance(model, GenerativeModel)
    assert (model.max_training_fps, model.max_duration_seconds) == (Fraction(20), 3.0)
    requests = [GenerationRequest(1.03, action="kind-2"), GenerationRequest(2.0, text="unread", action="kind-1")]
    if model.unconditional:
        with pytest.raises(UsageError, match=r"knows no texts and no actions: ask unconditionally"):
            model.generate(requests, seed=3)
        requests = [GenerationRequest(1.03), GenerationRequest(2.0)]
    requests += [GenerationRequest(None), GenerationRequest(3.0)]
    few = FEW_STEPS.get(name, SamplingOptions())
    fields = model.generate(requests, seed=3, sampling=few)
    assert [field.end_seconds for field in fields[:2]] == [1.03, 2.0]
    alone = model.generate(requests[1:2], seed=3, sampling=few, first=1)[0]
    instants = np.array([0.0, 0.33, 2.0])
    np.testing.assert_allclose(
        alone.query(instants).joint_positions, fields[1].query(instants).joint_positions, atol=1e-4
    )
    other = model.generate(requests[1:2], seed=4, sampling=few, first=1)[0]
    apart = np.abs(alone.query(instants).joint_positions - other.query(instants).joint_positions).max()
    assert apart == 0 if name in DETERMINISTIC else apart > 1e-3


def test_a_model_refuses_what_it_does_not_know(run: Path) -> None:
    model = load_model("mdm-50", run)
    for request, why in (
        (GenerationRequest(3.5), "MDM, 50 steps generates more than 0 and up to 3 s, not 3.5 s"),
        (GenerationRequest(1.0, text="a word"), "was trained without texts"),
        (GenerationRequest(1.0, action="fly"), "knows no action 'fly'; it knows kind-0"),
    ):
        with pytest.raises(UsageError, match=why):
            model.generate([request], seed=0)
    with pytest.raises(UsageError, match=r"51 sampling steps: this model's diffusion has 1 … 50"):
        model.generate([GenerationRequest(1.0)], seed=0, sampling=SamplingOptions(steps=51))


def test_a_denoiser_of_another_vae_is_refused(store: Path, run: Path, tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"stage 'mld-vae' of run .* is not trained"):
        train_peer("mld", store, tmp_path)
    for name in ("mld-vae", "mld"):
        shutil.copytree(run / name, tmp_path / name)
    config = tiny_config("mld", motions=replace(tiny_config("mld").motions, max_frames=40))
    with pytest.raises(RunError, match="mld-vae was trained on other motions"):
        train_peer("mld", store, tmp_path, config)
    (tmp_path / "mld-vae" / "model.safetensors").write_bytes((tmp_path / "mld" / "model.safetensors").read_bytes())
    with pytest.raises(RunError, match="mld-vae was trained again after"):
        load_model("mld", tmp_path)


def test_stages_see_what_their_settings_say(store: Path) -> None:
    rows = torch.arange(8)
    scattered = corpus_of(store, motions=tiny_config("inr-mlp").motions)
    batch = scattered.batch(rows, torch.Generator().manual_seed(0), drop=0.0)
    assert batch.rows.shape == (8, 5, 66) and batch.mask.all()
    assert int(batch.frames.min()) >= 0 and bool((batch.frames <= torch.from_numpy(scattered.last_tick)[:, None]).all())
    # Frames of whole windows: the same numbers are the same poses, whenever they are drawn.
    again = scattered.batch(rows, torch.Generator().manual_seed(1), drop=0.0)
    row, one, other = (batch.frames[:, :, None] == again.frames[:, None]).nonzero(as_tuple=True)
    assert len(row) and torch.equal(batch.rows[row, one], again.rows[row, other])
    stretches = corpus_of(store, motions=tiny_config("camdm").motions)
    batch = stretches.batch(rows, torch.Generator().manual_seed(0), drop=0.0)
    assert batch.rows.shape == (8, 16, 263) and (batch.lengths == 16).all()
    assert (batch.frames.diff(dim=1) == 1).all() and len(set(batch.frames[:, 0].tolist())) > 3


def capture() -> Motion:
    grid = TimeGrid(Fraction(30), 46)
    return Motion(analytic_positions(grid.seconds(), 1), SMPL22, grid)


@pytest.mark.parametrize("name", ON_GRIDS_ONLY)
def test_a_trained_grid_peer_upsamples_and_refuses_gaps(run: Path, name: str) -> None:
    encoder, motion = loader_named("ENCODERS", name).load(run), capture()
    assert encoder.name == loader_named("ENCODERS", name).title
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
def test_a_trained_inbetweener_fills_a_gap_at_any_framerate(run: Path, name: str) -> None:
    encoder, motion = loader_named("ENCODERS", name).load(run), capture()
    observed = np.ones(46, bool)
    observed[20:28] = False
    made = complete(motion, encoder, observed=observed)
    np.testing.assert_array_equal(made.joint_positions[observed], motion.joint_positions[observed])
    field = encoder.encode(Observation.of(motion, observed))
    finer = field.query(20 / 30 + np.arange(17) / 60.0).joint_positions
    np.testing.assert_allclose(finer[::2][:8], made.joint_positions[20:28], atol=1e-4)


@pytest.mark.parametrize("name", SYSTEMS)
def test_weights_of_curves_are_pa_hires_alone(name: str) -> None:
    with pytest.raises(UsageError, match=r"leave training\.answer\.blended empty"):
        apply_overrides(SYSTEMS[name].stage.configured("nano"), ["training.answer.blended=linear"])
