"""Predicts the power of fast motion per joint and band from the slow motion; fitted by `motionkit.training.detail`."""

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from motionkit.core.shapes import Float64
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
"""Standard deviation of white noise at 120 fps that is added to a power before taking its logarithm."""
LARGEST_FEATURE = 4.0
NUM_JOINTS = SMPL22.num_joints
_CHUNK, _FIRST = 1024, 1 << 16


@dataclass(frozen=True, eq=False)
class Detail:
    """Log power of fast motion as a linear function of features of slow motion, and the correlation of joints.

    `centre` and `scale` standardise features; `weights` and `offset` give the log of power (m²) above a floor, of
    `NUM_BANDS` × 22 joints, clipped at `most`; `mixing` maps independent normals to correlated joint components
    (across, up, ahead) of one band, each joint's squares adding up to 1. Raises `ValueError` for other shapes and
    values that are not finite.
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
        """All parameters by name."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    def power(self, slow: SlowMotion) -> Float64[np.ndarray, "instants bands joints"]:
        """Expected squared displacement (m²) in every band, given the state."""
        state = np.clip((slow.features - self.centre) * self.scale, -LARGEST_FEATURE, LARGEST_FEATURE)
        log_power = np.minimum(state @ self.weights + self.offset, self.most)
        power = np.exp(log_power).reshape(-1, NUM_BANDS, NUM_JOINTS) - floors()[:, None]
        return np.asarray(np.maximum(power, 0.0))

    def noise(self, seeds: tuple[int, int], start: int, stop: int) -> Float64[np.ndarray, "bands instants joints 3"]:
        """Random motion of every band at samples [start, stop) of the grid, with unit mean square per joint.

        A function of the two seeds and the sample index alone.
        """
        white = _white(seeds, start - BAND_REACH, stop + BAND_REACH, 3 * NUM_JOINTS)
        bands = band_motion(white) / np.linalg.norm(band_filters(), axis=1)[:, None, None]
        made = bands @ np.swapaxes(self.mixing, 1, 2)
        return np.asarray(made.reshape(*made.shape[:2], NUM_JOINTS, 3))


def floors() -> Float64[np.ndarray, "bands"]:
    """Power in every band of white noise of `FLOOR_METRES` in three coordinates, m²."""
    return np.asarray(3.0 * FLOOR_METRES**2 * np.square(band_filters()).sum(axis=1))


def _white(seeds: tuple[int, int], start: int, stop: int, columns: int) -> Float64[np.ndarray, "instants columns"]:
    """Independent normals for samples from `start` (may be negative) on, drawn in chunks of the grid."""
    first, last = (start + _FIRST) // _CHUNK, (stop + _FIRST - 1) // _CHUNK
    each = (np.random.default_rng((*seeds, chunk)) for chunk in range(first, last + 1))
    drawn = [generator.standard_normal((_CHUNK, columns)) for generator in each]
    offset = start + _FIRST - first * _CHUNK
    return np.concatenate(drawn)[offset : offset + stop - start]
