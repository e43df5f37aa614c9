"""What a page packs of positions, unpacked as its script does."""

import base64

import numpy as np

from motionkit.viz.player import Packed


def unpack(packed: Packed) -> np.ndarray:
    """The positions that a page shows, in metres: those that were packed, to half a step. The page does the same."""
    root = np.frombuffer(base64.b64decode(packed["root"]), "<f4").reshape(-1, 1, 3)
    steps = np.frombuffer(base64.b64decode(packed["steps"]), "<i2").reshape(len(root), -1, 3)
    return (root + steps * packed["stepMetres"]).astype(np.float32)
