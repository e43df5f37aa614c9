"""Joint positions as text in a page: whole tenths of a millimetre, two bytes a number, nothing accumulated.

Positions are rounded to a grid of 0.1 mm; a joint is kept as the difference of its grid point to its parent's, which is
exact, so no error adds up along a limb. The difference fits into 16 bits up to 3.2767 m. Joints for which it does not
(the root, which has the origin for its parent, and bodies that travel beneath a resting root) have 32 bits.
"""

import base64
from collections.abc import Sequence
from typing import TypedDict

import numpy as np
from jaxtyping import Float32, Int

STEP_METRES = 1e-4
_NARROW = 2**15 - 1
# Beyond this a grid point does not fit into 32 bits.
FARTHEST_METRES = 2e5


class Packed(TypedDict):
    """What a page holds of positions: int16 [T, narrow joints, 3] and int32 [T, wide joints, 3], base64."""

    step: float
    parents: list[int]
    wide: list[int]
    narrowNumbers: str
    wideNumbers: str


def packed_bytes(num_frames: int, num_joints: int) -> int:
    """About how much of a page positions take: the root wide, all other joints narrow, as text."""
    return num_frames * (num_joints + 1) * 3 * 2 * 4 // 3


def pack(positions: Float32[np.ndarray, "frames joints 3"], parents: Sequence[int]) -> Packed:
    """Positions in metres as text; raises `ValueError` for a joint that is not finite or 200 km from the origin."""
    # A comparison with nan is false.
    if not bool(np.all(np.abs(positions) < FARTHEST_METRES)):
        raise ValueError(f"a joint is not within {FARTHEST_METRES:g} m of the origin")
    points = np.rint(positions.astype(np.float64) / STEP_METRES).astype(np.int32)
    steps: Int[np.ndarray, "frames joints 3"] = points.copy()
    children = [joint for joint, parent in enumerate(parents) if parent >= 0]
    steps[:, children] -= points[:, [parents[joint] for joint in children]]
    far = np.abs(steps).max(axis=(0, 2)) > _NARROW
    far[0] = True
    return Packed(
        step=STEP_METRES,
        parents=list(parents),
        wide=np.flatnonzero(far).tolist(),
        narrowNumbers=_text(steps[:, ~far].astype("<i2")),
        wideNumbers=_text(steps[:, far].astype("<i4")),
    )


def unpack(packed: Packed) -> Float32[np.ndarray, "frames joints 3"]:
    """The positions that a page shows, in metres: those that were packed, to half a step. The page does the same."""
    parents, wide = packed["parents"], packed["wide"]
    narrow = [joint for joint in range(len(parents)) if joint not in wide]
    far = np.frombuffer(base64.b64decode(packed["wideNumbers"]), "<i4").reshape(-1, len(wide), 3)
    near = np.frombuffer(base64.b64decode(packed["narrowNumbers"]), "<i2").reshape(len(far), len(narrow), 3)
    points = np.empty((len(far), len(parents), 3), np.int32)
    points[:, wide], points[:, narrow] = far, near
    for joint, parent in enumerate(parents):
        if parent >= 0:
            points[:, joint] += points[:, parent]
    return (points * packed["step"]).astype(np.float32)


def _text(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
