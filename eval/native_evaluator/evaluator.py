"""The native text–motion evaluator: motions of any framerate and sentences in one space.

One file holds weights, input statistics, and the fingerprint of the training store; the evaluator's own fingerprint is
part of every result that uses it. The stage `tmr` trains the same network with embeddings of length 1.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from eval.native_evaluator.stage import NetworkConfig
from eval.sets.sets import SampleSet
from motionkit.core.errors import MotionkitError
from motionkit.core.kinematics import rotate_about_y
from motionkit.core.motion import Caption
from motionkit.core.shapes import Float, Float32, Float64
from motionkit.core.skeleton import SMPL22
from motionkit.features.field import heading
from motionkit.training.config import from_plain
from motionkit.training.loop import CheckpointError, load_tensors, rebuilding, weights_digest
from motionkit.training.run import RunError, RunFolder
from motionkit.training.text import TextEncoder, load_same_encoder

VERSIONS = {"evaluator": "native/3", "tmr": "tmr/2"}
"""Of the file that each stage writes."""
NUM_CHANNELS = 63 + 1 + 66 + 1
MIN_POSES = 8
REFERENCE_FPS = 60.0
MOST_DEVIATIONS = 5.0
CLIPS_AT_ONCE = 256

FEET = (7, 10, 8, 11)


def motion_input(clips: Float[np.ndarray, "clips poses 22 3"], fps: float) -> Float32[Tensor, "clips poses channels"]:
    """131 numbers per pose, invariant to translation and to rotation about the vertical axis.

    Positions beside the root in the body's heading (63), the root's height above the lowest foot (1), velocities in m/s
    in that heading, forward differences (66), and the logarithm of the framerate (1).
    """
    positions = clips.astype(np.float64)
    yaw = heading(positions)[..., None]
    velocities = np.diff(positions, axis=1) * fps
    velocities = np.concatenate((velocities, velocities[:, -1:]), axis=1)
    ground = positions[:, :, FEET, 1].min(axis=(1, 2))
    blocks = (
        rotate_about_y(positions[:, :, 1:] - positions[:, :, :1], -yaw).reshape(*yaw.shape[:2], 63),
        (positions[:, :, 0, 1] - ground[:, None])[..., None],
        rotate_about_y(velocities, -yaw).reshape(*yaw.shape[:2], 66),
        np.full_like(yaw, math.log(fps / REFERENCE_FPS)),
    )
    return torch.from_numpy(np.concatenate(blocks, axis=-1).astype(np.float32))


class EvaluatorNetwork(nn.Module):
    """Motions and sentences → one space; `mean` and `scale` are statistics of the motions' inputs.

    After Guo et al.'s movement and motion encoders, smaller (text-to-motion, networks/modules.py): two convolutions of
    kernel 4 and stride 2, a bidirectional GRU, a linear layer. Sentences come as embeddings of a frozen text encoder.
    """

    mean: Tensor
    scale: Tensor

    def __init__(self, config: NetworkConfig, text_dimension: int) -> None:
        super().__init__()
        self.unit_length = config.unit_length
        self.register_buffer("mean", torch.zeros(NUM_CHANNELS))
        self.register_buffer("scale", torch.ones(NUM_CHANNELS))
        self.convolutions = nn.Sequential(
            *(nn.Conv1d(NUM_CHANNELS, config.convolution, 4, 2, 1), nn.LeakyReLU(0.2)),
            *(nn.Conv1d(config.convolution, config.convolution, 4, 2, 1), nn.LeakyReLU(0.2)),
            nn.Dropout(config.dropout),
        )
        self.recurrent = nn.GRU(config.convolution, config.recurrent, batch_first=True, bidirectional=True)
        self.motion = nn.Sequential(
            nn.Dropout(config.dropout), nn.Linear(2 * config.recurrent + config.convolution, config.shared)
        )
        self.text = nn.Sequential(
            nn.Linear(text_dimension, config.text_hidden),
            *(nn.LeakyReLU(0.2), nn.Dropout(config.dropout)),
            nn.Linear(config.text_hidden, config.shared),
        )

    def standardised(self, inputs: Float[Tensor, "clips poses channels"]) -> Float[Tensor, "clips poses channels"]:
        """Standardised inputs, clipped to 5 deviations: a few frames of a capture are glitches of hundreds."""
        return ((inputs - self.mean) * self.scale).clamp(-MOST_DEVIATIONS, MOST_DEVIATIONS)

    def embed_motions(self, inputs: Float[Tensor, "clips poses channels"]) -> Float[Tensor, "clips shared"]:
        """One vector per clip of standardised inputs; all have the same number of poses, at least 8."""
        movements = self.convolutions(inputs.transpose(1, 2)).transpose(1, 2)
        _, last = self.recurrent(movements)
        # The mean over time besides the last states: a GRU forgets a long clip's beginning.
        return self._scaled(self.motion(torch.cat((last[0], last[1], movements.mean(dim=1)), dim=-1)))

    def embed_texts(self, sentences: Float[Tensor, "texts text"]) -> Float[Tensor, "texts shared"]:
        """One vector per sentence."""
        return self._scaled(self.text(sentences))

    def _scaled(self, rows: Float[Tensor, "rows shared"]) -> Float[Tensor, "rows shared"]:
        return nn.functional.normalize(rows, dim=1) if self.unit_length else rows


@dataclass(frozen=True, eq=False)
class NativeEvaluator:
    """A trained evaluator as a `TextMotionEvaluator`; `stage` is the one that trained it.

    `description` is the header of its file (settings, store fingerprint, framerates …). Embeddings of the stage `tmr`
    have length 1, so Euclidean distances and cosines rank alike; `pair_score` is the score of pairs that TMR reports.
    """

    network: EvaluatorNetwork
    description: dict[str, Any]
    fingerprint: str
    stage: str = "evaluator"
    name: str = "native"
    pair_score: str = ""
    fps: Fraction | None = None
    layout: str = SMPL22.name

    def remark_at(self, fps: Fraction) -> str:
        """A remark if it was not trained near this framerate, else empty."""
        trained = [Fraction(each) for each in self.description["framerates"]]
        if min(trained) <= fps <= max(trained):
            return ""
        return (
            f"The {self.name} evaluator was trained at {float(min(trained)):g} to {float(max(trained)):g} fps: its "
            f"numbers at {float(fps):g} fps mean little (motionkit train --stage {self.stage} --set "
            "training.framerates=…)."
        )

    def embed_clips(
        self, clips: Float[np.ndarray, "clips poses 22 3"], fps: Fraction
    ) -> Float64[np.ndarray, "clips shared"]:
        """One vector per clip, in order: positions of the 22 joints in metres, y up, of at least 8 poses."""
        rows = []
        with torch.inference_mode():
            for start in range(0, len(clips), CLIPS_AT_ONCE):
                inputs = motion_input(clips[start : start + CLIPS_AT_ONCE], float(fps))
                rows.append(self.network.embed_motions(self.network.standardised(inputs)).double().numpy())
        return np.concatenate(rows)

    def embed_motions(self, samples: SampleSet) -> Float64[np.ndarray, "sequences shared"]:
        """One row per sequence, in the order of the set; sequences of one length form a batch.

        Raises `MotionkitError` if one has fewer than 8 poses.
        """
        lengths = samples.sequences.num_frames
        if int(lengths.min()) < MIN_POSES:
            raise MotionkitError(
                f"{samples.name}: {samples.sequence_ids[int(lengths.argmin())]!r} has {lengths.min()} poses at "
                f"{samples.fps} fps, the {self.name} evaluator needs at least {MIN_POSES}; leave such motions out"
            )
        rows: dict[int, Float64[np.ndarray, shared]] = {}
        for length in np.unique(lengths).tolist():
            members = np.flatnonzero(lengths == length).tolist()
            clips = np.stack([samples.sequences[index] for index in members])
            rows.update(zip(members, self.embed_clips(clips, samples.fps), strict=True))
        return np.stack([rows[index] for index in range(samples.num_sequences)])

    def embed_texts(self, captions: Sequence[Caption]) -> Float64[np.ndarray, "texts shared"]:
        """One row per caption, in order. Raises `MotionkitError` if its text encoder is not available."""
        sentences = torch.from_numpy(self._encoder.encode([caption.text for caption in captions]))
        with torch.inference_mode():
            return np.asarray(self.network.embed_texts(sentences).double().numpy())

    @cached_property
    def _encoder(self) -> TextEncoder:
        name, fingerprint = self.description["text_encoder"], self.description["text_encoder_fingerprint"]
        return load_same_encoder(name, fingerprint, f"the {self.name} evaluator")


def load_evaluator(run: Path, stage: str = "evaluator") -> NativeEvaluator:
    """Load the evaluator that `motionkit train --stage evaluator`, or `tmr`, has trained in a run folder.

    Raises `RunError` if its training is not finished or had no captions, and `CheckpointError` for another version.
    """
    folder, version = RunFolder(run).stage(stage), VERSIONS[stage]
    if not folder.read_summary()["sentences"]:
        raise RunError(f"{folder.path} was trained on a store without captions: it knows no sentences")
    tensors, description = load_tensors(folder.model_path)
    if description.get("version") != version:
        raise CheckpointError(
            f"{folder.model_path} is of version {description.get('version')!r}, expected {version!r}: "
            f"train it again (motionkit train --stage {stage} --run {run.name} --overwrite)"
        )
    with rebuilding(folder.model_path, stage):
        config = from_plain(NetworkConfig, description["config"]["network"])
        network = EvaluatorNetwork(config, int(description["text_dimension"]))
        network.load_state_dict(tensors)
    fingerprint = weights_digest(json.dumps(description, sort_keys=True), tensors)
    names = ("tmr", "tmr_score") if stage == "tmr" else ("native", "")
    return NativeEvaluator(network.eval().requires_grad_(False), description, fingerprint, stage, *names)
