"""The native text–motion evaluator from store to embeddings: small trainings, and what must hold of its numbers."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.metrics.retrieval import retrieval
from eval.native_evaluator.evaluator import NativeEvaluator, load_evaluator, motion_input
from eval.native_evaluator.stage import EvaluatorConfig, NetworkConfig, TrainingConfig, native, tmr
from eval.native_evaluator.training import matching_loss, train_evaluator
from eval.sets.sets import sample_set
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.kinematics import forward_kinematics, rotate_about_y
from motionkit.core.motion import Caption, Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.store import Store, StoreWriter
from motionkit.training.config import apply_overrides
from motionkit.training.loop import CheckpointError, Learner, load_tensors, save_tensors
from motionkit.training.run import RunError, RunFolder, StageContext

SENTENCE_SIZE = 6


class HashEncoder:
    """Sentence embeddings from the sentence's sha256: no weights to fetch."""

    name = "minilm"
    fingerprint = "f" * 64
    dimension = SENTENCE_SIZE

    def encode(self, texts: Sequence[str]) -> np.ndarray:
        rows = [list(hashlib.sha256(text.encode()).digest()[:SENTENCE_SIZE]) for text in texts]
        return (np.array(rows, dtype=np.float32).reshape(-1, SENTENCE_SIZE) - 128) / 128


def swinging(num_frames: int, fps: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    seconds = np.arange(num_frames)[:, None] / fps
    angle = 0.3 * np.sin(2 * np.pi * rng.uniform(0.5, 2.0, 22) * seconds + rng.uniform(0, 6, 22))
    rotations = np.stack((np.cos(angle / 2), np.sin(angle / 2), 0 * angle, 0 * angle), -1).astype(np.float32)
    root = np.concatenate((0 * seconds, 0.9 + 0 * seconds, seed % 3 * seconds), -1).astype(np.float32)
    return forward_kinematics(rotations, root, SMPL22)


KINDS = 12
OVERRIDES = [
    "schedule.steps=60",
    "schedule.batch_size=48",
    "training.framerates=20,60",
    "training.max_seconds=2",
    "training.max_poses=40",
    "training.statistics_batches=2",
]
CONFIGS = {
    "evaluator": apply_overrides(native("nano"), OVERRIDES),
    "tmr": apply_overrides(tmr("nano"), [*OVERRIDES, "training.same_above=0.99"]),
}
TINY = EvaluatorConfig(NetworkConfig(convolution=16, recurrent=8, shared=5, text_hidden=8))
TINY = apply_overrides(TINY, [*OVERRIDES, "schedule.steps=5", "schedule.batch_size=12"])


def captioned(kind: int, fps: int, take: int = 0, split: str = "train") -> Motion:
    """Two seconds of a way to swing, which the caption names."""
    noise = 0.002 * np.random.default_rng(take).normal(size=(2 * fps, 22, 3))
    positions = (swinging(2 * fps, fps, kind) + noise).astype(np.float32)
    captions = (Caption(f"kind {kind}"),)
    name = f"take-{kind}-{take}"
    return Motion(positions, SMPL22, TimeGrid(Fraction(fps), 2 * fps), captions=captions, sequence_id=name, split=split)


def write(path: Path, motions: Sequence[Motion]) -> Path:
    with StoreWriter.create(path) as writer:
        for motion in motions:
            writer.add(motion)
    return path


def train(store: Path, run: Path, config: EvaluatorConfig, stage: str = "evaluator", resume: bool = False) -> None:
    train_evaluator(stage, StageContext(store, RunFolder(run), "tiny", resume=resume, device="cpu"), config)


@pytest.fixture(scope="module", autouse=True)
def no_weights() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    with pytest.MonkeyPatch.context() as patch:
        for module in ("eval.native_evaluator.training", "motionkit.training.text"):
            patch.setattr(f"{module}.load_text_encoder", lambda name: HashEncoder())
        yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    kinds = [captioned(kind, (20, 60)[take % 2], take) for take in range(4) for kind in range(KINDS)]
    return write(tmp_path_factory.mktemp("evaluator") / "store", [*kinds, captioned(0, 60, 9, split="test")])


@pytest.fixture(scope="module", params=CONFIGS)
def evaluator(request: pytest.FixtureRequest, store: Path) -> NativeEvaluator:
    run = store.parent / "run"
    train(store, run, CONFIGS[request.param], request.param)
    return load_evaluator(run, request.param)


def test_it_finds_the_motions_of_captions(evaluator: NativeEvaluator) -> None:
    takes = [captioned(kind, 20, 100) for kind in range(KINDS)]
    samples = sample_set("held out", Fraction(20), [each.joint_positions for each in takes], list("abcdefghijkl"))
    motions, texts = evaluator.embed_motions(samples), evaluator.embed_texts([each.captions[0] for each in takes])
    assert retrieval(np.linalg.norm(texts[:, None] - motions[None], axis=-1))[0][0] > 0.7
    assert evaluator.layout == "smpl22"
    if evaluator.stage == "tmr":
        assert (evaluator.name, evaluator.pair_score) == ("tmr", "tmr_score")
        np.testing.assert_allclose(np.linalg.norm([*motions, *texts], axis=1), 1.0, atol=1e-6)
    else:
        assert (evaluator.name, evaluator.pair_score) == ("native", "")


def test_embeddings_are_each_motions_own(evaluator: NativeEvaluator) -> None:
    clips = [swinging(frames, 60, seed) for seed, frames in enumerate((24, 12, 24, 9, 12))]
    samples = sample_set("some", Fraction(60), clips, list("abcde"))
    together = evaluator.embed_motions(samples)
    alone = np.concatenate([evaluator.embed_motions(samples.select([index])) for index in range(5)])
    np.testing.assert_allclose(together, alone, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(evaluator.embed_clips(clips[0][None], Fraction(60)), together[:1], rtol=1e-4, atol=1e-5)
    assert np.isfinite(evaluator.embed_clips(np.zeros((2, 8, 22, 3)), Fraction(120))).all()
    assert evaluator.remark_at(Fraction(60)) == "" and f"--stage {evaluator.stage}" in evaluator.remark_at(
        Fraction(120)
    )
    with pytest.raises(MotionkitError, match="'b' has 7 poses"):
        evaluator.embed_motions(sample_set("short", Fraction(60), [clips[0], clips[1][:7]], ["a", "b"]))


def test_what_it_was_trained_on_travels_with_it(evaluator: NativeEvaluator, store: Path) -> None:
    assert evaluator.description["store_fingerprint"] == Store.open(store).fingerprint
    assert evaluator.description["framerates"] == ["20", "60"]
    summary = RunFolder(store.parent / "run").stage(evaluator.stage).read_summary()
    assert (summary["sequences"], summary["sentences"], summary["steps"]) == (4 * KINDS, KINDS, 60)


@given(yaw=st.floats(-3.1, 3.1), x=st.floats(-50, 50), z=st.floats(-50, 50), fps=st.sampled_from([20.0, 120.0]))
@settings(max_examples=20)
def test_input_ignores_where_and_which_way(yaw: float, x: float, z: float, fps: float) -> None:
    clips = swinging(24, int(fps), 1)[None].astype(np.float64)
    moved = rotate_about_y(clips, np.asarray(yaw)) + np.array([x, 0.0, z])
    assert np.allclose(motion_input(moved, fps), motion_input(clips, fps), atol=1e-5)


@pytest.mark.parametrize("unit_length", [False, True])
def test_the_loss_leaves_out_pairs_of_one_sentence(unit_length: bool) -> None:
    rng = torch.Generator().manual_seed(0)
    motions, texts = torch.randn(4, 3, generator=rng), torch.randn(4, 3, generator=rng)
    if unit_length:
        motions, texts = (rows / rows.norm(dim=1, keepdim=True) for rows in (motions, texts))
    sentences = torch.tensor([[1.0, 0.0], [1.0, 0.1], [0.0, 1.0], [-1.0, 0.2]])
    distances = ((texts[:, None] - motions[None]) ** 2).sum(-1).numpy()
    # Of unit vectors, −d²/2 is the cosine less 1 (TMR).
    logits = ((texts @ motions.T).numpy() - 1 if unit_length else -distances / 2) / 0.5
    total = 0.0
    for own in range(4):
        others = [k for k in range(4) if {own, k} != {0, 1} or k == own]
        total += np.log(np.exp(logits[own, others]).sum()) + np.log(np.exp(logits[others, own]).sum())
        total -= 2 * logits[own, own]
    assert float(matching_loss(motions, texts, sentences, 0.5, 0.9)) == pytest.approx(total / 8, rel=1e-5)


def test_training_resumes_exactly(store: Path, tmp_path: Path) -> None:
    train(store, tmp_path / "whole", TINY)
    descend = Learner.descend

    def interrupted(self: Learner, loss: torch.Tensor, step: int, *more: float) -> None:
        if step == 3:
            raise KeyboardInterrupt
        descend(self, loss, step, *more)

    with pytest.MonkeyPatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Learner, "descend", interrupted)
        train(store, tmp_path / "stopped", TINY)
    with pytest.raises(RunError, match="not trained"):
        load_evaluator(tmp_path / "stopped")
    train(store, tmp_path / "stopped", TINY, resume=True)
    assert load_evaluator(tmp_path / "stopped").fingerprint == load_evaluator(tmp_path / "whole").fingerprint


def test_what_cannot_be_trained_or_read_is_reported(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mute = replace(captioned(0, 60), captions=())
    with pytest.warns(match="no captions"):
        train(write(tmp_path / "mute", [mute]), tmp_path / "run", TINY)
    with pytest.raises(RunError, match="without captions"):
        load_evaluator(tmp_path / "run")
    with pytest.raises(UsageError, match="--set training"):
        train(store, tmp_path / "fast", apply_overrides(TINY, ["training.framerates=240"]))
    with pytest.raises(ValueError, match="min_seconds"):
        TrainingConfig(min_seconds=3.0, max_seconds=2.0)
    train(store, tmp_path / "old", apply_overrides(TINY, ["schedule.steps=1"]))
    monkeypatch.setattr(HashEncoder, "fingerprint", "0" * 64)
    with pytest.raises(RunError, match="is not the one"):
        load_evaluator(tmp_path / "old").embed_texts([Caption("walk")])
    path = RunFolder(tmp_path / "old").stage("evaluator").model_path
    path.with_name("SHA256SUMS").unlink()
    tensors, header = load_tensors(path)
    save_tensors(path, tensors, header | {"version": "native/2"})
    with pytest.raises(CheckpointError, match="motionkit train --stage evaluator"):
        load_evaluator(tmp_path / "old")
