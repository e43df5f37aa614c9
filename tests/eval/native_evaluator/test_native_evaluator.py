"""The native-rate evaluator from store to embeddings: one small training, and what must hold of its numbers."""

import hashlib
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch

from eval.native_evaluator import evaluator as native_module
from eval.native_evaluator.evaluator import NativeEvaluator, load_native
from eval.native_evaluator.network import TARGETS
from eval.native_evaluator.settings import NativeConfig, NativeNetworkConfig, NativeTrainingConfig
from eval.native_evaluator.stage import STAGE, train_evaluator
from eval.sets.corruptions import translate, turn
from motionkit.core.errors import MotionkitError
from motionkit.core.kinematics import forward_kinematics
from motionkit.core.motion import Caption, Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.store import Store, StoreWriter
from motionkit.training.run import RunError, RunFolder
from motionkit.training.stage import StageContext, registered_stages
from motionkit.training.tensors import CheckpointError, load_tensors, save_tensors

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


def motion(index: int, fps: int, split: str = "train") -> Motion:
    positions = swinging(2 * fps, fps, index)
    captions = (Caption(f"somebody does number {index % 3}"),)
    grid = TimeGrid(Fraction(fps), len(positions))
    return Motion(positions, SMPL22, grid, captions=captions, sequence_id=f"take-{index}", split=split)


TINY = NativeConfig(
    network=NativeNetworkConfig(convolution=16, recurrent=8, embedding=12, shared=5, text_hidden=8),
    training=NativeTrainingConfig(
        steps=5,
        batch_size=12,
        framerates=(20.0, 60.0),
        max_poses=24,
        statistics_batches=2,
        whitening_batches=4,
        text_encoder="minilm",
    ),
)


def train(store: Path, run: Path, *, seed: int = 0, resume: bool = False, config: NativeConfig = TINY) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("motionkit.training.text.load_text_encoder", lambda name: HashEncoder())
        context = StageContext(store, RunFolder(run), "tiny", seed=seed, resume=resume, device="cpu")
        train_evaluator(context, config)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("evaluator") / "store"
    with StoreWriter.create(path) as writer:
        for index, fps in enumerate((120, 60, 60, 30, 24, 60)):
            writer.add(motion(index, fps, split="test" if index == 5 else "train"))
    return path


@pytest.fixture(scope="module")
def run(store: Path) -> Path:
    folder = store.parent / "run"
    train(store, folder)
    return folder


@pytest.fixture
def evaluator(run: Path, monkeypatch: pytest.MonkeyPatch) -> NativeEvaluator:
    monkeypatch.setattr(native_module, "load_text_encoder", lambda name: HashEncoder())
    return load_native(run)


@pytest.fixture(scope="module")
def clips() -> np.ndarray:
    return np.stack([swinging(24, 60, seed) for seed in range(300)])


def test_embeddings_do_not_depend_on_the_batch(evaluator: NativeEvaluator, clips: np.ndarray) -> None:
    together = evaluator.describe(clips, Fraction(60))
    order = np.random.default_rng(0).permutation(len(clips))
    assert together.shape == (300, 12) and together.dtype == np.float64
    assert np.allclose(evaluator.describe(clips[order], Fraction(60)), together[order], atol=1e-6)
    assert np.allclose(evaluator.describe(clips[:1], Fraction(60)), together[:1], atol=1e-6)
    assert evaluator.describe(clips[:0], Fraction(60)).shape == (0, 12)


def test_embeddings_do_not_depend_on_place_and_heading(evaluator: NativeEvaluator, clips: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    exact = clips[:40].astype(np.float64)
    moved = translate(turn(exact, rng.uniform(-3, 3, 40)), rng.uniform(-100, 100, (40, 2)))
    plain = evaluator.describe(exact, Fraction(60))
    assert np.allclose(evaluator.describe(moved, Fraction(60)), plain, atol=2e-4 * np.abs(plain).max())


def test_the_framerate_matters(evaluator: NativeEvaluator, clips: np.ndarray) -> None:
    assert np.abs(evaluator.describe(clips, Fraction(60)) - evaluator.describe(clips, Fraction(61))).max() > 1e-4


@pytest.mark.parametrize("shape", [(3, 16, 21, 3), (3, 7, 22, 3)])
def test_wrong_shapes_are_refused(evaluator: NativeEvaluator, shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"clips have (21 joints|7 poses)"):
        evaluator.describe(np.zeros(shape), Fraction(60))


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_static_clips_have_finite_embeddings(evaluator: NativeEvaluator, value: float) -> None:
    assert np.isfinite(evaluator.describe(np.full((2, 8, 22, 3), value), Fraction(120))).all()


def test_sentences_and_motions_share_a_space(evaluator: NativeEvaluator, clips: np.ndarray) -> None:
    sentences = evaluator.embed_texts(["somebody does number 1", "somebody does number 2"])
    motions = evaluator.embed_motions(clips[:4], Fraction(60))
    assert sentences.shape == (2, 5) and motions.shape == (4, 5)
    assert np.allclose(evaluator.embed_texts(["somebody does number 2"])[0], sentences[1], rtol=0, atol=1e-6)
    assert evaluator.strengths(clips[:4], Fraction(60)).shape == (4, len(TARGETS))


def test_what_it_was_trained_on_travels_with_it(evaluator: NativeEvaluator, store: Path, run: Path) -> None:
    assert evaluator.store_fingerprint == Store.open(store).fingerprint
    assert evaluator.description["framerates"] == ["20", "60"]
    summary = RunFolder(run).stage("evaluator").read_summary()
    assert summary["sequences"] == 5 and summary["sentences"] == 3


def test_clean_training_clips_have_a_common_scale(evaluator: NativeEvaluator, store: Path) -> None:
    training_takes = [swinging(2 * fps, fps, seed)[:24] for seed, fps in ((0, 120), (1, 60), (2, 60))]
    whitening = evaluator.whitening.double().numpy()
    variances = np.linalg.eigvalsh(np.linalg.inv(whitening @ whitening))
    # C + c: no direction has less than c, and their mean is 2·c.
    assert variances.min() == pytest.approx(variances.mean() / 2, rel=0.1)
    described = evaluator.describe(np.stack(training_takes), Fraction(60))
    assert np.linalg.norm(described[0] - described[1]) > 1e-3


def test_another_text_encoder_is_refused(evaluator: NativeEvaluator, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(HashEncoder, "fingerprint", "0" * 64)
    with pytest.raises(MotionkitError, match="is not the one"):
        evaluator.embed_texts(["walk"])


def test_training_is_deterministic_by_seed_and_resumes_exactly(
    store: Path, evaluator: NativeEvaluator, tmp_path: Path
) -> None:
    train(store, tmp_path / "again")
    assert load_native(tmp_path / "again").fingerprint == evaluator.fingerprint
    train(store, tmp_path / "other", seed=1)
    assert load_native(tmp_path / "other").fingerprint != evaluator.fingerprint

    stopped = tmp_path / "stopped"
    calls = 0

    def interrupted(step: int, *_: object) -> None:
        nonlocal calls
        calls += 1
        if calls == 3:
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("eval.native_evaluator.training.set_rate", interrupted)
        with pytest.raises(KeyboardInterrupt):
            train(store, stopped)
    with pytest.raises(RunError, match="not trained"):
        load_native(stopped)
    train(store, stopped, resume=True)
    assert load_native(stopped).fingerprint == evaluator.fingerprint


def test_a_file_of_another_version_is_refused(run: Path, tmp_path: Path) -> None:
    folder = RunFolder(tmp_path).stage("evaluator")
    tensors, description = load_tensors(RunFolder(run).stage("evaluator").model_path)
    save_tensors(folder.model_path, tensors, {**description, "version": "native/1"})
    folder.finish({})
    with pytest.raises(CheckpointError, match=r"'native/1', expected 'native/2': train it again \(motionkit train"):
        load_native(tmp_path)


def test_a_store_without_captions_gives_an_evaluator_without_sentences(tmp_path: Path) -> None:
    with StoreWriter.create(tmp_path / "store") as writer:
        mute = motion(0, 60)
        writer.add(Motion(mute.joint_positions, SMPL22, mute.timegrid, sequence_id="mute"))
    train(tmp_path / "store", tmp_path / "run")
    trained = load_native(tmp_path / "run")
    assert np.isfinite(trained.describe(np.zeros((1, 16, 22, 3)), Fraction(60))).all()
    with pytest.raises(MotionkitError, match="without captions"):
        trained.embed_texts(["walk"])


def test_the_stage_is_registered_with_recipes_of_every_size() -> None:
    assert registered_stages()["evaluator"] is STAGE
    assert set(STAGE.recipes) == {"nano", "small", "demo", "base", "paper"}
    assert STAGE.recipe("demo").training.steps < STAGE.recipe("nano").training.steps
    assert torch.get_default_dtype() == torch.float32


@pytest.mark.parametrize(
    "field", [{"min_poses": 6}, {"max_poses": 30}, {"clean_fraction": 1.0}, {"whitening_batches": 0}]
)
def test_settings_that_make_no_sense_are_refused(field: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"min_poses|clean_fraction|whitening"):
        NativeTrainingConfig(**field)  # type: ignore[arg-type]
