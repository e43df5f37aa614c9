"""Trained networks that embed motions of any framerate and sentences in one space: the stages `evaluator` and `tmr`.

One file holds weights, input statistics, and the fingerprint of the training store; the evaluator's own fingerprint is
part of every result that uses it.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from eval.native_evaluator.network import (
    MIN_POSES,
    NUM_JOINTS,
    NativeNetwork,
    TextProjection,
    prepare,
    rich_input,
    standardised,
)
from eval.native_evaluator.settings import NativeNetworkConfig
from eval.sets.sets import SampleSet
from motionkit.core.errors import MotionkitError
from motionkit.core.motion import Caption
from motionkit.core.shapes import Float, Float32, Float64
from motionkit.core.skeleton import SMPL22
from motionkit.training.config import from_plain
from motionkit.training.loop import CheckpointError, load_tensors, rebuilding, unprefixed
from motionkit.training.run import RunFolder
from motionkit.training.text import TextEncoder, load_text_encoder

VERSIONS = {"evaluator": "native/2", "tmr": "tmr/1"}
"""Of the file that each stage writes."""
CLIPS_AT_ONCE = 256


@dataclass(frozen=True, eq=False)
class NativeEvaluator:
    """A trained evaluator: networks, and statistics of inputs (`mean`, `scale`).

    `description` is the header of its file (settings, store fingerprint, framerates …).
    """

    network: NativeNetwork
    text: TextProjection
    mean: Float32[Tensor, "channels"]
    scale: Float32[Tensor, "channels"]
    description: dict[str, Any]

    @cached_property
    def fingerprint(self) -> str:
        """First 16 hex digits of the sha256 over version, settings, weights and statistics."""
        digest = hashlib.sha256(json.dumps(self.description, sort_keys=True).encode())
        tensors = {"mean": self.mean, "scale": self.scale} | self.network.state_dict() | self.text.state_dict()
        for name in sorted(tensors):
            digest.update(name.encode() + np.ascontiguousarray(tensors[name].numpy(), dtype="<f4").tobytes())
        return digest.hexdigest()[:16]

    def embed_motions(
        self, clips: Float[np.ndarray, "clips poses joints 3"], fps: Fraction
    ) -> Float64[np.ndarray, "clips shared"]:
        """One vector per clip in the space shared with sentences, in order: positions of the 22 joints in metres, y up.

        Raises `ValueError` for another number of joints or fewer than 8 poses.
        """
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
                rows.append(self.network.shared(self.network(inputs)).double().numpy())
        return np.concatenate(rows)

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


@dataclass(frozen=True, eq=False)
class NativeTextMotion:
    """An evaluator on whole motions, as a `TextMotionEvaluator`; `stage` is the one that trained it.

    Trained on clips of seconds, its GRU and its mean over time extend to longer motions. Embeddings of the stage `tmr`
    have length 1, so Euclidean distances and cosines rank alike.
    """

    evaluator: NativeEvaluator
    stage: str = "evaluator"

    @property
    def name(self) -> str:
        """Name for tables."""
        return "tmr" if self.stage == "tmr" else "native"

    @property
    def pair_score(self) -> str:
        """The score of pairs of unit vectors that TMR and Kimodo report; empty for the native evaluator."""
        return "tmr_score" if self.stage == "tmr" else ""

    @property
    def fingerprint(self) -> str:
        """The evaluator's fingerprint, marked as that of whole motions."""
        return f"{self.evaluator.fingerprint}-whole"

    @property
    def fps(self) -> Fraction | None:
        """None: any framerate is accepted."""
        return None

    @property
    def layout(self) -> str:
        """The 22 joints that it was trained with."""
        return SMPL22.name

    def remark_at(self, fps: Fraction) -> str:
        """A remark if it was not trained near this framerate, else empty."""
        trained = [Fraction(each) for each in self.evaluator.description["framerates"]]
        if min(trained) <= fps <= max(trained):
            return ""
        return (
            f"The {self.name} evaluator was trained at {float(min(trained)):g} to {float(max(trained)):g} fps: its "
            f"numbers at {float(fps):g} fps mean little (motionkit train --stage {self.stage} --set "
            "training.framerates=…)."
        )

    def embed_motions(self, samples: SampleSet) -> Float64[np.ndarray, "sequences features"]:
        """One row per sequence, in the order of the set; sequences of one length form a batch.

        Raises `MotionkitError` if one has fewer than 8 poses.
        """
        lengths = samples.sequences.num_frames
        if int(lengths.min()) < MIN_POSES:
            raise MotionkitError(
                f"{samples.name}: {samples.sequence_ids[int(lengths.argmin())]!r} has {lengths.min()} poses at "
                f"{samples.fps} fps, the {self.name} evaluator needs at least {MIN_POSES}; leave such motions out"
            )
        rows: dict[int, npt.NDArray[np.float64]] = {}
        for length in np.unique(lengths).tolist():
            members = np.flatnonzero(lengths == length).tolist()
            clips = np.stack([samples.sequences[index] for index in members])
            rows.update(zip(members, self.evaluator.embed_motions(clips, samples.fps), strict=True))
        return self._scaled(np.stack([rows[index] for index in range(samples.num_sequences)]))

    def embed_texts(self, captions: Sequence[Caption]) -> Float64[np.ndarray, "texts features"]:
        """One row per caption, in order. Raises `MotionkitError` if it was trained without captions."""
        return self._scaled(self.evaluator.embed_texts([caption.text for caption in captions]))

    def _scaled(self, rows: Float64[np.ndarray, "rows features"]) -> Float64[np.ndarray, "rows features"]:
        if self.stage != "tmr":
            return rows
        return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-12))


def load_native(run: Path) -> NativeEvaluator:
    """Load the native evaluator from a run folder (`motionkit train --stage evaluator`).

    Raises `RunError` if its training is not finished and `CheckpointError` if the file is of another version.
    """
    return _load(run, "evaluator")


def load_tmr(run: Path) -> NativeTextMotion:
    """Load the evaluator of retrieval from a run folder (`motionkit train --stage tmr`); raises as `load_native`."""
    return NativeTextMotion(_load(run, "tmr"), "tmr")


def _load(run: Path, stage: str) -> NativeEvaluator:
    folder, version = RunFolder(run).stage(stage), VERSIONS[stage]
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
        mean, scale = tensors["statistics.mean"], tensors["statistics.scale"]
        return NativeEvaluator(network.eval(), text.eval(), mean, scale, description)


def describe_training(
    stage: str,
    config: dict[str, Any],
    store_fingerprint: str,
    framerates: Sequence[Fraction],
    encoder: TextEncoder | None,
) -> dict[str, Any]:
    """The header of an evaluator's file."""
    return {
        "version": VERSIONS[stage],
        "config": config,
        "store_fingerprint": store_fingerprint,
        "framerates": [str(fps) for fps in framerates],
        "text_encoder": "" if encoder is None else encoder.name,
        "text_encoder_fingerprint": "" if encoder is None else encoder.fingerprint,
        "text_dimension": 1 if encoder is None else encoder.dimension,
    }
