"""How strong fast motion is by joint and band, given the slow motion; `motionkit.clips.detail` learns it."""

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt
from jaxtyping import Float64

from motionkit.core.skeleton import SMPL22
from motionkit.fields.detail.slow_motion import (
    BAND_REACH,
    NUM_BANDS,
    NUM_FEATURES,
    SlowMotion,
    band_filters,
    band_motion,
)

FLOOR_METRES = 0.0005
"""White noise of this standard deviation at 120 fps is added to a power before its logarithm is taken."""
LARGEST_FEATURE = 4.0
NUM_JOINTS = SMPL22.num_joints
_CHUNK, _FIRST = 1024, 1 << 16


@dataclass(frozen=True, eq=False)
class Detail:
    """Log power of fast motion as a linear function of features of slow motion, and how joints move together there.

    `centre` and `scale` standardise features; `weights` and `offset` give the log of power (m²) above a floor, of
    `NUM_BANDS` × 22 joints, never more than `most`; `mixing` makes of independent numbers those of joints (across, up,
    ahead) of one band, each joint's squares adding up to 1. Raises `ValueError` for other shapes and for numbers that
    are not finite.
    """

    centre: Float64[np.ndarray, "features"]
    scale: Float64[np.ndarray, "features"]
    weights: Float64[np.ndarray, "features outputs"]
    offset: Float64[np.ndarray, "outputs"]
    most: Float64[np.ndarray, "outputs"]
    mixing: Float64[np.ndarray, "bands coordinates coordinates"]

    def __post_init__(self) -> None:
        outputs, coordinates = NUM_BANDS * NUM_JOINTS, 3 * NUM_JOINTS
        shapes = {
            "centre": (NUM_FEATURES,),
            "scale": (NUM_FEATURES,),
            "weights": (NUM_FEATURES, outputs),
            "offset": (outputs,),
            "most": (outputs,),
            "mixing": (NUM_BANDS, coordinates, coordinates),
        }
        for name, values in self.arrays().items():
            if values.shape != shapes[name]:
                raise ValueError(f"{name} is {values.shape}, expected {shapes[name]}")
            if not np.isfinite(values).all():
                raise ValueError(f"{name} holds a number that is not finite")

    def arrays(self) -> dict[str, npt.NDArray[np.float64]]:
        """Every number, by name."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    def power(self, slow: SlowMotion) -> Float64[np.ndarray, "instants bands joints"]:
        """Mean squared displacement (m²) that motion in this state has in every band."""
        state = np.clip((slow.features - self.centre) * self.scale, -LARGEST_FEATURE, LARGEST_FEATURE)
        log_power = np.minimum(state @ self.weights + self.offset, self.most)
        power = np.exp(log_power).reshape(-1, NUM_BANDS, NUM_JOINTS) - floors()[:, None]
        return np.asarray(np.maximum(power, 0.0))

    def noise(self, seeds: tuple[int, int], start: int, stop: int) -> Float64[np.ndarray, "bands instants joints 3"]:
        """Random motion of every band at instants [start, stop) of the grid, joints' squares 1 on average.

        It is a function of the two seeds and the instant alone.
        """
        white = _white(seeds, start - BAND_REACH, stop + BAND_REACH, 3 * NUM_JOINTS)
        bands = band_motion(white) / np.linalg.norm(band_filters(), axis=1)[:, None, None]
        made = bands @ np.swapaxes(self.mixing, 1, 2)
        return np.asarray(made.reshape(*made.shape[:2], NUM_JOINTS, 3))


def floors() -> Float64[np.ndarray, "bands"]:
    """The power in every band of white noise of `FLOOR_METRES`, of three coordinates, m²."""
    return np.asarray(3.0 * FLOOR_METRES**2 * np.square(band_filters()).sum(axis=1))


def _white(seeds: tuple[int, int], start: int, stop: int, columns: int) -> Float64[np.ndarray, "instants columns"]:
    """Independent normal numbers of instants from `start` (which may be before 0) on, drawn in chunks of the grid."""
    first, last = (start + _FIRST) // _CHUNK, (stop + _FIRST - 1) // _CHUNK
    each = (np.random.default_rng((*seeds, chunk)) for chunk in range(first, last + 1))
    drawn = [generator.standard_normal((_CHUNK, columns)) for generator in each]
    offset = start + _FIRST - first * _CHUNK
    return np.concatenate(drawn)[offset : offset + stop - start]
