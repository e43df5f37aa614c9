"""Motions that a trained model generates for the captions and durations of real ones, as cached embeddings.

Every motion is generated once and embedded both as it is and planted: two rows of a table.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction
from functools import cache
from hashlib import sha256
from json import dumps

import numpy as np

from eval.sets.motions import AT_ONCE
from eval.sets.sets import RowId, SampleSet, Variant, sample_set
from eval.text_motion.embedding_cache import Embedder
from eval.text_motion.pairs import TextMotionPairs
from eval.text_motion.protocol import MultiModalityRule
from eval.text_motion.real_pairs import CaptionedMotions, as_kit_joints
from motionkit.core.shapes import Float32, Float64
from motionkit.fields.contact.planted import planted
from motionkit.fields.motion_field import to_motion
from motionkit.generate.models import GenerationRequest, GenerativeModel

REPEATED_FROM = 1_000_000
"""Requests of MultiModality are numbered from here, so that they share no random numbers with the others."""


@dataclass(frozen=True, eq=False)
class ModelMotions:
    """A model and its requests; `identity` is all that its motions depend on besides request and seed.

    It yields the row of the system `name`, and that of its planted motions. With `kit_lengths` motions are converted
    to KIT-ML's 21 joints before embedding. Raises what the model raises for a caption it does not support, when motions
    are first requested.
    """

    name: str
    model: GenerativeModel
    identity: Mapping[str, str]
    seed: int
    kit_lengths: Float32[np.ndarray, "21"] | None = None
    on_motions: Callable[[int], None] = lambda count: None

    @property
    def rows(self) -> tuple[RowId, RowId]:
        """Both rows."""
        return RowId(self.name), RowId(self.name, Variant.PLANTED)

    def draw(self, wanted: CaptionedMotions, number: int, embedder: Embedder) -> dict[RowId, TextMotionPairs]:
        """One motion for each caption, as long as the real one; `number` counts independent draws."""
        made = self._embedded(_requests(wanted), self.seed + number, 0, wanted.samples.fps, embedder)
        texts = embedder.texts(wanted.captions)
        return {row: TextMotionPairs(texts, motions, wanted.samples.sequence_ids) for row, motions in made.items()}

    def repeated(
        self, wanted: CaptionedMotions, rule: MultiModalityRule, most_motions: int, embedder: Embedder
    ) -> dict[RowId, Float64[np.ndarray, "texts generations features"]]:
        """Several motions per caption, for as many captions as the rule asks and `most_motions` allows.

        Empty if not even two motions of one text are allowed.
        """
        generations = min(rule.num_generations, most_motions)
        if generations < 2:
            return {}
        different = np.unique(wanted.samples.captions, return_index=True)[1]
        texts = min(rule.num_texts or len(different), len(different), most_motions // generations)
        chosen = np.random.default_rng((self.seed, 8)).choice(different, size=texts, replace=False)
        requests = [request for request in _requests(wanted.select(np.sort(chosen))) for _ in range(generations)]
        made = self._embedded(requests, self.seed, REPEATED_FROM, wanted.samples.fps, embedder)
        return {row: motions.reshape(texts, generations, -1) for row, motions in made.items()}

    def _embedded(
        self, requests: Sequence[GenerationRequest], seed: int, first: int, fps: Fraction, embedder: Embedder
    ) -> dict[RowId, Float64[np.ndarray, "requests features"]]:
        requests_sha256 = sha256(dumps([asdict(request) for request in requests]).encode()).hexdigest()
        key = {"model": dict(self.identity), "requests": requests_sha256, "seed": seed, "first": first, "fps": str(fps)}
        if self.kit_lengths is not None:
            key["kit_lengths"] = sha256(self.kit_lengths.astype("<f4").tobytes()).hexdigest()

        @cache
        def motions() -> dict[RowId, SampleSet]:
            return self._motions(requests, seed, first, fps)

        def kept(row: RowId, key: Mapping[str, object]) -> Float64[np.ndarray, "requests features"]:
            return embedder.kept(key, len(requests), lambda: embedder.evaluator.embed_motions(motions()[row]))

        as_it_is, planted_row = self.rows
        return {as_it_is: kept(as_it_is, key), planted_row: kept(planted_row, key | {"planted": "free"})}

    def _motions(
        self, requests: Sequence[GenerationRequest], seed: int, first: int, fps: Fraction
    ) -> dict[RowId, SampleSet]:
        names = [f"motion {first + index}" for index in range(len(requests))]
        texts = [request.text for request in requests]
        as_it_is, planted_row = self.rows
        positions: dict[RowId, list[Float32[np.ndarray, "_frames 22 3"]]] = {as_it_is: [], planted_row: []}
        for start in range(0, len(requests), AT_ONCE):
            fields = self.model.generate(requests[start : start + AT_ONCE], seed=seed, first=first + start)
            made = [to_motion(field, fps).joint_positions for field in fields]
            sample_set(self.name, fps, made, names[start : start + AT_ONCE])  # raises for NaN, which cannot be planted
            positions[as_it_is] += made
            positions[planted_row] += [to_motion(planted(field, "free"), fps).joint_positions for field in fields]
            self.on_motions(len(made))
        sets = {row: sample_set(str(row), fps, made, names, texts) for row, made in positions.items()}
        lengths = self.kit_lengths
        return sets if lengths is None else {row: as_kit_joints(made, lengths) for row, made in sets.items()}


def _requests(wanted: CaptionedMotions) -> list[GenerationRequest]:
    """Text and duration only: a model trained without texts cannot have a row of text-to-motion."""
    texts = [caption.text for caption in wanted.captions]
    return [GenerationRequest(seconds, text) for seconds, text in zip(wanted.durations_seconds, texts, strict=True)]
