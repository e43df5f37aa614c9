"""The native-rate evaluator: a trained network that embeds clips of any framerate and matches them with sentences.

It implements `eval.clip_fid.score.FeatureSet`. One file holds weights, input statistics, and the fingerprint of the
training store; the evaluator's own fingerprint is part of every result that uses it.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from eval.native_evaluator.network import (
    MIN_POSES,
    NUM_JOINTS,
    TARGETS,
    NativeNetwork,
    TextProjection,
    prepare,
    rich_input,
    standardised,
)
from eval.native_evaluator.settings import NativeNetworkConfig
from motionkit.core.errors import MotionkitError
from motionkit.core.shapes import Float, Float32, Float64
from motionkit.training.config import from_plain
from motionkit.training.run import RunFolder
from motionkit.training.tensors import CheckpointError, load_tensors, rebuilding, unprefixed
from motionkit.training.text import TextEncoder, load_text_encoder

VERSION = "native/2"
STAGE_NAME = "evaluator"
CLIPS_AT_ONCE = 256


@dataclass(frozen=True, eq=False)
class NativeEvaluator:
    """A trained evaluator: networks, statistics of inputs (`mean`, `scale`) and of embeddings (`whitening`).

    `description` is the header of its file (settings, store fingerprint, framerates …).
    """

    network: NativeNetwork
    text: TextProjection
    mean: Float32[Tensor, "channels"]
    scale: Float32[Tensor, "channels"]
    whitening: Float32[Tensor, "features features"]
    description: dict[str, Any]

    @property
    def name(self) -> str:
        """Name for tables."""
        return "native"

    def remark_at(self, fps: Fraction) -> str:
        """The remark on its numbers at a framerate; empty if it was trained near that framerate."""
        return self.remark_as(self.name, STAGE_NAME, fps)

    def remark_as(self, name: str, stage: str, fps: Fraction) -> str:
        """The same remark for an evaluator of another name, trained by a stage."""
        trained = [Fraction(each) for each in self.description["framerates"]]
        if min(trained) <= fps <= max(trained):
            return ""
        return (
            f"The {name} evaluator was trained at {float(min(trained)):g} to {float(max(trained)):g} fps: its numbers "
            f"at {float(fps):g} fps mean little (motionkit train --stage {stage} --set training.framerates=…)."
        )

    @property
    def store_fingerprint(self) -> str:
        """Fingerprint of the store that it was trained on."""
        return str(self.description["store_fingerprint"])

    @cached_property
    def fingerprint(self) -> str:
        """First 16 hex digits of the sha256 over version, settings, weights and statistics."""
        digest = hashlib.sha256(json.dumps(self.description, sort_keys=True).encode())
        statistics = {"mean": self.mean, "scale": self.scale, "whitening": self.whitening}
        tensors = statistics | self.network.state_dict() | self.text.state_dict()
        for name in sorted(tensors):
            digest.update(name.encode() + np.ascontiguousarray(tensors[name].numpy(), dtype="<f4").tobytes())
        return digest.hexdigest()[:16]

    def describe(
        self, clips: Float[np.ndarray, "clips poses joints 3"], fps: Fraction
    ) -> Float64[np.ndarray, "clips features"]:
        """One whitened embedding per clip, in order: positions of the 22 joints of SMPL22 in metres, y up.

        Clean motion varies about equally in all directions (`native_whitening`). Raises `ValueError` for another number
        of joints or fewer than 8 poses.
        """
        return self._each(clips, fps, lambda embeddings: embeddings @ self.whitening)

    def embed_motions(
        self, clips: Float[np.ndarray, "clips poses joints 3"], fps: Fraction
    ) -> Float64[np.ndarray, "clips shared"]:
        """One vector per clip in the space shared with sentences; distances there are Euclidean."""
        return self._each(clips, fps, self.network.shared)

    def strengths(
        self, clips: Float[np.ndarray, "clips poses joints 3"], fps: Fraction
    ) -> Float64[np.ndarray, "clips targets"]:
        """Predicted log strengths of each clip's damage, named in `native_network.TARGETS`."""
        return self._each(clips, fps, self.network.strengths)

    def embed_texts(self, texts: Sequence[str]) -> Float64[np.ndarray, "texts shared"]:
        """One vector per sentence in the space shared with motions.

        Raises `MotionkitError` if the evaluator was trained without captions, or its text encoder is not available.
        """
        if self._text_encoder is None:
            raise MotionkitError("this evaluator was trained on a store without captions: it knows no sentences")
        embeddings = torch.from_numpy(self._text_encoder.encode(list(texts)))
        with torch.inference_mode():
            projected: Float64[np.ndarray, "texts shared"] = self.text(embeddings).double().numpy()
        return projected

    @cached_property
    def _text_encoder(self) -> TextEncoder | None:
        name = self.description["text_encoder"]
        if not name:
            return None
        encoder = load_text_encoder(name)
        if encoder.fingerprint != self.description["text_encoder_fingerprint"]:
            raise MotionkitError(
                f"the text encoder {name!r} is not the one that this evaluator was trained with "
                f"(fingerprint {encoder.fingerprint[:16]}, not {self.description['text_encoder_fingerprint'][:16]})"
            )
        return encoder

    def _each(
        self, clips: Float[np.ndarray, "clips poses joints 3"], fps: Fraction, head: Callable[[Tensor], Tensor]
    ) -> Float64[np.ndarray, "clips numbers"]:
        if clips.shape[2] != NUM_JOINTS:
            raise ValueError(f"clips have {clips.shape[2]} joints; the evaluator knows the {NUM_JOINTS} of SMPL22")
        if clips.shape[1] < MIN_POSES:
            raise ValueError(f"clips have {clips.shape[1]} poses; the evaluator needs at least {MIN_POSES}")
        rows = []
        with torch.inference_mode():
            # At least one batch, so that the result for no clips has the right width.
            for start in range(0, max(len(clips), 1), CLIPS_AT_ONCE):
                some = torch.from_numpy(prepare(clips[start : start + CLIPS_AT_ONCE], float(fps)))
                inputs = standardised(rich_input(some, float(fps)), self.mean, self.scale)
                rows.append(head(self.network(inputs)).double().numpy())
        return np.concatenate(rows)


def load_native(run: Path) -> NativeEvaluator:
    """Load the evaluator from a run folder (`motionkit train --stage evaluator`); raises as `load_networks` does."""
    return load_networks(run, STAGE_NAME, VERSION)


def load_networks(run: Path, stage: str, version: str) -> NativeEvaluator:
    """Load a stage of these networks from a run folder.

    Raises `RunError` if its training is not finished and `CheckpointError` if the file is of another version.
    """
    folder = RunFolder(run).stage(stage)
    folder.read_summary()
    tensors, description = load_tensors(folder.model_path)
    if description.get("version") != version:
        raise CheckpointError(
            f"{folder.model_path} is of version {description.get('version')!r}, expected {version!r}: "
            f"train it again (motionkit train --stage {stage} --run {run.name} --overwrite)"
        )
    with rebuilding(folder.model_path, stage, tensors):
        config = from_plain(NativeNetworkConfig, description["config"]["network"])
        network = NativeNetwork(config)
        text = TextProjection(int(description["text_dimension"]), config)
        network.load_state_dict(unprefixed("network", tensors))
        text.load_state_dict(unprefixed("text", tensors))
        mean, scale, whitening = (tensors[f"statistics.{name}"] for name in ("mean", "scale", "whitening"))
        return NativeEvaluator(network.eval(), text.eval(), mean, scale, whitening, description)


def describe_training(
    config: dict[str, Any], store_fingerprint: str, framerates: Sequence[Fraction], encoder: TextEncoder | None
) -> dict[str, Any]:
    """The header of an evaluator's file; `targets` are the heads' outputs."""
    return {
        "version": VERSION,
        "config": config,
        "store_fingerprint": store_fingerprint,
        "framerates": [str(fps) for fps in framerates],
        "targets": list(TARGETS),
        "text_encoder": "" if encoder is None else encoder.name,
        "text_encoder_fingerprint": "" if encoder is None else encoder.fingerprint,
        "text_dimension": 1 if encoder is None else encoder.dimension,
    }


LEAST_VARIANCE = 1e-12


def shrunk_whitening(
    embeddings_by_framerate: Sequence[Float[np.ndarray, "_clips features"]],
) -> Float32[np.ndarray, "features features"]:
    """The symmetric matrix (C + c·1)^(−½) for clean clips' mean covariance C at one framerate, c its mean variance.

    It makes variances about equal in all directions in which clean motion varies; directions of far less than the mean
    variance stay small, so nearly constant ones are not amplified. The framerates' means are ignored: only sets of one
    framerate are compared. Raises `ValueError` if some framerate has one clip.
    """
    if any(len(embeddings) < 2 for embeddings in embeddings_by_framerate):
        raise ValueError("a covariance needs at least two clips of every framerate")
    rows = [np.asarray(embeddings, dtype=np.float64) for embeddings in embeddings_by_framerate]
    covariance = np.mean([np.atleast_2d(np.cov(each, rowvar=False)) for each in rows], axis=0)
    variances, directions = np.linalg.eigh(covariance)
    shrunk = np.maximum(variances, 0.0) + max(float(variances.mean()), LEAST_VARIANCE)
    whitening: Float32[np.ndarray, "features features"] = ((directions / np.sqrt(shrunk)) @ directions.T).astype(
        np.float32
    )
    return whitening
