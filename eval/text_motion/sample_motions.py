"""Another system's samples as embeddings: repeated answers to one prompt become draws and MultiModality."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt
from jaxtyping import Float64

from eval.embedding_cache import Embedder
from eval.protocols.text_motion import TextMotionProtocol
from eval.sample_folder import SampleFolder
from eval.samples import SampleSet
from eval.scoring.text_motion import TextMotionPairs
from eval.text_motion.real_pairs import CaptionedMotions, middle
from motionkit.errors import UsageError
from motionkit.motion import Caption


@dataclass(frozen=True, eq=False)
class SampleEmbeddings:
    """`draws` are the k-th answers to every prompt, `real_rows` the real motions of these where a protocol pairs."""

    draws: tuple[TextMotionPairs, ...]
    repeated: Float64[np.ndarray, "texts generations features"] | None
    real_rows: npt.NDArray[np.int64] | None


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
    motions, texts = embedder.motions(samples), embedder.texts(captions)
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
        tuple(TextMotionPairs(texts[rows], motions[rows]) for rows in firsts), _repeated(motions, groups), paired
    )


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
