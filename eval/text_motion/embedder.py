"""Evaluators of text and motion, and a cache of what they embed.

A file per (data, evaluator, settings) is in RESULTS/embeddings; deleting the folder is safe. Only embeddings of whole
motions and of texts are cached: clip-FID draws other clips in every replication, hundreds of megabytes per table.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from eval.sets.sets import SampleSet
from motionkit.core.files import whole_file
from motionkit.core.motion import Caption
from motionkit.core.progress import warn
from motionkit.core.shapes import Float32, Float64

FOLDER = "embeddings"
FORMAT = "motionkit-embeddings/2"
Embeddings = Float64[np.ndarray, "rows features"]


@runtime_checkable
class TextMotionEvaluator(Protocol):
    """Embeds whole motions and sentences in one space; distances there are Euclidean.

    A motion's row depends on that motion alone, not on its batch.
    """

    @property
    def name(self) -> str:
        """Name for tables."""

    @property
    def fingerprint(self) -> str:
        """Hash of everything that embeddings depend on."""

    @property
    def fps(self) -> Fraction | None:
        """The required framerate of the motions; None if any is accepted."""

    @property
    def layout(self) -> str:
        """The motions' joints: `smpl22` or `kit21`."""

    @property
    def pair_score(self) -> str:
        """The score of pairs of unit vectors that its authors report (`eval.metrics.metric`), or empty."""

    def remark_at(self, fps: Fraction) -> str:
        """The remark of a table on its numbers at a framerate; may be empty."""

    def embed_motions(self, samples: SampleSet) -> Embeddings:
        """One row per sequence, in the order of the set. Raises `MotionkitError` for another framerate."""

    def embed_texts(self, captions: Sequence[Caption]) -> Embeddings:
        """One row per caption, in order. Raises `MotionkitError` if one cannot be read."""


@runtime_checkable
class PoseVectorEvaluator(TextMotionEvaluator, Protocol):
    """An evaluator that reads pose vectors of `vector_size` numbers unchanged, as in published comparisons."""

    @property
    def vector_size(self) -> int:
        """Numbers of a pose vector."""

    def embed_vectors(self, motions: Sequence[Float32[np.ndarray, "_frames numbers"]]) -> Embeddings:
        """One row per motion in its own units. Raises `MotionkitError`."""


@dataclass(frozen=True, eq=False)
class Embedder:
    """One evaluator with a cache folder; None disables the cache."""

    evaluator: TextMotionEvaluator
    folder: Path | None

    def motions(self, samples: SampleSet) -> Embeddings:
        """One row per sequence; framerate and positions are the key, ids and captions are not."""
        key = {"motions": fingerprint_of(list(samples.sequences)), "fps": str(samples.fps)}
        return self.kept(key, samples.num_sequences, lambda: self.evaluator.embed_motions(samples))

    def texts(self, captions: Sequence[Caption]) -> Embeddings:
        """One row per caption; each distinct one is embedded once."""
        different = list(dict.fromkeys(captions))
        row = {caption: index for index, caption in enumerate(different)}
        texts = json.dumps([asdict(caption) for caption in different]).encode()
        key = {"texts": hashlib.sha256(texts).hexdigest()}
        rows = self.kept(key, len(different), lambda: self.evaluator.embed_texts(different))
        return rows[[row[caption] for caption in captions]]

    def kept(self, key: Mapping[str, Any], num_rows: int, compute: Callable[[], Embeddings]) -> Embeddings:
        """The cached embeddings of this key and evaluator, else `compute()`, which is cached.

        A file that is damaged, of another shape, or not finite is recomputed with a warning. Raises `ValueError` if
        `compute` returns another number of rows.
        """
        whole = {"format": FORMAT, "evaluator": [self.evaluator.name, self.evaluator.fingerprint], **key}
        digest = hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()
        path = None if self.folder is None else self.folder / f"{digest}.npy"
        if path is not None and path.is_file():
            try:
                cached = np.load(path, allow_pickle=False)
                if cached.ndim == 2 and len(cached) == num_rows and np.isfinite(cached).all():
                    return np.asarray(cached, dtype=np.float64)
            except (OSError, ValueError, EOFError):
                pass
            warn(f"{path} is damaged: its embeddings are computed again")
        embeddings = compute()
        if len(embeddings) != num_rows:
            raise ValueError(f"evaluator {self.evaluator.name!r} gave {len(embeddings)} rows for {num_rows}")
        if path is not None:
            with whole_file(path) as temporary, temporary.open("wb") as file:
                np.save(file, embeddings, allow_pickle=False)
        return embeddings


def fingerprint_of(motions: Sequence[Float32[np.ndarray, "_frames *numbers"]]) -> str:
    """Hex sha256 over the shapes and numbers of motions, joint positions or pose vectors."""
    digest = hashlib.sha256()
    for motion in motions:
        digest.update(repr(motion.shape).encode())
        digest.update(np.ascontiguousarray(motion, dtype="<f4").data.cast("B"))
    return digest.hexdigest()
