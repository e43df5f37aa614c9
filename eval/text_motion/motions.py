"""Motions of text-to-motion and their embeddings: real captioned ones, and those of models and samples beside them."""

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from eval.native_evaluator.evaluator import NativeEvaluator
from eval.sample_folder.folder import SampleFolder, rows_by_name
from eval.sets.motions import AT_ONCE, NoRealMotionError, real_motion
from eval.sets.sets import RowId, SampleSet, Variant, middle, sample_set
from eval.text_motion.guo import GuoEvaluator
from eval.text_motion.protocol import NUM_GENERATIONS, LengthRule, MultiModalityRule, TextMotionProtocol
from eval.text_motion.scores import TextMotionPairs
from motionkit.core.errors import UsageError, counted
from motionkit.core.motion import Caption
from motionkit.core.shapes import Float32, Float64, Int64
from motionkit.core.skeleton import KIT21, SMPL22
from motionkit.core.skeletons.mapping import joint_map
from motionkit.features.humanml3d import bone_lengths, uniform_skeleton
from motionkit.fields.contact.planted import planted
from motionkit.fields.motion_field import to_motion
from motionkit.generate.models import GenerationRequest, GenerativeModel

if TYPE_CHECKING:
    from motionkit.store.reader import Store

REPEATED_FROM = 1_000_000
"""Requests of MultiModality are numbered from here, so that they share no random numbers with the others."""
AS_VECTORS = "; read as the pose vectors that they came as"
BY_JOINTS = "; read as pose vectors made of joint positions, as they did not come as such of this size and framerate"
FROM_22_JOINTS = "its 21 joints made of 22, with the real motions' bone lengths"
Embeddings = Float64[np.ndarray, "rows features"]
TextMotionEvaluator = GuoEvaluator | NativeEvaluator
"""Embeds whole motions and sentences in one space; a motion's row depends on that motion alone, not on its batch."""


def embed_captions(evaluator: TextMotionEvaluator, captions: Sequence[Caption]) -> Embeddings:
    """One row per caption; the rows of equal captions are equal, which the ranks of R-Precision depend on."""
    different = list(dict.fromkeys(captions))
    row = {caption: index for index, caption in enumerate(different)}
    return evaluator.embed_texts(different)[[row[caption] for caption in captions]]


@dataclass(frozen=True, eq=False)
class CaptionedMotions:
    """Motions, each with its caption; `known_captions` are all captions of the split by their text.

    `left_out` counts excluded sequences by reason, `num_cropped` cropped ones.
    """

    samples: SampleSet
    captions: tuple[Caption, ...]
    known_captions: Mapping[str, Caption]
    left_out: Mapping[str, int]
    num_cropped: int

    def requests(self) -> list[GenerationRequest]:
        """For each motion its text and its duration, from the first pose to the last."""
        # Nothing else: a model trained without texts cannot have a row of text-to-motion.
        seconds = [float((frames - 1) / self.samples.fps) for frames in self.samples.sequences.num_frames.tolist()]
        return [GenerationRequest(*each) for each in zip(seconds, (each.text for each in self.captions), strict=True)]

    def select(self, rows: Int64[np.ndarray, "chosen"]) -> "CaptionedMotions":
        """Some of them, in the order of `rows`."""
        captions = tuple(self.captions[row] for row in rows.tolist())
        return replace(self, samples=self.samples.select(rows), captions=captions)


def captioned_motions(
    store: "Store", split: str, where: str | None, fps: Fraction, rule: LengthRule, layout: str = SMPL22.name
) -> CaptionedMotions:
    """Captioned sequences of native rate ≥ fps, resampled to fps: of each the frames that its first caption describes.

    Their joints are those of `layout`. Longer ones are cropped to the middle or left out, by the rule. Raises
    `NoRealMotionError` if fewer than two remain, and as `real_motion`.
    """
    everything = real_motion(store, split, where, layout)
    table = store.columns("sequence_id", "captions")
    captions_of = {
        str(name): [Caption(**caption) for caption in some]
        for name, some in zip(table["sequence_id"], table["captions"], strict=True)
    }
    at_rate = everything.at(fps)
    most_frames = rule.most_frames(fps)
    left_out = Counter({f"captured below {float(fps):g} fps": len(everything.fps) - at_rate.num_sequences})
    sequences, names, captions, num_cropped = [], [], [], 0
    for name, positions in zip(at_rate.sequence_ids, at_rate.sequences, strict=True):
        if not captions_of[name]:
            left_out["without a caption"] += 1
            continue
        caption = captions_of[name][0]
        first = ceil(caption.start_seconds * float(fps) - 1e-6)
        last = None if caption.end_seconds is None else ceil(caption.end_seconds * float(fps) - 1e-6)
        described = positions[first:last]
        if (len(described) - 1) / float(fps) < rule.shortest_seconds - 1e-9:
            left_out[f"shorter than {rule.shortest_seconds:g} s"] += 1
            continue
        if len(described) > most_frames and rule.longer == "left out":
            left_out[f"longer than {rule.longest_seconds:g} s"] += 1
            continue
        num_cropped += len(described) > most_frames
        sequences.append(middle(described, most_frames))
        names.append(name)
        captions.append(caption)
    left_out = +left_out  # without zeros
    if len(sequences) < 2:
        reasons = "; ".join(f"{count} {reason}" for reason, count in left_out.items())
        raise NoRealMotionError(
            f"{everything.name}: {counted(len(sequences), 'captioned sequence')} at {float(fps):g} fps, at least two "
            f"are needed ({reasons})"
        )
    samples = sample_set(everything.name, fps, sequences, names, [caption.text for caption in captions])
    known = {caption.text: caption for some in captions_of.values() for caption in some}
    return CaptionedMotions(samples, tuple(captions), known, left_out, num_cropped)


def kit_bone_lengths(real: SampleSet) -> Float32[np.ndarray, "21"] | None:
    """Bone lengths of a real set of KIT's 21 joints in metres: medians over the first poses, as KIT-ML has one body.

    None for a set of 22 joints.
    """
    if real.sequences.values.shape[1] != KIT21.num_joints:
        return None
    lengths = [bone_lengths(sequence[0], KIT21.name) for sequence in real.sequences]
    return np.asarray(np.median(np.stack(lengths), axis=0), dtype=np.float32)


def as_kit_joints(samples: SampleSet, lengths: Float32[np.ndarray, "21"]) -> SampleSet:
    """22-joint motions as KIT's 21 joints with these bone lengths; the path is scaled by the ratio of leg lengths."""
    weights = joint_map(SMPL22, KIT21.name).weights
    sequences = [
        uniform_skeleton(np.matmul(weights, sequence), KIT21.name, lengths).astype(np.float32)
        for sequence in samples.sequences
    ]
    return samples.with_positions(sequences)


@dataclass(frozen=True, eq=False)
class ModelMotions:
    """Embeddings of a model's motions as they are and planted, which are two rows of a table; each is generated once.

    With `kit_lengths` motions are converted to KIT-ML's 21 joints before embedding. Raises what the model raises for a
    caption it does not support.
    """

    name: str
    model: GenerativeModel
    evaluator: TextMotionEvaluator
    seed: int
    kit_lengths: Float32[np.ndarray, "21"] | None = None
    on_motions: Callable[[int], None] = lambda count: None

    def draw(self, real: CaptionedMotions, texts: Embeddings, number: int) -> dict[RowId, TextMotionPairs]:
        """One motion for each caption, as long as the real one; `number` counts independent draws."""
        embedded = self._embedded(real.requests(), self.seed + number, 0, real.samples.fps)
        return {row: TextMotionPairs(texts, motions, real.samples.sequence_ids) for row, motions in embedded.items()}

    def repeated(
        self, real: CaptionedMotions, rule: MultiModalityRule, most_motions: int
    ) -> dict[RowId, Float64[np.ndarray, "texts generations features"]]:
        """Several motions per caption, for as many captions as the rule has and `most_motions` allows.

        Empty if not even two motions of one text are allowed.
        """
        generations = min(NUM_GENERATIONS, most_motions)
        if generations < 2:
            return {}
        different = np.unique(real.samples.captions, return_index=True)[1]
        texts = min(rule.num_texts or len(different), len(different), most_motions // generations)
        chosen = np.random.default_rng((self.seed, 8)).choice(different, size=texts, replace=False)
        requests = [each for each in real.select(np.sort(chosen)).requests() for _ in range(generations)]
        embedded = self._embedded(requests, self.seed, REPEATED_FROM, real.samples.fps)
        return {row: motions.reshape(texts, generations, -1) for row, motions in embedded.items()}

    def _embedded(
        self, requests: Sequence[GenerationRequest], seed: int, first: int, fps: Fraction
    ) -> dict[RowId, Embeddings]:
        names = [f"motion {first + index}" for index in range(len(requests))]
        as_it_is, planted_row = RowId(self.name), RowId(self.name, Variant.PLANTED)
        positions: dict[RowId, list[Float32[np.ndarray, "_frames 22 3"]]] = {as_it_is: [], planted_row: []}
        for start in range(0, len(requests), AT_ONCE):
            fields = self.model.generate(requests[start : start + AT_ONCE], seed=seed, first=first + start)
            motions = [to_motion(field, fps).joint_positions for field in fields]
            sample_set(self.name, fps, motions, names[start : start + AT_ONCE])  # raises for NaN, which plants nowhere
            positions[as_it_is] += motions
            positions[planted_row] += [to_motion(planted(field, "free"), fps).joint_positions for field in fields]
            self.on_motions(len(motions))
        sets = {row: sample_set(str(row), fps, motions, names) for row, motions in positions.items()}
        if (lengths := self.kit_lengths) is not None:
            sets = {row: as_kit_joints(each, lengths) for row, each in sets.items()}
        return {row: self.evaluator.embed_motions(each) for row, each in sets.items()}


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
    samples = samples.with_positions(cropped)
    motions, remark = _embedded(folder, samples, real.samples, most_frames, evaluator)
    texts = embed_captions(evaluator, [real.known_captions.get(text, Caption(text)) for text in samples.captions])
    groups = [np.array(rows) for rows in samples.rows_by_group().values()]
    most = max(map(len, groups))
    repeated = motions[np.stack([rows for rows in groups if len(rows) == most])] if most > 1 else None
    of_groups = _real_rows(samples.select(np.array([rows[0] for rows in groups])), real)
    real_rows = None
    if protocol.reference == "paired":
        pairs = [(rows, row) for rows, row in zip(groups, of_groups, strict=True) if row is not None]
        if not pairs:
            raise UsageError(
                f"protocol {protocol.name!r} compares with the real motions of the same texts; name the files after "
                "the real sequences, or give them the captions of real sequences of this split"
            )
        if without := len(groups) - len(pairs):
            remark += f"; {without:,} of {len(groups):,} have no real motion of their text: left out"
        groups, of_groups = [rows for rows, _ in pairs], [row for _, row in pairs]
        real_rows = np.array(of_groups, dtype=np.int64)
    ids = real.samples.sequence_ids
    takes = tuple(f"prompt {number}" if row is None else ids[row] for number, row in enumerate(of_groups))
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
        own = samples.with_positions(joints)
        return evaluator.embed_motions(own), f"{BY_JOINTS}; KIT-ML's joints as they came"
    return evaluator.embed_motions(as_kit_joints(samples, kit_lengths)), f"{BY_JOINTS}; {FROM_22_JOINTS}"


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
