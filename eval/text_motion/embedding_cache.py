"""Cache of embeddings: one file per (data, evaluator, settings).

The files are in RESULTS/embeddings; when any part of the key changes, embeddings are recomputed. Deleting the folder is
safe. Only embeddings of whole motions and of texts are cached: clip-FID draws other clips in every replication,
hundreds of megabytes per table.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eval.sets.sets import SampleSet
from eval.text_motion.evaluator import TextMotionEvaluator
from motionkit.core.files import whole_file
from motionkit.core.motion import Caption
from motionkit.core.progress import warn
from motionkit.core.shapes import Float32, Float64

FOLDER = "embeddings"
FORMAT = "motionkit-embeddings/2"

Embeddings = Float64[np.ndarray, "rows features"]


@dataclass(frozen=True, eq=False)
class Embedder:
    """One evaluator with a cache folder; None disables the cache."""

    evaluator: TextMotionEvaluator
    folder: Path | None

    def motions(self, samples: SampleSet) -> Embeddings:
        """One row per sequence; the positions are the key."""
        key = {"motions": fingerprint_of(samples)}
        return self.kept(key, samples.num_sequences, lambda: self.evaluator.embed_motions(samples))

    def texts(self, captions: Sequence[Caption]) -> Embeddings:
        """One row per caption; each distinct one is embedded once."""
        different = list(dict.fromkeys(captions))
        place = {caption: row for row, caption in enumerate(different)}
        texts = json.dumps([asdict(caption) for caption in different]).encode()
        key = {"texts": hashlib.sha256(texts).hexdigest()}
        rows = self.kept(key, len(different), lambda: self.evaluator.embed_texts(different))
        return rows[[place[caption] for caption in captions]]

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
                reason = "it holds other rows than it was named for"
            except (OSError, ValueError, EOFError) as error:
                reason = str(error)
            warn(f"{path}: not usable ({reason}); computing it anew")
        embeddings = compute()
        if len(embeddings) != num_rows:
            raise ValueError(f"evaluator {self.evaluator.name!r} gave {len(embeddings)} rows for {num_rows}")
        if path is not None:
            with whole_file(path) as temporary, temporary.open("wb") as file:
                np.save(file, embeddings, allow_pickle=False)
        return embeddings


def fingerprint_of(samples: SampleSet) -> str:
    """Hex sha256 over framerate, lengths and positions; ids and captions are not included."""
    digest = hashlib.sha256(f"{samples.fps} {samples.sequences.values.shape[1]} ".encode())
    digest.update(samples.sequences.num_frames.astype("<i8").tobytes())
    digest.update(np.ascontiguousarray(samples.sequences.values, dtype="<f4").data.cast("B"))
    return digest.hexdigest()


def fingerprint_of_vectors(motions: Sequence[Float32[np.ndarray, "_frames numbers"]]) -> str:
    """Hex sha256 over the pose vectors of motions and their lengths."""
    digest = hashlib.sha256()
    for motion in motions:
        digest.update(repr(motion.shape).encode())
        digest.update(np.ascontiguousarray(motion, dtype="<f4").data.cast("B"))
    return digest.hexdigest()
