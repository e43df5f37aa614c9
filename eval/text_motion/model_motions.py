"""What a trained model makes for the captions and durations of real motions, as embeddings that are kept."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction
from functools import partial
from hashlib import sha256
from json import dumps

import numpy as np
from jaxtyping import Float32, Float64

from eval.sets.sets import SampleSet, sample_set
from eval.text_motion.embedding_cache import Embedder
from eval.text_motion.pairs import TextMotionPairs
from eval.text_motion.protocol import MultiModalityRule
from eval.text_motion.real_pairs import CaptionedMotions, as_kit_joints
from motionkit.fields.contact.planted import planted
from motionkit.fields.motion_field import MotionField, to_motion
from motionkit.generate.models import GenerationRequest, GenerativeModel

AT_ONCE = 128
REPEATED_FROM = 1_000_000
"""Requests of MultiModality are numbered from here, so that they share no random numbers with the others."""


@dataclass(frozen=True, eq=False)
class ModelMotions:
    """A model and what it is asked for; `identity` is all that its motions depend on besides request and seed.

    With `kit_lengths` its motions are brought to KIT-ML's 21 joints before they are embedded, with `is_planted` their
    feet are made to stand. Raises what the model raises for a caption it cannot take, when motions are first asked for.
    """

    name: str
    model: GenerativeModel
    identity: Mapping[str, str]
    seed: int
    kit_lengths: Float32[np.ndarray, "21"] | None = None
    on_motions: Callable[[int], None] = lambda count: None
    is_planted: bool = False

    def draw(self, wanted: CaptionedMotions, number: int, embedder: Embedder) -> TextMotionPairs:
        """One motion for each caption, as long as the real one; `number` counts independent draws."""
        requests = _requests(wanted)
        motions = self._embedded(requests, self.seed + number, 0, wanted.samples.fps, embedder)
        return TextMotionPairs(embedder.texts(wanted.captions), motions, wanted.samples.sequence_ids)

    def repeated(
        self, wanted: CaptionedMotions, rule: MultiModalityRule, most_motions: int, embedder: Embedder
    ) -> Float64[np.ndarray, "texts generations features"] | None:
        """Several motions of one caption each, of as many captions as the rule asks and `most_motions` allows.

        None where not two motions of one text fit.
        """
        generations = min(rule.num_generations, most_motions)
        if generations < 2:
            return None
        different = np.unique(wanted.samples.captions, return_index=True)[1]
        texts = min(rule.num_texts or len(different), len(different), most_motions // generations)
        chosen = np.random.default_rng((self.seed, 8)).choice(different, size=texts, replace=False)
        requests = [request for request in _requests(wanted.select(np.sort(chosen))) for _ in range(generations)]
        found = self._embedded(requests, self.seed, REPEATED_FROM, wanted.samples.fps, embedder)
        return found.reshape(texts, generations, -1)

    def _embedded(
        self, requests: Sequence[GenerationRequest], seed: int, first: int, fps: Fraction, embedder: Embedder
    ) -> Float64[np.ndarray, "requests features"]:
        requests_sha256 = sha256(dumps([asdict(request) for request in requests]).encode()).hexdigest()
        key = {"model": dict(self.identity), "requests": requests_sha256, "seed": seed, "first": first, "fps": str(fps)}
        if self.is_planted:
            key["planted"] = "free"
        if self.kit_lengths is not None:
            key["kit_lengths"] = sha256(self.kit_lengths.astype("<f4").tobytes()).hexdigest()
        return embedder.kept(key, len(requests), partial(self._generated, requests, seed, first, fps, embedder))

    def _generated(
        self, requests: Sequence[GenerationRequest], seed: int, first: int, fps: Fraction, embedder: Embedder
    ) -> Float64[np.ndarray, "requests features"]:
        motions = self._motions(requests, seed, first, fps)
        if self.kit_lengths is not None:
            motions = as_kit_joints(motions, self.kit_lengths)
        return embedder.evaluator.embed_motions(motions)

    def _motions(self, requests: Sequence[GenerationRequest], seed: int, first: int, fps: Fraction) -> SampleSet:
        sequences = []
        for start in range(0, len(requests), AT_ONCE):
            some = requests[start : start + AT_ONCE]
            fields: Sequence[MotionField] = self.model.generate(some, seed=seed, first=first + start)
            if self.is_planted:
                fields = [planted(field, "free") for field in fields]
            sequences += [to_motion(field, fps).joint_positions for field in fields]
            self.on_motions(len(some))
        names = [f"motion {first + index}" for index in range(len(requests))]
        return sample_set(self.name, fps, sequences, names, [request.text for request in requests])


def _requests(wanted: CaptionedMotions) -> list[GenerationRequest]:
    """Text and duration alone: a model that was trained without texts cannot have a row of text-to-motion."""
    texts = [caption.text for caption in wanted.captions]
    return [GenerationRequest(seconds, text) for seconds, text in zip(wanted.durations_seconds, texts, strict=True)]
