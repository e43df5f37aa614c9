"""SMPL's body joints at its mean shape: what motions get without a body model of the user's own."""

import numpy as np

from motionkit.formats.smpl.layouts import BODY
from motionkit.skeleton import Skeleton

# Rest offsets in metres relative to the parent (pelvis: relative to the model's origin), y up, facing +z, left at +x,
# arms straight out. Source: the bodies of phc/data/assets/mjcf/smpl_humanoid.xml in
# https://github.com/ZhengyiLuo/PHC (BSD 3-clause), made from SMPL's neutral body with all betas 0.
MEAN_OFFSETS = (
    (-0.0018, -0.2233, 0.0282),
    (0.0695, -0.0914, -0.0068),
    (-0.0677, -0.0905, -0.0043),
    (-0.0025, 0.1090, -0.0267),
    (0.0343, -0.3752, -0.0045),
    (-0.0383, -0.3826, -0.0089),
    (0.0055, 0.1352, 0.0011),
    (-0.0136, -0.3980, -0.0437),
    (0.0158, -0.3984, -0.0423),
    (0.0015, 0.0529, 0.0254),
    (0.0264, -0.0558, 0.1193),
    (-0.0254, -0.0481, 0.1233),
    (-0.0028, 0.2139, -0.0429),
    (0.0788, 0.1217, -0.0341),
    (-0.0818, 0.1188, -0.0386),
    (0.0052, 0.0650, 0.0513),
    (0.0910, 0.0305, -0.0089),
    (-0.0960, 0.0326, -0.0091),
    (0.2596, -0.0128, -0.0275),
    (-0.2537, -0.0133, -0.0214),
    (0.2492, 0.0090, -0.0012),
    (-0.2553, 0.0078, -0.0056),
)


def mean_shape_skeleton() -> Skeleton:
    """The 22 body joints of SMPL's mean shape as the skeleton `smpl22-mean-shape`."""
    rest = np.array(MEAN_OFFSETS, np.float64)
    for joint, parent in enumerate(BODY.parents):
        if parent >= 0:
            rest[joint] += rest[parent]
    return BODY.skeleton("smpl22-mean-shape", rest)
