"""What a motion field learns at each instant: `field`, `native` or `rotations` pose vectors.

A convention is one frozen value that knows its size, how a store's frames become vectors (`open`: what doesn't depend
on the batch is computed once, the rest when poses are drawn) and how vectors at some instants become poses again
(`decode`). `field` are positions, every number a function of time alone (`motionkit.features.field`); `native` are the
published 263 numbers in per-second units, whose path is integrated (`motionkit.features.native`); `rotations` are
SMPL's joint rotations and root translation (`nerm.rotation_vectors`).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64, Int64

from motionkit.clips import FramePositions, FrameVectors
from motionkit.features import field, native
from motionkit.features.layout import SMPL22_LAYOUT
from motionkit.motionfield import Poses
from motionkit.skeleton import SMPL22, Skeleton
from motionkit.store.cache import PositionCache, open_cache
from motionkit.store.derived import derived_rows
from motionkit.store.reader import Store
from motionkit.store.row_file import RowFile
from nerm.recipes import PoseVectorsName
from nerm.rotation_vectors import RotationVectors, smpl_rig, training_rig

SECONDS_BETWEEN_STEPS = 1 / 120
NATIVE_ROWS = "native-vectors-1"
RIG = "rig.offsets"


@runtime_checkable
class PoseVectors(Protocol):
    """A convention of pose vectors over some skeleton."""

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton of decoded poses; its first 22 joints are the 22-joint layout's."""
        ...

    @property
    def num_numbers(self) -> int:
        """Numbers per pose."""
        ...

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of one unit and kind, which may share a scale; each number is in one group, the path in the first."""
        ...

    def open(self, store: Store, where: str | None) -> tuple[PositionCache, FrameVectors]:
        """The sequences for which `where` holds and that have such vectors, and how their frames become them.

        Raises `UsageError` where there are none.
        """
        ...

    def instants(self, seconds: Float64[np.ndarray, "times"]) -> Float64[np.ndarray, "instants"]:
        """The instants at which decoding needs vectors: `seconds` themselves, or more than those in ascending order."""
        ...

    def decode(
        self,
        vectors: Float32[np.ndarray, "instants numbers"],
        instants: Float64[np.ndarray, "instants"],
        seconds: Float64[np.ndarray, "times"],
    ) -> Poses:
        """Poses at `seconds` in the window's frame, from vectors at `instants(seconds)`."""
        ...


@dataclass(frozen=True)
class FieldVectors:
    """Positions: the root's in the window's frame, the others' relative to it; metres."""

    @property
    def skeleton(self) -> Skeleton:
        """The 22-joint layout."""
        return SMPL22

    @property
    def num_numbers(self) -> int:
        """66."""
        return field.num_numbers(SMPL22.num_joints)

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """The root's x and z, then everything else."""
        return (0, 2), tuple(number for number in range(self.num_numbers) if number not in (0, 2))

    def open(self, store: Store, where: str | None) -> tuple[PositionCache, FrameVectors]:
        """Positions straight from the cache."""
        cache = open_cache(store, layout=SMPL22.name, where=where)
        return cache, FramePositions(cache, SMPL22.left_right_pairs)

    def instants(self, seconds: Float64[np.ndarray, "times"]) -> Float64[np.ndarray, "times"]:
        """The asked ones: nothing needs integration."""
        return seconds

    def decode(
        self,
        vectors: Float32[np.ndarray, "times numbers"],
        instants: Float64[np.ndarray, "times"],
        seconds: Float64[np.ndarray, "times"],
    ) -> Poses:
        """One addition."""
        return Poses(field.decode(vectors))


FIELD_VECTORS = FieldVectors()


@dataclass(frozen=True, eq=False)
class NativeRows:
    """Rows of `native` vectors; they mean the same in every window's frame."""

    rows: RowFile

    def gather(
        self, row: Int64[np.ndarray, "batch poses"], mirrored: Bool[np.ndarray, "batch"]
    ) -> Float32[np.ndarray, "batch poses numbers"]:
        """Vectors of frames, mirrored where the window is."""
        gathered = self.rows[row]
        if mirrored.any():
            gathered[mirrored] = native.mirrored(gathered[mirrored], SMPL22.name)
        return gathered

    def between(
        self,
        before: Float32[np.ndarray, "batch poses numbers"],
        after: Float32[np.ndarray, "batch poses numbers"],
        weight: Float32[np.ndarray, "batch poses"],
    ) -> Float32[np.ndarray, "batch poses numbers"]:
        """Linear, number by number."""
        return np.asarray(before + weight[..., None] * (after - before))

    def encode(
        self,
        gathered: Float32[np.ndarray, "batch poses numbers"],
        yaw: Float32[np.ndarray, "batch"],
        origin: Float32[np.ndarray, "batch 2"],
    ) -> Float32[np.ndarray, "batch poses numbers"]:
        """They are vectors already."""
        return gathered


@dataclass(frozen=True)
class NativeVectors:
    """The published vector's 263 numbers in per-second units, at any framerate."""

    @property
    def skeleton(self) -> Skeleton:
        """The 22-joint layout."""
        return SMPL22

    @property
    def num_numbers(self) -> int:
        """263."""
        return SMPL22_LAYOUT.vector.size

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """The root's three velocities, then the other blocks inside which HumanML3D averages its deviations."""
        turning, walking, *others = (tuple(range(block.start, block.stop)) for block in SMPL22_LAYOUT.vector.blocks)
        return turning + walking, *others

    def open(self, store: Store, where: str | None) -> tuple[PositionCache, FrameVectors]:
        """Vectors of whole sequences, computed once: derivatives and the smoothed facing need a frame's neighbours."""
        cache = open_cache(store, layout=SMPL22.name, where=where)

        def compute() -> Iterator[Float32[np.ndarray, "frames numbers"]]:
            for sequence in range(cache.num_sequences):
                positions = np.asarray(cache.sequence_positions(sequence))
                if len(positions) < 2:
                    yield np.zeros((len(positions), self.num_numbers), np.float32)
                else:
                    yield native.vectors(positions, SMPL22.name, cache.exact_fps(sequence))

        return cache, NativeRows(derived_rows(cache, NATIVE_ROWS, self.num_numbers, compute))

    def instants(self, seconds: Float64[np.ndarray, "times"]) -> Float64[np.ndarray, "instants"]:
        """All from the window's start, no more than 1/120 s apart: the path is integrated over them."""
        end = float(seconds.max(initial=0.0))
        return np.union1d(np.arange(0.0, end, SECONDS_BETWEEN_STEPS), seconds)

    def decode(
        self,
        vectors: Float32[np.ndarray, "instants numbers"],
        instants: Float64[np.ndarray, "instants"],
        seconds: Float64[np.ndarray, "times"],
    ) -> Poses:
        """Heading and path integrated over the time stamps; then into the frame in which the first pose faces Z+."""
        made = native.positions_at(vectors, SMPL22.name, instants)
        yaw, origin = field.window_frame(made[:1])
        return Poses(field.to_window(made[None], yaw, origin)[0, np.searchsorted(instants, seconds)])


def training_vectors(name: PoseVectorsName, store: Store, where: str | None) -> PoseVectors:
    """The convention that a training on some sequences of a store learns; raises `UsageError` as `open` does."""
    if name == "field":
        return FIELD_VECTORS
    return NativeVectors() if name == "native" else RotationVectors(training_rig(store, where))


def described(vectors: PoseVectors) -> dict[str, torch.Tensor]:
    """What a convention adds to a trained field's file: the rig of `rotations`, nothing else."""
    return {RIG: torch.from_numpy(vectors.skeleton.offsets)} if isinstance(vectors, RotationVectors) else {}


def restored(name: PoseVectorsName, tensors: Mapping[str, torch.Tensor]) -> PoseVectors:
    """A trained field's convention from its file; raises `KeyError` where the rig is missing."""
    if name == "rotations":
        return RotationVectors(smpl_rig(tensors[RIG].numpy()))
    return FIELD_VECTORS if name == "field" else NativeVectors()
