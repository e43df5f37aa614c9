"""The motions that generative systems learn and sample: settings, pose space, random crops of a store, batches."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Bool, Float, Float32, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import parse_fps
from motionkit.data.captions import actions_of_windows, captions_of_windows
from motionkit.data.windows import WindowPoses, cut_windows, open_frames, training_vectors
from motionkit.features.convention import PoseVectors, PoseVectorsName
from motionkit.features.layout import SMPL22_LAYOUT
from motionkit.features.native import NativeVectors
from motionkit.io.humanml3d import VectorLayout
from motionkit.store.cache import cache_root
from motionkit.store.reader import Store
from motionkit.training.config import DiffusionConfig, require_positive
from motionkit.training.networks import Conditions, VectorScaling, WindowConditions, measure_scaling, window_conditions
from motionkit.training.text import TextEncoder, embed_texts, load_text_encoder

# As in HumanML3D's data loaders.
CROP_MULTIPLE, SHORTER_SHARE = 4, 1 / 3
Rows = Float[Tensor, "batch frames numbers"]  # standardised pose vectors
Lengths = Int64[Tensor, "batch"]  # frames of each motion
Mask = Bool[Tensor, "batch frames"]  # True for frames of a motion, False for padding


@dataclass(frozen=True)
class MotionsConfig:
    """The training motions: pose vectors of crops at `fps`, of at most `max_frames` frames.

    Windows begin every `stride_seconds` of a sequence and last at least `min_seconds`. The lengths of `random` crops
    are multiples of four frames, four shorter than fits with probability 1/3; a `whole` crop is its window. The network
    gets all frames of a crop, or `sampled_frames` consecutive ones from a random start (0: all). With `scattered` it
    gets as many random frames of the whole window, with replacement.
    """

    pose_vectors: PoseVectorsName = "native"
    fps: float = 20.0
    max_frames: int = 196
    min_seconds: float = 2.0
    stride_seconds: float = 2.0
    mirrored: bool = True
    crops: Literal["random", "whole", "scattered"] = "random"
    sampled_frames: int = 0
    where: str = "split = 'train'"

    def __post_init__(self) -> None:
        require_positive(self, "fps", "min_seconds", "stride_seconds")
        if self.max_frames < CROP_MULTIPLE:
            raise ValueError(f"max_frames must be {CROP_MULTIPLE} or more, not {self.max_frames}")

    @property
    def framerate(self) -> Fraction:
        """`fps` as an exact fraction."""
        return parse_fps(self.fps)

    @property
    def max_duration_seconds(self) -> float:
        """The longest motion; as in the published vectors, a frame lasts until the next pose."""
        return float(self.max_frames / self.framerate)


@dataclass(frozen=True)
class ConditionsConfig:
    """What motions are conditioned on, dropped with probability `drop` for classifier-free guidance.

    `nothing` is the null embedding: zeros, or the embedding of the empty text. Other embeddings than CLIP's, of unit
    norm, are scaled to a root mean square of 1, which CLIP's are near to.
    """

    kind: Literal["text", "action", "none"] = "text"
    text_encoder: str = "clip"
    drop: float = 0.1
    nothing: Literal["zeros", "empty"] = "zeros"

    def __post_init__(self) -> None:
        if not 0.0 <= self.drop < 1.0:
            raise ValueError(f"drop must lie in [0, 1), not {self.drop}")

    def load_encoder(self) -> TextEncoder | None:
        """The text encoder; None if no captions are used."""
        return load_text_encoder(self.text_encoder) if self.kind == "text" else None

    def embedded(
        self, rows: Float32[np.ndarray, "texts dimension"], texts: Sequence[str]
    ) -> Float32[Tensor, "texts dimension"]:
        """Embeddings of these texts as the networks get them: the null embedding for empty ones."""
        vectors = torch.from_numpy(np.asarray(rows, dtype=np.float32)).clone()
        if self.text_encoder != "clip":
            vectors *= vectors.shape[1] ** 0.5 / vectors.norm(dim=1, keepdim=True).clamp(min=1e-6)
        if self.nothing == "zeros":
            vectors[[row for row, text in enumerate(texts) if not text]] = 0.0
        return vectors

    def check(self, has_captions: bool, has_actions: bool) -> None:
        """Raise `UsageError` if the motions lack what is needed."""
        others = "or train on others or without (--set conditions.kind=text, action or none)"
        if self.kind == "text" and not has_captions:
            raise UsageError(f"no training motion has a caption: ingest with --captions, {others}")
        if self.kind == "action" and not has_actions:
            raise UsageError(f"no training motion has an action: ingest an index that has them, {others}")


@dataclass(frozen=True, eq=False)
class PoseSpace:
    """The pose vectors that a system learns: their scale and framerate, and how joints are recovered from them."""

    vectors: PoseVectors
    scaling: VectorScaling
    fps: Fraction

    @property
    def num_features(self) -> int:
        """Size of a pose vector."""
        return len(self.scaling.mean)

    @property
    def layout(self) -> VectorLayout:
        """The blocks of a `native` vector; raises `UsageError` for another convention."""
        if not isinstance(self.vectors, NativeVectors):
            raise UsageError("this system learns native vectors: motions.pose_vectors=native")
        return SMPL22_LAYOUT.vector

    def joints(self, rows: Rows) -> Float[Tensor, "batch frames joints 3"]:
        """Joint positions in metres from standardised `native` vectors, as `native.positions_at` gives them."""
        layout, numbers = self.layout, self.scaling.invert(rows)
        angle = self.heading(numbers)
        path = self.path(numbers[..., layout.root_velocity], angle)
        relative = numbers[..., layout.joint_positions].reshape(*numbers.shape[:-1], -1, 3)
        flat = _to_first_frame(relative[..., ::2], angle[..., None, :]) + path[..., None, :]
        others = torch.stack((flat[..., 0], relative[..., 1], flat[..., 1]), dim=-1)
        root = torch.cat((path[..., :1], numbers[..., layout.root_height], path[..., 1:]), dim=-1)
        return torch.cat((root[..., None, :], others), dim=-2)

    def heading(self, numbers: Rows) -> Float[Tensor, "batch frames 1"]:
        """Yaw in radians since the first frame, from unstandardised `native` vectors."""
        return self._integral(numbers[..., self.layout.root_yaw_velocity])

    def path(
        self, velocity: Float[Tensor, "batch frames 2"], angle: Float[Tensor, "batch frames 1"]
    ) -> Float[Tensor, "batch frames 2"]:
        """The root's path in metres in the first frame's x and z, from velocities in the body's frame."""
        return self._integral(_to_first_frame(velocity, angle))

    def _integral(self, rates: Tensor) -> Tensor:
        steps = (rates[:, 1:] + rates[:, :-1]) * (0.5 / float(self.fps))
        return torch.cat((torch.zeros_like(rates[:, :1]), steps.cumsum(dim=1)), dim=1)


def _to_first_frame(values: Tensor, angle: Tensor) -> Tensor:
    """Rotate (x, z) from a body frame with yaw `angle`, [..., 1], to the first frame's."""
    cosine, sine = angle.cos()[..., 0], angle.sin()[..., 0]
    x, z = values[..., 0], values[..., 1]
    return torch.stack((cosine * x - sine * z, sine * x + cosine * z), dim=-1)


def frames_within(lengths: Lengths, frames: int) -> Mask:
    """A mask that is True for frames within each length."""
    return torch.arange(frames, device=lengths.device) < lengths[:, None]


@dataclass(frozen=True, eq=False)
class MotionBatch:
    """Crops of motions, zero-padded, for training step `step` (from 0), after the share `progress` of all steps.

    `window` is each crop's window, `frames` are the indices of its rows in it. Randomness comes from `generator` (CPU).
    """

    rows: Rows
    lengths: Lengths
    mask: Mask
    conditions: Conditions
    window: Int64[Tensor, "batch"]
    frames: Int64[Tensor, "batch frames"]
    generator: torch.Generator
    step: int = 0
    progress: float = 0.0

    def at_step(self, step: int, steps: int, device: torch.device) -> "MotionBatch":
        """The batch of this step, on a device."""
        tensors: dict[str, Any] = {
            name: each.to(device) for name, each in vars(self).items() if isinstance(each, Tensor | Conditions)
        }
        return replace(self, step=step, progress=step / steps, **tensors)


@dataclass(frozen=True, eq=False)
class SampleBatch:
    """Motions to sample: lengths in frames (CPU), conditions, the null conditions for guidance, and how to sample.

    Row i uses `generators[i]` alone.
    """

    lengths: Lengths
    conditions: Conditions
    unconditional: Conditions
    generators: Sequence[torch.Generator]
    diffusion: DiffusionConfig

    @property
    def device(self) -> torch.device:
        """The conditions' device, for the network's inputs."""
        return self.conditions.given.device

    @property
    def frames(self) -> int:
        """Frames of the longest motion."""
        return int(self.lengths.max())

    @property
    def mask(self) -> Mask:
        """True for valid frames, False for padding."""
        return frames_within(self.lengths, self.frames).to(self.device)

    def noise(self, *shape: int) -> Float[Tensor, "batch *shape"]:
        """N(0, I) of this shape per row, float64."""
        noise = [torch.randn(shape, generator=each, dtype=torch.float64) for each in self.generators]
        return torch.stack(noise).to(self.device)

    def noise_within(self, counts: Int64[Tensor, "batch"], numbers: int) -> Float[Tensor, "batch most numbers"]:
        """N(0, I) for the first `counts` places of every row, zero-padded: a row does not depend on longer ones."""
        noise = torch.zeros((len(counts), int(counts.max()), numbers), dtype=torch.float64)
        for row, (count, generator) in enumerate(zip(counts.tolist(), self.generators, strict=True)):
            noise[row, :count] = torch.randn((count, numbers), generator=generator, dtype=torch.float64)
        return noise.to(self.device)


@dataclass(frozen=True, eq=False)
class MotionCorpus:
    """Windows of a store with their conditions; `last_tick` is a window's last frame at the system's framerate."""

    config: MotionsConfig
    vectors: PoseVectors
    scaling: VectorScaling
    poses: WindowPoses
    last_tick: Int64[np.ndarray, "windows"]
    conditions: WindowConditions

    def __len__(self) -> int:
        return len(self.last_tick)

    def batch(self, rows: Int64[Tensor, "batch"], generator: torch.Generator, *, drop: float) -> MotionBatch:
        """A random crop of each window with one of its captions or its action, dropped with probability `drop`."""
        chance = torch.rand((4, len(rows)), generator=generator, dtype=torch.float64)
        last_tick = self.last_tick[rows.numpy()]
        lengths = available = last_tick + 1
        if self.config.crops == "random":
            units = available // CROP_MULTIPLE - (chance[0].numpy() < SHORTER_SHARE)
            lengths = np.clip(units * CROP_MULTIPLE, CROP_MULTIPLE, available)
        start = np.floor(chance[1].numpy() * (available - lengths + 1)).astype(np.int64)
        counts, most = torch.from_numpy(lengths), self.config.sampled_frames
        if most and self.config.crops == "scattered":
            shares = torch.rand((len(rows), most), generator=generator, dtype=torch.float64)
            frames, counts = (shares * counts[:, None]).to(torch.int64), torch.full((len(rows),), most)
        else:
            first = torch.zeros(len(rows), dtype=torch.int64)
            if most:
                shares = torch.rand(len(rows), generator=generator, dtype=torch.float64)
                whole, counts = counts, counts.clamp(max=most)
                first = (shares * (whole - counts + 1)).to(torch.int64)
            frames = first[:, None] + torch.arange(int(counts.max()))
        ticks = np.minimum(start[:, None] + frames.numpy(), last_tick[:, None])
        vectors = torch.from_numpy(self.poses.at_rate(rows.numpy(), ticks, self.config.framerate).vectors)
        mask = frames_within(counts, vectors.shape[1])
        # A window has captions or an action, never both: there is nothing to choose.
        conditions = self.conditions.draw(rows, chance[[0, 2, 3]], drop=drop)
        padded = self.scaling.apply(vectors) * mask[..., None]
        return MotionBatch(padded, counts, mask, conditions, rows, frames, generator)


def open_corpus(
    store: Store, motions: MotionsConfig, conditions: ConditionsConfig, encoder: TextEncoder | None
) -> MotionCorpus:
    """Windows of the chosen sequences; raises `UsageError` if there are none, or none with the configured condition."""
    vectors = training_vectors(motions.pose_vectors, store, motions.where or None)
    source, frames = open_frames(vectors, store, motions.where or None)
    windows = cut_windows(
        source,
        max_duration_seconds=motions.max_duration_seconds,
        stride_seconds=motions.stride_seconds,
        min_duration_seconds=motions.min_seconds,
        mirror_pairs=SMPL22.left_right_pairs if motions.mirrored else None,
    )
    poses = WindowPoses(windows, frames, motions.framerate)
    sequences, count = store.columns("captions", "action"), len(windows)
    captions = captions_of_windows(windows, sequences) if conditions.kind == "text" else [()] * count
    actions = actions_of_windows(windows, sequences) if conditions.kind == "action" else [""] * count
    conditions.check(any(captions), any(actions))

    def embed(texts: list[str]) -> Float32[Tensor, "texts dimension"]:
        if encoder is None:
            return torch.zeros((1, 0))
        return conditions.embedded(embed_texts(encoder, texts, cache_root(store.path, store.fingerprint)), texts)

    duration = torch.from_numpy(windows.duration_seconds / motions.max_duration_seconds).float()
    return MotionCorpus(
        config=motions,
        vectors=vectors,
        scaling=measure_scaling(poses, grouped=True),
        poses=poses,
        last_tick=np.floor(windows.duration_seconds * float(motions.framerate) + 1e-6).astype(np.int64),
        conditions=window_conditions(captions, actions, duration, embed),
    )
