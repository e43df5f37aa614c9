"""Cache of embeddings: one file per (data, evaluator, settings), checked when it is read.

The files are in RESULTS/embeddings; when any part of the key changes, embeddings are recomputed. Deleting the folder is
safe. Only embeddings of whole motions and of texts are cached: clip-FID draws other clips in every replication,
hundreds of megabytes per table, and `eval.tables.parts` caches its final numbers if tables share them.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from eval.sets.sets import SampleSet
from eval.text_motion.evaluator import TextMotionEvaluator
from motionkit.core.files import whole_file
from motionkit.core.motion import Caption
from motionkit.core.progress import warn
from motionkit.core.shapes import Float32, Float64

FOLDER = "embeddings"
FORMAT = "motionkit-embeddings/1"
TENSOR = "embeddings"

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

        A file that is damaged, of another key or shape, or not finite is recomputed with a warning. Raises `ValueError`
        if `compute` returns another number of rows.
        """
        whole = {"format": FORMAT, "evaluator": [self.evaluator.name, self.evaluator.fingerprint], **key}
        text = json.dumps(whole, sort_keys=True)
        path = None
        if self.folder is not None:
            path = self.folder / f"{hashlib.sha256(text.encode()).hexdigest()[:24]}.safetensors"
            found = _read(path, text, num_rows)
            if found is not None:
                return found
        made = compute()
        if len(made) != num_rows:
            raise ValueError(f"evaluator {self.evaluator.name!r} gave {len(made)} rows for {num_rows}")
        if path is not None:
            _write(path, text, made)
        return made


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


def _read(path: Path, key: str, num_rows: int) -> Embeddings | None:
    if not path.is_file():
        return None
    reason = "it holds other rows than it was named for"
    try:
        with safe_open(path, framework="np") as opened:
            found = opened.get_tensor(TENSOR) if (opened.metadata() or {}).get("key") == key else None
        if found is not None and _is_whole(found, num_rows):
            return np.asarray(found)
    except (SafetensorError, OSError) as error:
        reason = str(error)
    warn(f"{path}: not usable ({reason}); computing it anew")
    return None


def _is_whole(found: np.ndarray, num_rows: int) -> bool:
    shaped = found.ndim == 2 and len(found) == num_rows and found.dtype == np.float64
    return shaped and bool(np.isfinite(found).all())


def _write(path: Path, key: str, embeddings: Embeddings) -> None:
    with whole_file(path) as temporary:
        save_file({TENSOR: np.ascontiguousarray(embeddings, dtype=np.float64)}, temporary, metadata={"key": key})
