"""Real captioned motions of whole length at one framerate: the reference of text-to-motion metrics."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from eval.sets.motions import NoRealMotionError, real_motion
from eval.sets.sets import SampleSet, middle, sample_set
from eval.text_motion.protocol import LengthRule
from motionkit.core.motion import Caption
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import KIT21, SMPL22
from motionkit.core.skeletons.mapping import joint_map
from motionkit.features.humanml3d import bone_lengths, uniform_skeleton

if TYPE_CHECKING:
    from motionkit.store.reader import Store


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

    @property
    def durations_seconds(self) -> list[float]:
        """Duration from the first pose to the last of each motion."""
        return [float((frames - 1) / self.samples.fps) for frames in self.samples.sequences.num_frames.tolist()]

    def select(self, rows: npt.NDArray[np.int64]) -> "CaptionedMotions":
        """Some of them, in the order of `rows`."""
        captions = tuple(self.captions[row] for row in rows.tolist())
        return replace(self, samples=self.samples.select(rows), captions=captions)


def limited(rule: LengthRule, longest_seconds: float) -> LengthRule:
    """The rule for a model of shorter motions: real ones are cropped to its longest duration."""
    if longest_seconds >= rule.longest_seconds:
        return rule
    return LengthRule(min(rule.shortest_seconds, longest_seconds), longest_seconds, "cropped")


def captioned_motions(
    store: "Store", split: str, where: str | None, fps: Fraction, rule: LengthRule, layout: str = SMPL22.name
) -> CaptionedMotions:
    """Captioned sequences of native rate ≥ fps, resampled to fps: of each the stretch that its first caption describes.

    Their joints are those of `layout`. Longer ones are cropped to the middle or left out, by the rule. Raises
    `NoRealMotionError` if fewer than two remain, and as `real_motion`.
    """
    everything = real_motion(store, split, where, layout)
    captions_of = _captions(store)
    at_rate = everything.at(fps)
    most_frames = rule.most_frames(fps)
    left_out = Counter({f"captured below {float(fps):g} fps": len(everything.fps) - at_rate.num_sequences})
    sequences, names, captions, num_cropped = [], [], [], 0
    for index, name in enumerate(at_rate.sequence_ids):
        if not captions_of[name]:
            left_out["without a caption"] += 1
            continue
        caption = captions_of[name][0]
        positions = _stretch(at_rate.sequences[index], caption, fps)
        seconds = (len(positions) - 1) / float(fps)
        if seconds < rule.shortest_seconds - 1e-9:
            left_out[f"shorter than {rule.shortest_seconds:g} s"] += 1
            continue
        if len(positions) > most_frames and rule.longer == "left out":
            left_out[f"longer than {rule.longest_seconds:g} s"] += 1
            continue
        kept = middle(positions, most_frames)
        num_cropped += len(kept) < len(positions)
        sequences.append(kept)
        names.append(name)
        captions.append(caption)
    if len(sequences) < 2:
        reasons = "; ".join(f"{count} {reason}" for reason, count in left_out.items() if count)
        raise NoRealMotionError(
            f"{everything.name}: {len(sequences)} captioned sequences at {float(fps):g} fps, at least two are needed "
            f"({reasons})"
        )
    texts = [caption.text for caption in captions]
    known = {caption.text: caption for some in captions_of.values() for caption in some}
    samples = sample_set(everything.name, fps, sequences, names, texts)
    return CaptionedMotions(samples, tuple(captions), known, {k: v for k, v in left_out.items() if v}, num_cropped)


def _stretch(positions: npt.NDArray[np.float32], caption: Caption, fps: Fraction) -> npt.NDArray[np.float32]:
    """The poses in [start, end) of a caption."""
    first = ceil(caption.start_seconds * float(fps) - 1e-6)
    last = None if caption.end_seconds is None else ceil(caption.end_seconds * float(fps) - 1e-6)
    return positions[first:last]


def _captions(store: "Store") -> dict[str, list[Caption]]:
    table = store.columns("sequence_id", "captions")
    return {
        str(name): [Caption(**caption) for caption in found]
        for name, found in zip(table["sequence_id"], table["captions"], strict=True)
    }


MADE_OF_22 = "its 21 joints made of 22, with the real motions' bone lengths"


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
    made = [
        uniform_skeleton(np.matmul(weights, sequence), KIT21.name, lengths).astype(np.float32)
        for sequence in samples.sequences
    ]
    return samples.with_positions(samples.name, samples.fps, made)
