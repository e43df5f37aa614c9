"""Embeddings of another system's samples: repetitions of a prompt become draws and MultiModality."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eval.sample_folder import SampleFolder
from eval.sample_folder.folder import rows_by_name
from eval.sets.sets import SampleSet, middle
from eval.text_motion.embedding_cache import Embedder, fingerprint_of_vectors
from eval.text_motion.evaluator import PoseVectorEvaluator
from eval.text_motion.pairs import TextMotionPairs
from eval.text_motion.protocol import TextMotionProtocol
from eval.text_motion.real_pairs import MADE_OF_22, CaptionedMotions, as_kit_joints, kit_bone_lengths
from motionkit.core.errors import UsageError
from motionkit.core.motion import Caption
from motionkit.core.shapes import Float64

AS_VECTORS = "read as the pose vectors that they came as"
BY_JOINTS = "read as pose vectors made of joint positions"
AS_KIT_JOINTS = "of KIT-ML's joints as they came"


@dataclass(frozen=True, eq=False)
class SampleEmbeddings:
    """`draws` are the k-th motions of every prompt, `real_rows` their real motions if the protocol pairs them.

    `remarks` states how motions were converted for an evaluator of pose vectors, and which have no real motion.
    """

    draws: tuple[TextMotionPairs, ...]
    repeated: Float64[np.ndarray, "texts generations features"] | None
    real_rows: npt.NDArray[np.int64] | None
    remarks: tuple[str, ...] = ()


def sample_embeddings(
    folder: SampleFolder, real: CaptionedMotions, protocol: TextMotionProtocol, embedder: Embedder
) -> SampleEmbeddings:
    """Embed a folder's motions and captions; motions longer than allowed are cropped like the real ones.

    A caption that the real set has too keeps its tokens. If the protocol pairs motions with real ones, prompts
    without a real motion are dropped. Raises `SampleFolderError` for a missing caption, and `UsageError` if no sample
    matches a real motion by name or caption.
    """
    folder.require("caption")
    fps = real.samples.fps
    most_frames = protocol.lengths_at(fps).most_frames(fps)
    samples = _cropped(folder.at(fps), most_frames)
    captions = [real.known_captions.get(text, Caption(text)) for text in samples.captions]
    motions, path = _embedded(folder, samples, real.samples, most_frames, embedder)
    texts = embedder.texts(captions)
    groups = [np.array(rows) for rows in samples.rows_by_group().values()]
    repeated, remarks = _repeated(motions, groups), [path] if path else []
    paired = None
    found = _real_rows(samples.select(np.array([rows[0] for rows in groups])), real)
    if protocol.reference == "paired":
        paired = np.array([row for row in found if row is not None], dtype=np.int64)
        if not len(paired):
            raise UsageError(
                f"protocol {protocol.name!r} compares with the real motions of the same texts; name the files after "
                "the real sequences, or give them the captions of real sequences of this split"
            )
        if len(paired) < len(groups):
            without = len(groups) - len(paired)
            remarks.append(
                f"{without:,} of {len(groups):,} have no real motion of their text that takes part: left out"
            )
        groups = [rows for rows, row in zip(groups, found, strict=True) if row is not None]
        found = [row for row in found if row is not None]
    ids = real.samples.sequence_ids
    takes = tuple(f"prompt {number}" if row is None else ids[row] for number, row in enumerate(found))
    fewest = min(len(rows) for rows in groups)
    firsts = [np.array([rows[number] for rows in groups]) for number in range(fewest)]
    draws = tuple(TextMotionPairs(texts[rows], motions[rows], takes) for rows in firsts)
    return SampleEmbeddings(draws, repeated, paired, tuple(remarks))


def _embedded(
    folder: SampleFolder, samples: SampleSet, real: SampleSet, most_frames: int, embedder: Embedder
) -> tuple[Float64[np.ndarray, "motions features"], str]:
    """Embeddings of a folder's motions: from its pose vectors if the evaluator reads them, else from joints."""
    evaluator = embedder.evaluator
    if not isinstance(evaluator, PoseVectorEvaluator):
        return embedder.motions(samples), ""
    reason = _why_not_vectors(folder, evaluator)
    if reason:
        joints, of_what = _in_layout_of(real, folder, samples, most_frames)
        return embedder.motions(joints), f"{BY_JOINTS}{of_what} ({reason})"
    # T poses make T − 1 vectors, so the longest motion has one vector fewer than poses.
    lengths = np.minimum(folder.sequences.num_frames, most_frames - 1).tolist()
    vectors = [
        # A crop is followed by the motion itself; only whole motions are followed by the stored padding.
        motion if length == frames else middle(motion[:frames], length)
        for motion, length, frames in zip(folder.vectors, lengths, folder.sequences.num_frames.tolist(), strict=True)
    ]
    key = {"vectors": fingerprint_of_vectors(vectors), "lengths": lengths}
    return embedder.kept(key, len(vectors), lambda: evaluator.embed_vectors(vectors, lengths)), AS_VECTORS


def _in_layout_of(real: SampleSet, folder: SampleFolder, samples: SampleSet, most_frames: int) -> tuple[SampleSet, str]:
    """A folder's motions in the joints of the real ones, and, for KIT-ML's, a remark on the conversion."""
    lengths = kit_bone_lengths(real)
    if lengths is None:
        return samples, ""
    if folder.kit_joints and set(folder.fps) == {samples.fps}:
        kept = [middle(motion, most_frames) for motion in folder.kit_joints]
        return samples.with_positions(samples.name, samples.fps, kept), f" {AS_KIT_JOINTS}"
    return as_kit_joints(samples, lengths), f", {MADE_OF_22}"


def _why_not_vectors(folder: SampleFolder, evaluator: PoseVectorEvaluator) -> str:
    """Why a folder's pose vectors cannot be embedded directly; empty if they can."""
    if not folder.vectors:
        return "not all came as vectors of one size"
    if folder.vectors[0].shape[1] != evaluator.vector_size:
        return f"vectors of {folder.vectors[0].shape[1]} numbers, it reads {evaluator.vector_size}"
    return "" if set(folder.fps) == {evaluator.fps} else f"vectors of another framerate than {evaluator.fps} fps"


def _repeated(
    motions: Float64[np.ndarray, "motions features"], groups: Sequence[npt.NDArray[np.int64]]
) -> Float64[np.ndarray, "texts generations features"] | None:
    """Motions of the prompts with most repetitions; None without repetitions."""
    most = max(len(rows) for rows in groups)
    if most < 2:
        return None
    return motions[np.stack([rows for rows in groups if len(rows) == most])]


def _real_rows(samples: SampleSet, real: CaptionedMotions) -> list[int | None]:
    """The real motion of each sample, each used once, or None: by names if most match, else by captions."""
    named = rows_by_name(samples.sequence_ids, real.samples.sequence_ids)
    fitting = [row for row in named if row is not None]
    if 2 * len(fitting) > len(named) and len(set(fitting)) == len(fitting):
        return named
    by_caption: dict[str, list[int]] = defaultdict(list)
    for row in reversed(range(real.samples.num_sequences)):
        by_caption[real.samples.captions[row]].append(row)
    return [by_caption[text].pop() if by_caption[text] else None for text in samples.captions]


def _cropped(samples: SampleSet, most_frames: int) -> SampleSet:
    if int(samples.sequences.num_frames.max()) <= most_frames:
        return samples
    kept = [middle(sequence, most_frames) for sequence in samples.sequences]
    return samples.with_positions(samples.name, samples.fps, kept)
