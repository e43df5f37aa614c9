"""Motions of text-to-motion and their embeddings: real captioned ones, and those that a model generates for them."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from eval.native_evaluator.evaluator import NativeEvaluator
from eval.sets.motions import AT_ONCE, NoRealMotionError, real_motion
from eval.sets.sets import RowId, SampleSet, Variant, middle, sample_set
from eval.text_motion.guo import GuoEvaluator
from eval.text_motion.protocol import NUM_GENERATIONS, LengthRule, MultiModalityRule
from eval.text_motion.scores import TextMotionPairs
from motionkit.core.errors import counted
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
MADE_OF_22 = "its 21 joints made of 22, with the real motions' bone lengths"
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
    return samples.with_positions(samples.name, samples.fps, sequences)


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
