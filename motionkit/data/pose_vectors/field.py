"""`field` pose vectors: positions, every number a function of time alone (`motionkit.features.field`)."""

from dataclasses import dataclass

import numpy as np

from motionkit.core.shapes import Float32, Float64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.data.poses import FramePositions, FrameVectors
from motionkit.features import field
from motionkit.fields.motion_field import Poses
from motionkit.store.cache import PositionCache, open_cache
from motionkit.store.reader import Store


@dataclass(frozen=True)
class FieldVectors:
    """Positions: the root's in the window's frame, the others' relative to it; metres."""

    @property
    def skeleton(self) -> Skeleton:
        """The 22-joint layout."""
        return SMPL22

    @property
    def num_features(self) -> int:
        """66."""
        return field.num_features(SMPL22.num_joints)

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """The root's x and z, then everything else."""
        return (0, 2), tuple(number for number in range(self.num_features) if number not in (0, 2))

    def open(self, store: Store, where: str | None) -> tuple[PositionCache, FrameVectors]:
        """Positions straight from the cache."""
        cache = open_cache(store, layout=SMPL22.name, where=where)
        return cache, FramePositions(cache, SMPL22.left_right_pairs)

    def instants(self, seconds: Float64[np.ndarray, "times"]) -> Float64[np.ndarray, "times"]:
        """`seconds` themselves: nothing is integrated."""
        return seconds

    def decode(
        self,
        vectors: Float32[np.ndarray, "times numbers"],
        instants: Float64[np.ndarray, "times"],
        seconds: Float64[np.ndarray, "times"],
    ) -> Poses:
        """Adds the root to the other joints."""
        return Poses(field.decode(vectors))


FIELD_VECTORS = FieldVectors()
