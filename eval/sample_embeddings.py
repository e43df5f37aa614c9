"""A folder of samples as an evaluator of text and motion embeds it, beside the real motions of the same texts."""

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from eval.sample_folder.folder import SampleFolder, rows_by_name
from eval.sets.sets import SampleSet, middle
from eval.text_motion.guo import GuoEvaluator
from eval.text_motion.motions import (
    MADE_OF_22,
    CaptionedMotions,
    TextMotionEvaluator,
    as_kit_joints,
    embed_captions,
    kit_bone_lengths,
)
from eval.text_motion.protocol import TextMotionProtocol
from eval.text_motion.scores import TextMotionPairs
from motionkit.core.errors import UsageError
from motionkit.core.motion import Caption
from motionkit.core.shapes import Float64, Int64

AS_VECTORS = "; read as the pose vectors that they came as"
BY_JOINTS = "; read as pose vectors made of joint positions, as they did not come as such of this size and framerate"


@dataclass(frozen=True, eq=False)
class Embedded:
    """A row's embeddings: independent draws of its motions, and several motions of one text for MultiModality.

    `real_rows` are the real motions of the same texts, with which the protocol compares; None for all.
    """

    draws: list[TextMotionPairs]
    real_rows: Int64[np.ndarray, "pairs"] | None
    repeated: Float64[np.ndarray, "texts generations features"] | None = None
    note: str = ""


def sample_embeddings(
    folder: SampleFolder, real: CaptionedMotions, protocol: TextMotionProtocol, evaluator: TextMotionEvaluator
) -> Embedded:
    """Embed a folder's motions and captions: draw k has the k-th motion of every prompt.

    Motions longer than allowed are cropped like the real ones. A caption that the real set has too keeps its tokens. If
    the protocol pairs motions with real ones, prompts without a real motion are dropped. Raises `SampleFolderError` for
    a missing caption, and `UsageError` if no sample matches a real motion by name or caption.
    """
    folder.require("caption")
    fps = real.samples.fps
    most_frames = protocol.lengths_at(fps).most_frames(fps)
    samples = folder.at(fps)
    cropped = [middle(sequence, most_frames) for sequence in samples.sequences]
    samples = samples.with_positions(samples.name, samples.fps, cropped)
    motions, remark = _embedded(folder, samples, real.samples, most_frames, evaluator)
    texts = embed_captions(evaluator, [real.known_captions.get(text, Caption(text)) for text in samples.captions])
    groups = [np.array(rows) for rows in samples.rows_by_group().values()]
    most = max(map(len, groups))
    repeated = motions[np.stack([rows for rows in groups if len(rows) == most])] if most > 1 else None
    found = _real_rows(samples.select(np.array([rows[0] for rows in groups])), real)
    real_rows = None
    if protocol.reference == "paired":
        pairs = [(rows, row) for rows, row in zip(groups, found, strict=True) if row is not None]
        if not pairs:
            raise UsageError(
                f"protocol {protocol.name!r} compares with the real motions of the same texts; name the files after "
                "the real sequences, or give them the captions of real sequences of this split"
            )
        if without := len(groups) - len(pairs):
            remark += f"; {without:,} of {len(groups):,} have no real motion of their text: left out"
        groups, found = [rows for rows, _ in pairs], [row for _, row in pairs]
        real_rows = np.array(found, dtype=np.int64)
    ids = real.samples.sequence_ids
    takes = tuple(f"prompt {number}" if row is None else ids[row] for number, row in enumerate(found))
    draws = [TextMotionPairs(texts[rows], motions[rows], takes) for rows in map(np.array, zip(*groups, strict=False))]
    return Embedded(draws, real_rows, repeated, folder.describe() + remark)


def _embedded(
    folder: SampleFolder, samples: SampleSet, real: SampleSet, most_frames: int, evaluator: TextMotionEvaluator
) -> tuple[Float64[np.ndarray, "motions features"], str]:
    """Embeddings of a folder's motions, from its pose vectors if the evaluator reads them, and a note on this."""
    if not isinstance(evaluator, GuoEvaluator):
        return evaluator.embed_motions(samples), ""
    sizes = {motion.shape[1] for motion in folder.vectors}
    if sizes == {evaluator.kind.published.num_values} and set(folder.fps) == {evaluator.fps}:
        # T poses make T − 1 vectors, so the longest motion has one vector fewer than poses.
        lengths = folder.sequences.num_frames.tolist()
        vectors = [
            middle(motion[:frames], most_frames - 1) for motion, frames in zip(folder.vectors, lengths, strict=True)
        ]
        return evaluator.embed_vectors(vectors), AS_VECTORS
    kit_lengths = kit_bone_lengths(real)
    if kit_lengths is None:
        return evaluator.embed_motions(samples), BY_JOINTS
    if folder.kit_joints and set(folder.fps) == {samples.fps}:
        joints = [middle(motion, most_frames) for motion in folder.kit_joints]
        own = samples.with_positions(samples.name, samples.fps, joints)
        return evaluator.embed_motions(own), f"{BY_JOINTS}; KIT-ML's joints as they came"
    return evaluator.embed_motions(as_kit_joints(samples, kit_lengths)), f"{BY_JOINTS}; {MADE_OF_22}"


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
