"""Embeddings are computed once for what they depend on, and a file that cannot be trusted is not used."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from eval.sets.sets import SampleSet, sample_set
from eval.text_motion.embedder import Embedder
from motionkit.core.motion import Caption


class Counting:
    """An evaluator that counts what it is asked for."""

    name = "counting"
    fps, layout, pair_score = None, "smpl22", ""

    def __init__(self, fingerprint: str = "a") -> None:
        self.fingerprint = fingerprint
        self.asked: list[int] = []

    def remark_at(self, fps: Fraction) -> str:
        return ""

    def embed_motions(self, samples: SampleSet) -> np.ndarray:
        self.asked.append(samples.num_sequences)
        return np.stack([sequence.astype(np.float64).mean(axis=(0, 1)) for sequence in samples.sequences])

    def embed_texts(self, captions: Sequence[Caption]) -> np.ndarray:
        self.asked.append(len(captions))
        return np.array([[len(caption.text), 0.0, 1.0] for caption in captions])


def motions(seed: int = 0, fps: int = 20) -> SampleSet:
    rng = np.random.default_rng(seed)
    sequences = [rng.normal(size=(frames, 22, 3)).astype(np.float32) for frames in (4, 6, 5)]
    return sample_set("some", Fraction(fps), sequences, ["a", "b", "c"])


def test_motions_are_embedded_once_for_what_they_depend_on(tmp_path: Path) -> None:
    evaluator, other = Counting("a"), Counting("b")
    first = Embedder(evaluator, tmp_path).motions(motions())
    renamed = sample_set("another", Fraction(20), list(motions().sequences), ["x", "y", "z"])
    assert np.array_equal(first, Embedder(evaluator, tmp_path).motions(renamed))
    assert evaluator.asked == [3] and len(list(tmp_path.iterdir())) == 1
    changed = motions()
    changed.sequences.values[7, 3, 1] += 1e-6
    cut = sample_set("cut", Fraction(20), np.split(motions().sequences.values, [5, 10]), ["a", "b", "c"])
    for samples in (changed, motions(fps=30), cut):
        Embedder(evaluator, tmp_path).motions(samples)
    Embedder(evaluator, None).motions(motions())
    Embedder(other, tmp_path).motions(motions())
    assert (evaluator.asked, other.asked) == ([3] * 5, [3])


def test_every_text_is_embedded_once_and_comes_back_in_order(tmp_path: Path) -> None:
    evaluator = Counting()
    captions = [Caption(text) for text in ("walks", "runs fast", "walks", "sits")]
    rows = Embedder(evaluator, tmp_path).texts(captions)
    assert rows[:, 0].tolist() == [5, 9, 5, 4]
    assert evaluator.asked == [3]
    Embedder(evaluator, tmp_path).texts([*captions[:3], Caption("sits", tokens="sits/VERB")])
    assert evaluator.asked == [3, 3]


@pytest.mark.parametrize("content", [b"\x93NUMPY", np.zeros((2, 3)), np.full((3, 3), np.nan)], ids=str)
def test_a_file_that_cannot_be_trusted_is_made_anew(
    content: bytes | np.ndarray, tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    evaluator = Counting()
    expected = Embedder(evaluator, tmp_path).motions(motions())
    (path,) = tmp_path.iterdir()
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        np.save(path, content)
    assert np.array_equal(Embedder(evaluator, tmp_path).motions(motions()), expected)
    assert evaluator.asked == [3, 3]
    assert any("computed again" in str(each.message) for each in recwarn)
    assert np.array_equal(Embedder(evaluator, tmp_path).motions(motions()), expected)
    assert evaluator.asked == [3, 3]
