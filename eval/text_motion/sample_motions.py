"""Another system's samples as embeddings: repeated answers to one prompt become draws and MultiModality."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt
from jaxtyping import Float64

from eval.embedding_cache import Embedder, fingerprint_of_vectors
from eval.evaluators.text_motion import PoseVectorEvaluator
from eval.protocols.text_motion import TextMotionProtocol
from eval.sample_folder import SampleFolder
from eval.samples import SampleSet
from eval.scoring.text_motion import TextMotionPairs
from eval.text_motion.real_pairs import CaptionedMotions, middle
from motionkit.errors import UsageError
from motionkit.motion import Caption

AS_VECTORS = "read as the pose vectors that they came as"
BY_JOINTS = "read as pose vectors made of joint positions"


@dataclass(frozen=True, eq=False)
class SampleEmbeddings:
    """`draws` are the k-th answers to every prompt, `real_rows` the real motions of these where a protocol pairs.

    `path` says how motions reached an evaluator that reads pose vectors; empty for others.
    """

    draws: tuple[TextMotionPairs, ...]
    repeated: Float64[np.ndarray, "texts generations features"] | None
    real_rows: npt.NDArray[np.int64] | None
    path: str = ""


def sample_embeddings(
    folder: SampleFolder, real: CaptionedMotions, protocol: TextMotionProtocol, embedder: Embedder
) -> SampleEmbeddings:
    """Embed a folder's motions and captions; motions longer than the real ones may be are cropped like these.

    A caption that the real set has too keeps its tokens. Raises `SampleFolderError` where a caption is missing, and
    `UsageError` where the protocol pairs motions with real ones and a sample says neither by its name nor by its
    caption which it belongs to.
    """
    folder.require_captions()
    fps = real.samples.fps
    samples = _cropped(folder.at(fps), fps, protocol.lengths.longest_seconds)
    captions = [real.known_captions.get(text, Caption(text)) for text in samples.captions]
    motions, path = _embedded(folder, samples, protocol.lengths.longest_seconds, embedder)
    texts = embedder.texts(captions)
    groups = [np.array(rows) for rows in samples.rows_by_group().values()]
    fewest = min(len(rows) for rows in groups)
    firsts = [np.array([rows[number] for rows in groups]) for number in range(fewest)]
    paired = _real_rows(samples.select(firsts[0]), real) if protocol.reference == "paired" else None
    if protocol.reference == "paired" and paired is None:
        raise UsageError(
            f"{folder.name}: protocol {protocol.name!r} compares with the real motions of the same texts; name the "
            "files after the real sequences, or give them the captions of real sequences of this split"
        )
    return SampleEmbeddings(
        tuple(TextMotionPairs(texts[rows], motions[rows]) for rows in firsts), _repeated(motions, groups), paired, path
    )


def _embedded(
    folder: SampleFolder, samples: SampleSet, longest_seconds: float, embedder: Embedder
) -> tuple[Float64[np.ndarray, "motions features"], str]:
    """Embeddings of a folder's motions: of its pose vectors, where it has what the evaluator reads, else of joints."""
    evaluator = embedder.evaluator
    if not isinstance(evaluator, PoseVectorEvaluator):
        return embedder.motions(samples), ""
    reason = _why_not_vectors(folder, evaluator)
    if reason:
        return embedder.motions(samples), f"{BY_JOINTS} ({reason})"
    # T poses make T − 1 vectors, so the longest motion has one vector fewer than poses.
    seconds = longest_seconds - float(1 / samples.fps)
    vectors = [middle(motion, samples.fps, seconds) for motion in folder.vectors]
    key = {"vectors": fingerprint_of_vectors(vectors)}
    return embedder.kept(key, len(vectors), lambda: evaluator.embed_vectors(vectors)), AS_VECTORS


def _why_not_vectors(folder: SampleFolder, evaluator: PoseVectorEvaluator) -> str:
    """Why a folder's motions reach an evaluator of pose vectors by way of joints; empty where they need not."""
    if not folder.vectors:
        return "not all came as vectors of one size"
    if folder.vectors[0].shape[1] != evaluator.vector_size:
        return f"vectors of {folder.vectors[0].shape[1]} numbers, it reads {evaluator.vector_size}"
    return "" if set(folder.fps) == {evaluator.fps} else f"vectors of another framerate than {evaluator.fps} fps"


def _repeated(
    motions: Float64[np.ndarray, "motions features"], groups: Sequence[npt.NDArray[np.int64]]
) -> Float64[np.ndarray, "texts generations features"] | None:
    """Motions of the prompts that were answered most often; None where none was answered twice."""
    most = max(len(rows) for rows in groups)
    if most < 2:
        return None
    return motions[np.stack([rows for rows in groups if len(rows) == most])]


def _real_rows(samples: SampleSet, real: CaptionedMotions) -> npt.NDArray[np.int64] | None:
    """Which real motion each sample belongs to, by its name or else its caption, each once; None where one has none."""
    by_name = {name: row for row, name in enumerate(real.samples.sequence_ids)}
    stems = [name.rsplit("/", 1)[-1].rsplit(".", 1)[0] for name in samples.sequence_ids]
    named = [by_name.get(name, by_name.get(stem)) for name, stem in zip(samples.sequence_ids, stems, strict=True)]
    if all(row is not None for row in named) and len(set(named)) == len(named):
        return np.array(named, dtype=np.int64)
    by_caption: dict[str, list[int]] = defaultdict(list)
    for row in reversed(range(real.samples.num_sequences)):
        by_caption[real.samples.captions[row]].append(row)
    found = [by_caption[text].pop() if by_caption[text] else None for text in samples.captions]
    if any(row is None for row in found):
        return None
    return np.array(found, dtype=np.int64)


def _cropped(samples: SampleSet, fps: Fraction, longest_seconds: float) -> SampleSet:
    kept = [middle(sequence, fps, longest_seconds) for sequence in samples.sequences()]
    if all(len(sequence) == frames for sequence, frames in zip(kept, samples.num_frames.tolist(), strict=True)):
        return samples
    return samples.with_positions(samples.name, fps, kept)
