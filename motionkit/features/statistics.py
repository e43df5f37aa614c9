"""Mean and standard deviation of pose vectors."""

from dataclasses import dataclass

import numpy as np

from motionkit.core.shapes import Float, Float32, Float64


@dataclass(frozen=True, eq=False)
class Statistics:
    """Mean and std by which pose vectors are standardised; raises `ValueError` where these cannot be."""

    mean: Float64[np.ndarray, "numbers"]
    std: Float64[np.ndarray, "numbers"]

    def __post_init__(self) -> None:
        if self.mean.shape != self.std.shape:
            raise ValueError(f"mean has {self.mean.size} numbers, std {self.std.size}")
        if not (np.isfinite(self.mean).all() and np.isfinite(self.std).all() and (self.std > 0).all()):
            raise ValueError("statistics must be finite, and every std above 0")

    def restore(self, rows: Float[np.ndarray, "*rows numbers"]) -> Float32[np.ndarray, "*rows numbers"]:
        """Standardised rows in their own units: rows · std + mean."""
        return np.asarray(rows * self.std + self.mean, dtype=np.float32)
