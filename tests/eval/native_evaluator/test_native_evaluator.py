"""The native-rate evaluator from store to embeddings: one small training, and what must hold of its numbers."""

import hashlib
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from eval.native_evaluator import evaluator as native_module
from eval.native_evaluator.evaluator import NativeEvaluator, NativeTextMotion, load_native
from eval.native_evaluator.settings import NativeConfig, NativeNetworkConfig, NativeTrainingConfig
from eval.native_evaluator.stage import train_evaluator
from eval.sets.damage import translate, turn
from eval.sets.sets import sample_set
from eval.text_motion.evaluator import TextMotionEvaluator
from motionkit.core.errors import MotionkitError
from motionkit.core.kinematics import forward_kinematics
from motionkit.core.motion import Caption, Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.store import Store, StoreWriter
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


def test_embeddings_depend_on_motion_and_framerate_alone(evaluator: NativeEvaluator, clips: np.ndarray) -> None:
    together = evaluator.embed_motions(clips, Fraction(60))
    order = np.random.default_rng(0).permutation(len(clips))
    assert together.shape == (300, 5) and together.dtype == np.float64
    assert np.allclose(evaluator.embed_motions(clips[order], Fraction(60)), together[order], atol=1e-6)
    assert np.allclose(evaluator.embed_motions(clips[:1], Fraction(60)), together[:1], atol=1e-6)
    assert evaluator.embed_motions(clips[:0], Fraction(60)).shape == (0, 5)
    rng = np.random.default_rng(1)
    exact = clips[:40].astype(np.float64)
    moved = translate(turn(exact, rng.uniform(-3, 3, 40)), rng.uniform(-100, 100, (40, 2)))
    plain = evaluator.embed_motions(exact, Fraction(60))
    assert np.allclose(evaluator.embed_motions(moved, Fraction(60)), plain, atol=2e-4 * np.abs(plain).max())
    assert np.abs(together - evaluator.embed_motions(clips, Fraction(61))).max() > 1e-4
    assert np.isfinite(evaluator.embed_motions(np.zeros((2, 8, 22, 3)), Fraction(120))).all()


@pytest.mark.parametrize("shape", [(3, 16, 21, 3), (3, 7, 22, 3)])
def test_wrong_shapes_are_refused(evaluator: NativeEvaluator, shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"clips have (21 joints|7 poses)"):
        evaluator.embed_motions(np.zeros(shape), Fraction(60))


def test_whole_motions_come_in_the_order_of_the_set(evaluator: NativeEvaluator, clips: np.ndarray) -> None:
    whole = NativeTextMotion(evaluator)
    assert isinstance(whole, TextMotionEvaluator) and (whole.name, whole.fps, whole.pair_score) == ("native", None, "")
    lengths = (24, 12, 24, 9, 12)
    samples = sample_set(
        "some", Fraction(60), [clip[:n] for clip, n in zip(clips, lengths, strict=False)], [f"m{n}" for n in range(5)]
    )
    together = whole.embed_motions(samples)
    alone = np.concatenate([whole.embed_motions(samples.select([index])) for index in range(5)])
    np.testing.assert_allclose(together, alone, rtol=1e-5, atol=1e-6)
    assert whole.remark_at(Fraction(20)) == "" == whole.remark_at(Fraction(60))
    assert "10 fps" in whole.remark_at(Fraction(10))
    with pytest.raises(MotionkitError, match="'m1' has 7 poses"):
        whole.embed_motions(sample_set("short", Fraction(60), [clips[0], clips[1][:7]], ["m0", "m1"]))


def test_sentences_and_motions_share_a_space(evaluator: NativeEvaluator) -> None:
    sentences = evaluator.embed_texts(["somebody does number 1", "somebody does number 2"])
    assert sentences.shape == (2, 5)
    assert np.allclose(evaluator.embed_texts(["somebody does number 2"])[0], sentences[1], rtol=0, atol=1e-6)


def test_what_it_was_trained_on_travels_with_it(evaluator: NativeEvaluator, store: Path, run: Path) -> None:
    assert evaluator.description["store_fingerprint"] == Store.open(store).fingerprint
    assert evaluator.description["framerates"] == ["20", "60"]
    summary = RunFolder(run).stage("evaluator").read_summary()
    assert summary["sequences"] == 5 and summary["sentences"] == 3


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


def test_a_store_without_captions_gives_an_evaluator_without_sentences(tmp_path: Path) -> None:
    with StoreWriter.create(tmp_path / "store") as writer:
        mute = motion(0, 60)
        writer.add(Motion(mute.joint_positions, SMPL22, mute.timegrid, sequence_id="mute"))
    train(tmp_path / "store", tmp_path / "run")
    trained = load_native(tmp_path / "run")
    assert np.isfinite(trained.embed_motions(np.zeros((1, 16, 22, 3)), Fraction(60))).all()
    with pytest.raises(MotionkitError, match="without captions"):
        trained.embed_texts(["walk"])


@pytest.mark.parametrize("field", [{"min_poses": 6}, {"max_poses": 30}, {"clean_fraction": 1.0}])
def test_settings_that_make_no_sense_are_refused(field: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"min_poses|clean_fraction"):
        NativeTrainingConfig(**field)  # type: ignore[arg-type]
