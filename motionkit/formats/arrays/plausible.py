"""Arrays that strangers wrote: numbers that a body can have, rotations of unit length."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32

from motionkit.errors import FormatError

# A kilometre in millimetres.
MAX_NUMBER = 1e6
# Quaternions of float16 are off unit length by 1e-3.
MAX_LENGTH_ERROR = 0.01


def checked_numbers(array: np.ndarray, path: Path, name: str = "") -> Float32[np.ndarray, "..."]:
    """An array as float32, frames first; raises `FormatError` (`nan`, `range`) with the first frame that is none."""
    if array.dtype == np.float16:
        array = array.astype(np.float32)  # a million is beyond what float16 can be compared with
    rows = array.reshape(len(array), -1)
    for reason, bad in (("nan", ~np.isfinite(rows)), ("range", (rows > MAX_NUMBER) | (rows < -MAX_NUMBER))):
        if bad.any():
            frame = int(np.flatnonzero(bad.any(axis=1))[0])
            value = rows[frame][bad[frame]][0]
            message = f"{name}{': ' if name else ''}{value} where a number of a body was expected"
            raise FormatError(message, path=path, reason=reason, frame=frame)
    return np.ascontiguousarray(array, dtype=np.float32)


def checked_rotations(rotations: Float[np.ndarray, "frames joints 4"], path: Path, name: str) -> None:
    """Raise `FormatError` (`range`) where a quaternion's length is off 1 by more than 0.01."""
    error = np.abs(np.linalg.norm(rotations, axis=-1) - 1.0).max(axis=1)
    if error.max() > MAX_LENGTH_ERROR:
        raise FormatError(
            f"{name}: a quaternion's length is off 1 by {error.max():.3g}, expected unit quaternions",
            path=path,
            reason="range",
            frame=int(np.argmax(error > MAX_LENGTH_ERROR)),
        )
