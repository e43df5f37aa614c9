"""Another system's samples: repeated answers, whom they belong to, what is missing."""

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from eval.native_evaluator.evaluator import NativeEvaluator
from eval.sample_folder import SampleFolder
from eval.sample_folder.folder import SampleFolderError
from eval.sets.sets import Ragged, SampleSet, sample_set
from eval.text_motion.guo import KINDS, GuoEvaluator
from eval.text_motion.motions import AS_VECTORS, BY_JOINTS, CaptionedMotions, sample_embeddings
from eval.text_motion.protocol import find_text_motion_protocol
from motionkit.core.errors import UsageError
from motionkit.core.motion import Caption

NATIVE, PAIRED = find_text_motion_protocol("native"), find_text_motion_protocol("mld")


class First(NativeEvaluator):
    """An evaluator whose embedding of a motion is its first number, its length, and of a caption its tokens' length."""

    def __init__(self) -> None: ...

    def embed_motions(self, samples: SampleSet) -> np.ndarray:
        return np.array([[float(sequence[0, 0, 0]), float(len(sequence))] for sequence in samples.sequences])

    def embed_texts(self, captions: Sequence[Caption]) -> np.ndarray:
        return np.array([[len(caption.text), len(caption.tokens)] for caption in captions], dtype=np.float64)


FIRST = First()


def sequence(value: float, frames: int = 41) -> np.ndarray:
    return np.full((frames, 22, 3), value, dtype=np.float32)


def real() -> CaptionedMotions:
    captions = tuple(Caption(text, tokens=text.upper()) for text in ("walks", "runs fast", "walks", "sits"))
    texts = [caption.text for caption in captions]
    samples = sample_set("real", Fraction(20), [sequence(i) for i in range(4)], ["r0", "r1", "r2", "r3"], texts)
    return CaptionedMotions(samples, captions, {caption.text: caption for caption in captions}, {}, 0)


def folder(names: list[str], captions: list[str], groups: list[str] | None = None, frames: int = 41) -> SampleFolder:
    return SampleFolder(
        "mine",
        Ragged.of([sequence(10 + index, frames) for index in range(len(names))]),
        (Fraction(20),) * len(names),
        tuple(names),
        tuple(captions),
        ("",) * len(names),
        tuple(groups or names),
    )


def test_answers_to_one_prompt_are_draws_and_multimodality() -> None:
    names = [f"{group}_{repeat}" for repeat in range(3) for group in "ab"]
    found = sample_embeddings(folder(names, ["walks", "sits"] * 3, ["a", "b"] * 3), real(), NATIVE, FIRST)
    assert [draw.motions[:, 0].tolist() for draw in found.draws] == [[10, 11], [12, 13], [14, 15]]
    assert found.repeated is not None and found.repeated[..., 0].tolist() == [[10, 12, 14], [11, 13, 15]]
    # Captions of the real set keep their tokens.
    assert found.draws[0].texts.tolist() == [[5, 5], [4, 4]]


@pytest.mark.parametrize(
    ("names", "captions", "rows"),
    [
        (["x/r2.npy", "x/r0.npy"], ["sits", "sits"], [2, 0]),
        (["0", "1", "2"], ["walks", "sits", "walks"], [0, 3, 2]),
        # Without a real motion: left out.
        (["0", "1", "2"], ["walks", "walks", "walks"], [0, 2]),
        (["0", "1", "2"], ["walks", "unheard of", "sits"], [0, 3]),
        # Most names fit: names decide, and the caption of another real motion doesn't.
        (["r2", "r9", "r0"], ["sits"] * 3, [2, 0]),
    ],
)
def test_samples_belong_to_real_motions_by_name_or_else_by_caption(
    names: list[str], captions: list[str], rows: list[int]
) -> None:
    found = sample_embeddings(folder(names, captions), real(), PAIRED, FIRST)
    assert found.real_rows is not None and found.real_rows.tolist() == rows and len(found.draws[0].motions) == len(rows)
    assert ("left out" not in found.note) == (len(rows) == len(names))
    assert sample_embeddings(folder(names, captions), real(), NATIVE, FIRST).real_rows is None


def test_samples_without_captions_or_real_motions_are_refused() -> None:
    with pytest.raises(UsageError, match="protocol 'mld'"):
        sample_embeddings(folder(["0", "1"], ["unheard of", "new"]), real(), PAIRED, FIRST)
    with pytest.raises(SampleFolderError, match="have no caption"):
        sample_embeddings(folder(["0", "1"], ["walks", ""]), real(), NATIVE, FIRST)


class KitVectors(GuoEvaluator):
    """An evaluator that reads KIT's pose vectors: their first number, and how many there are."""

    kind, fps = KINDS[1], Fraction(20)  # type: ignore[assignment]
    embed_motions, embed_texts = First.embed_motions, First.embed_texts  # type: ignore[assignment]

    def __init__(self) -> None: ...

    def embed_vectors(self, motions: Sequence[np.ndarray], names: Sequence[str] = ()) -> np.ndarray:
        return np.array([[float(motion[0, 0]), float(len(motion))] for motion in motions])


def test_vectors_reach_an_evaluator_that_reads_them_and_no_other() -> None:
    joints = folder(["0", "1"], ["walks", "sits"], frames=300)
    kit = replace(joints, vectors=tuple(np.full((300, 251), 70 + i, dtype=np.float32) for i in range(2)))
    wide = replace(joints, vectors=tuple(np.zeros((300, 263), dtype=np.float32) for _ in range(2)))
    slow = replace(kit, fps=(Fraction(10),) * 2)
    reads = KitVectors()
    found = sample_embeddings(kit, real(), NATIVE, reads)
    # 9.8 s at 20 fps are 197 poses, and so many poses have 196 vectors.
    assert AS_VECTORS in found.note and found.draws[0].motions.tolist() == [[70, 196], [71, 196]]
    for other in (joints, wide, slow):
        by_joints = sample_embeddings(other, real(), NATIVE, reads)
        assert BY_JOINTS in by_joints.note and by_joints.draws[0].motions.tolist() == [[10, 197], [11, 197]]
    assert "vectors" not in sample_embeddings(kit, real(), NATIVE, FIRST).note
