"""The TMR-style evaluator from store to retrieval: it learns which caption is whose, if one is."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch

from eval.metrics.retrieval import retrieval
from eval.native_evaluator.evaluator import load_tmr
from eval.native_evaluator.settings import TmrConfig, TmrTrainingConfig
from eval.native_evaluator.stage import train_tmr
from eval.native_evaluator.training import retrieval_loss
from eval.sets.sets import SampleSet, sample_set
from eval.text_motion.evaluator import TextMotionEvaluator
from motionkit.core.errors import UsageError
from motionkit.core.motion import Caption, Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.store import StoreWriter
from motionkit.training.loop import CheckpointError
from motionkit.training.run import RunFolder, StageContext
from tests.eval.native_evaluator.test_native_evaluator import HashEncoder, swinging

KINDS = 12
CONFIG = TmrConfig(
    training=TmrTrainingConfig(
        steps=60,
        batch_size=48,
        framerates=(20.0,),
        max_seconds=2.0,
        max_poses=40,
        statistics_batches=2,
        same_above=0.99,
    )
)


def write(path: Path) -> Path:
    """Four takes of each way to swing, which its caption names."""
    with StoreWriter.create(path) as writer:
        for take, kind in enumerate(np.arange(4 * KINDS) % KINDS):
            positions = swinging(60, 20, int(kind)) + 0.002 * np.random.default_rng(take).normal(size=(60, 22, 3))
            motion = Motion(
                positions.astype(np.float32), SMPL22, TimeGrid(Fraction(20), 60), captions=(Caption(f"kind {kind}"),)
            )
            writer.add(replace(motion, sequence_id=f"take-{take}", split="train"))
    return path


def train(store: Path, run: Path, config: TmrConfig = CONFIG) -> None:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("motionkit.training.text.load_text_encoder", lambda name: HashEncoder())
        train_tmr(StageContext(store, RunFolder(run), "tiny", device="cpu"), config)
    torch.set_num_threads(threads)


@pytest.fixture(autouse=True)
def no_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("eval.native_evaluator.evaluator.load_text_encoder", lambda name: HashEncoder())


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tmr")
    train(write(folder / "store"), folder / "run")
    return folder / "run"


def held_out(seed: int = 100) -> tuple[SampleSet, list[Caption]]:
    """A take of each kind that was not trained on, at 20 fps."""
    rng = np.random.default_rng(seed)
    takes = [
        (swinging(60, 20, kind) + 0.002 * rng.normal(size=(60, 22, 3))).astype(np.float32) for kind in range(KINDS)
    ]
    captions = [f"kind {kind}" for kind in range(KINDS)]
    return sample_set("held out", Fraction(20), takes, captions), [Caption(text) for text in captions]


def recalls(run: Path) -> np.ndarray:
    evaluator = load_tmr(run)
    samples, captions = held_out()
    motions, texts = evaluator.embed_motions(samples), evaluator.embed_texts(captions)
    return retrieval(np.linalg.norm(texts[:, None] - motions[None], axis=-1)).recall


def test_captions_about_no_clip_are_refused(tmp_path: Path) -> None:
    """A clip's sentence is about its middle, and these captions end before any."""
    with StoreWriter.create(tmp_path / "store") as writer:
        positions = swinging(60, 20, 0).astype(np.float32)
        said = (Caption("kind 0", end_seconds=0.01),)
        writer.add(
            Motion(positions, SMPL22, TimeGrid(Fraction(20), 60), captions=said, split="train", sequence_id="take")
        )
    with pytest.raises(UsageError, match="caption more"):
        train(tmp_path / "store", tmp_path / "run")


def test_it_finds_the_motions_of_captions(run: Path) -> None:
    assert recalls(run)[0] > 0.7


def test_embeddings_have_length_1_and_are_each_motions_own(run: Path) -> None:
    evaluator = load_tmr(run)
    assert isinstance(evaluator, TextMotionEvaluator) and evaluator.pair_score == "tmr_score"
    samples, captions = held_out()
    together = evaluator.embed_motions(samples)
    np.testing.assert_allclose(np.linalg.norm(together, axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(evaluator.embed_texts(captions), axis=1), 1.0, atol=1e-6)
    alone = np.concatenate([evaluator.embed_motions(samples.select([row])) for row in range(KINDS)])
    np.testing.assert_allclose(alone, together, atol=1e-5)
    assert evaluator.remark_at(Fraction(20)) == "" and "--stage tmr" in evaluator.remark_at(Fraction(120))


def test_the_loss_leaves_out_pairs_of_one_sentence() -> None:
    rng = torch.Generator().manual_seed(0)
    motions, texts = torch.randn(4, 3, generator=rng), torch.randn(4, 3, generator=rng)
    sentences = torch.tensor([[1.0, 0.0], [1.0, 0.1], [0.0, 1.0], [-1.0, 0.2]])
    x, y = (np.asarray(rows / rows.norm(dim=1, keepdim=True)) for rows in (texts, motions))
    logits = x @ y.T / 0.5
    total = 0.0
    for own in range(4):
        others = [k for k in range(4) if {own, k} != {0, 1} or k == own]
        total += np.log(np.exp(logits[own, others]).sum()) + np.log(np.exp(logits[others, own]).sum())
        total -= 2 * logits[own, own]
    assert float(retrieval_loss(motions, texts, sentences, 0.5, 0.9)) == pytest.approx(total / 8, rel=1e-5)


def test_what_cannot_be_trained_or_read_is_reported(run: Path, tmp_path: Path) -> None:
    with StoreWriter.create(tmp_path / "mute") as writer:
        grid = TimeGrid(Fraction(20), 60)
        writer.add(replace(Motion(swinging(60, 20, 0), SMPL22, grid), sequence_id="take", split="train"))
    with pytest.raises(UsageError, match="learns from captions"):
        train(tmp_path / "mute", tmp_path / "run")
    with pytest.raises(ValueError, match="text_encoder must name"):
        TmrTrainingConfig(text_encoder="")
    path = RunFolder(run).stage("tmr").model_path
    path.with_name("kept").write_bytes(path.read_bytes())
    path.with_name("SHA256SUMS").unlink()
    from motionkit.training.loop import load_tensors, save_tensors

    tensors, header = load_tensors(path)
    save_tensors(path, tensors, header | {"version": "tmr/0"})
    with pytest.raises(CheckpointError, match="motionkit train --stage tmr"):
        load_tmr(run)
    path.with_name("kept").replace(path)
