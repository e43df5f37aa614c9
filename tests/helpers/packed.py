"""What a page packs of positions, unpacked as its script does."""

import base64

import numpy as np

from motionkit.viz.player.takes import Packed


def unpack(packed: Packed) -> np.ndarray:
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
