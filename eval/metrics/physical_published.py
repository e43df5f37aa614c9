"""Published metrics of feet and floors as their projects compute them, thresholds and units included.

Each takes one motion in the 22-joint layout (metres, y up, floor at `floor`) and its framerate, in float64. What a
project counts per frame is counted per frame here, without `fps`: such a value depends on the framerate
(docs/results/physical.md). Implemented anew from the sources that the functions name.
"""

import numpy as np

from eval.metrics.distributions import checked_features
from eval.metrics.metric import Metric
from eval.metrics.motion import checked_fps
from motionkit.core.shapes import Bool, Float, Float64
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import runs

Positions = Float[np.ndarray, "frames 22 3"]

GMD_FPS = 20.0
"""The framerate of HumanML3D, a constant in GMD's code."""
GMD_HEIGHT, GMD_SPEED, GMD_WINDOW = 0.05, 0.5, 5
MDM_CONTACT_METRES = 0.01
HUMANML3D_CONTACT_SQUARED = 0.002
MBENCH_HEIGHT, MBENCH_STEP, MBENCH_TOLERANCE = 0.02, 0.01, 0.005
MBENCH_REST, MBENCH_STILL, MBENCH_SLOW, MBENCH_FAST, MBENCH_RUN = 1e-3, 1.2e-4, 0.6, 1.75, 4
KIMODO_HEIGHT, KIMODO_SPEED = 0.05, 0.2
PHYSDIFF_TOLERANCE = 0.005
SMALL = 1e-6
"""What MBench and Kimodo add to a number of contacts before dividing by it."""

assert SMPL22.feet is not None
TOES = [SMPL22.feet.left_toe, SMPL22.feet.right_toe]
FEET = [SMPL22.feet.left_ankle, SMPL22.feet.left_toe, SMPL22.feet.right_ankle, SMPL22.feet.right_toe]


def gmd_skating_ratio(positions: Positions, fps: float, floor: float = 0.0) -> float:
    """Fraction of steps in which a toe is under 5 cm in both frames and faster than 0.5 m/s, both then and on average.

    Speeds are steps × 20, at any framerate: 2.5 cm per frame. The average is over 5 steps, with zeros beyond the ends.
    Source: GMD (Karunratanakul et al. 2023), korrawe/guided-motion-diffusion@2f6264a,
    data_loaders/humanml/utils/metrics.py, calculate_skating_ratio; CondMDI and CLoSD have the same.
    """
    from scipy.ndimage import uniform_filter1d

    toes = checked_motion(positions, floor)[:, TOES]
    speed = _horizontal(np.diff(toes, axis=0)) * GMD_FPS
    average = uniform_filter1d(speed, GMD_WINDOW, axis=0, mode="constant")
    skates = _low_twice(toes, GMD_HEIGHT) & (speed > GMD_SPEED) & (average > GMD_SPEED)
    return float(skates.any(axis=1).mean())


def mdm_contact_share(positions: Positions, fps: float, floor: float = 0.0) -> float:
    """Fraction of (steps × ankles and toes) that MDM's contact loss treats as contact: at most 1 cm per frame.

    Source: MDM (Tevet et al. 2023), GuyTevet/motion-diffusion-model@d4fd88c, diffusion/gaussian_diffusion.py,
    the mask of the term "fc".
    """
    return float((_steps(positions) <= MDM_CONTACT_METRES).mean())


def mdm_contact_loss(positions: Positions, fps: float, floor: float = 0.0) -> float:
    """MDM's foot contact term of a motion against itself: mean square over coordinates of the steps in contact, m².

    Contacts are those of `mdm_contact_share`; other steps count as 0. In MDM contacts are of the true motion, steps of
    the model's. Source: as `mdm_contact_share`.
    """
    steps = _steps(positions)
    return float((np.square(steps) * (steps <= MDM_CONTACT_METRES)).mean() / 3.0)


def humanml3d_contact_share(positions: Positions, fps: float, floor: float = 0.0) -> float:
    """Fraction of (steps × ankles and toes) with HumanML3D's contact label: a squared step under 0.002 m² (4.5 cm).

    Source: HumanML3D (Guo et al. 2022), as in GuyTevet/motion-diffusion-model@d4fd88c,
    data_loaders/humanml/scripts/motion_process.py, foot_detect with the threshold 0.002.
    """
    return float((np.square(_steps(positions)) < HUMANML3D_CONTACT_SQUARED).mean())


def mbench_foot_sliding(positions: Positions, fps: float, floor: float = 0.0) -> float:
    """Mean horizontal step of a toe in contact, metres per frame, averaged over both feet.

    In contact: a step under 1 cm, or a height under 2 cm. The last step counts twice. Source: MBench (ViMoGen, 2025),
    SMPLCap/ViMoGen@230b14f, mbench/motion_quality.py, get_contact and compute_foot_sliding.
    """
    toes = checked_motion(positions, floor)[:, TOES]
    contact = _mbench_contact(toes)
    slid = (_horizontal(_mbench_steps(toes)) * contact).sum(axis=0) / (contact.sum(axis=0) + SMALL)
    return float(slid.mean())


def mbench_penetration(positions: Positions, fps: float, floor: float = 0.0) -> float:
    """Mean depth in metres of the toes that are more than 5 mm under the floor, over these only; 0 if there are none.

    Source: MBench, as `mbench_foot_sliding`, compute_ground_penetration.
    """
    height = checked_motion(positions, floor)[:, TOES, 1]
    under = height < -MBENCH_TOLERANCE
    return float(-height[under].mean()) if under.any() else 0.0


def mbench_jitter(positions: Positions, fps: float, floor: float = 0.0) -> float:
    """Mean second difference of joints in the world plus that relative to the root, metres per frame².

    MBench has 24 joints or 22, by the file. Source: MBench, as `mbench_foot_sliding`, compute_jitter_degree.
    """
    motion = checked_motion(positions, floor)
    each = (motion, motion - motion[:, :1])
    return float(sum(np.linalg.norm(np.diff(one, n=2, axis=0), axis=-1).mean() for one in each))


def mbench_foot_floating(positions: Positions, fps: float, floor: float = 0.0) -> float:
    """Fraction of frames in which feet float; MBench adds three counts, so it may exceed 1.

    A toe in contact (as for `mbench_foot_sliding`) floats if it moves, the root moves 1 mm per frame or more, and the
    toe's step relative to the root is less than 0.6 or more than 1.75 of the root's; a frame counts if all toes in
    contact float. In runs of four or more frames without contact, each toe whose relative step is under 0.4 of the
    root's counts half a frame, unless the root rests for more than half of the run; runs without contact of either toe
    count whole if the left one's direction from its first place turns to and fro more than twice. Source: MBench, as
    `mbench_foot_sliding`, compute_foot_floating.
    """
    motion = checked_motion(positions, floor)
    root, toes = motion[:, :1], motion[:, TOES]
    touches = _mbench_contact(toes)
    root_step, relative, step = (np.linalg.norm(_mbench_steps(each), axis=-1) for each in (root, toes - root, toes))
    rate = relative / (root_step + SMALL)
    root_moves, moves = root_step[:, 0] >= MBENCH_REST, step > MBENCH_STILL
    hangs = moves & ((rate < MBENCH_SLOW) | (rate > MBENCH_FAST)) & root_moves[:, None]
    count = float((touches.any(axis=1) & (hangs | ~touches).all(axis=1)).sum())
    for foot in range(2):
        for start, stop in zip(*runs(~touches[:, foot]), strict=True):
            if stop - start >= MBENCH_RUN and (~root_moves[start:stop]).mean() <= 0.5:
                count += float((rate[start:stop, foot] < MBENCH_SLOW - 0.2).sum()) / 2
    for start, stop in zip(*runs(~(touches[:, 0] | touches[:, 1])), strict=True):
        if stop - start >= MBENCH_RUN and _turns(toes[start:stop, 0]) > 2:
            count += stop - start
    return count / len(motion)


def kimodo_foot_skate(positions: Positions, fps: float, floor: float = 0.0) -> float:
    """Mean speed (all three axes) of toes under 5 cm, m/s. Differences of successive frames, per second.

    Source: Kimodo (NVIDIA 2026), nv-tlabs/kimodo@7330e7e, kimodo/metrics/foot_skate.py, FootSkateFromHeight.
    """
    toes = checked_motion(positions, floor)[:, TOES]
    speed = np.linalg.norm(np.diff(toes, axis=0), axis=-1) * checked_fps(fps)
    low = toes[:-1, :, 1] < KIMODO_HEIGHT
    return float((speed * low).sum() / (low.sum() + SMALL))


def kimodo_skate_ratio(positions: Positions, fps: float, floor: float = 0.0) -> float:
    """Fraction faster than 0.2 m/s of the steps of toes that are under 5 cm in both frames.

    Source: Kimodo, as `kimodo_foot_skate`, FootSkateRatio. Its FootContactConsistency needs contacts predicted by a
    model (0.15 m/s, 10 cm), which joint positions don't hold.
    """
    toes = checked_motion(positions, floor)[:, TOES]
    speed = np.linalg.norm(np.diff(toes, axis=0), axis=-1) * checked_fps(fps)
    low = _low_twice(toes, KIMODO_HEIGHT)
    return float((low & (speed > KIMODO_SPEED)).sum() / (low.sum() + SMALL))


def physdiff_penetrate(positions: Positions, fps: float, floor: float = 0.0) -> float:
    """Mean over frames of the lowest joint's depth under the floor beyond 5 mm, millimetres.

    Source: PhysDiff (Yuan et al. 2023, section 4), which has no public code and takes the lowest vertex of a mesh; of
    joints as in GuyTevet/CLoSD@a9ac7a9, closd/diffusion_planner/data_loaders/humanml/utils/metrics.py,
    calculate_penetration.
    """
    lowest = checked_motion(positions, floor)[..., 1].min(axis=1)
    return float(np.maximum(0.0, -lowest - PHYSDIFF_TOLERANCE).mean() * 1000.0)


def physdiff_float(positions: Positions, fps: float, floor: float = 0.0) -> float:
    """Mean over frames of the lowest joint's height above the floor beyond 5 mm, millimetres.

    Source: as `physdiff_penetrate`, calculate_floating.
    """
    lowest = checked_motion(positions, floor)[..., 1].min(axis=1)
    return float(np.maximum(0.0, lowest - PHYSDIFF_TOLERANCE).mean() * 1000.0)


def physdiff_skate(positions: Positions, fps: float, floor: float = 0.0) -> float:
    """Mean horizontal step in millimetres a frame of the lowest joint, 0 unless it is within 5 mm of the floor twice.

    PhysDiff: "we find foot joints that contact the ground in two adjacent frames and compute their average horizontal
    displacement within the frames". Source: as `physdiff_penetrate`, calculate_foot_sliding.
    """
    motion = checked_motion(positions, floor)
    steps, rows = np.arange(len(motion) - 1), motion[..., 1].argmin(axis=1)[:-1]
    now, after = motion[steps, rows], motion[steps + 1, rows]
    contact = (now[:, 1] <= PHYSDIFF_TOLERANCE) & (after[:, 1] <= PHYSDIFF_TOLERANCE)
    return float((_horizontal(after - now) * contact).mean() * 1000.0)


def checked_motion(
    positions: Float[np.ndarray, "frames joints 3"], floor: float = 0.0
) -> Float64[np.ndarray, "frames joints 3"]:
    """A copy in float64 with the floor at 0; raises `ValueError` for fewer than 3 frames, NaN or infinity."""
    rows = checked_features(positions.reshape(len(positions), -1), "positions", 3)
    return np.asarray(rows.reshape(positions.shape) - [0.0, floor, 0.0])


def _steps(positions: Positions) -> Float64[np.ndarray, "steps 4"]:
    """Length of every step of ankles and toes, metres."""
    return np.asarray(np.linalg.norm(np.diff(checked_motion(positions)[:, FEET], axis=0), axis=-1))


def _mbench_steps(joints: Float64[np.ndarray, "frames joints 3"]) -> Float64[np.ndarray, "frames joints 3"]:
    steps = np.diff(joints, axis=0)
    return np.concatenate((steps, steps[-1:]))


def _mbench_contact(toes: Float64[np.ndarray, "frames 2 3"]) -> Bool[np.ndarray, "frames 2"]:
    is_slow = np.linalg.norm(_mbench_steps(toes), axis=-1) < MBENCH_STEP
    return np.asarray(is_slow | (toes[..., 1] < MBENCH_HEIGHT))


def _turns(path: Float64[np.ndarray, "frames 3"]) -> int:
    """How often the angle between the way from the first place and the way to the last one has a peak."""
    from scipy.signal import find_peaks

    ways = path[1:] - path[0]
    ways = ways / (np.linalg.norm(ways, axis=-1, keepdims=True) + SMALL)
    return len(find_peaks(np.degrees(np.arccos(np.clip(ways @ ways[-1], -1.0, 1.0))))[0])


def _horizontal(steps: Float64[np.ndarray, "*steps 3"]) -> Float64[np.ndarray, "*steps"]:
    return np.asarray(np.hypot(steps[..., 0], steps[..., 2]))


def _low_twice(joints: Float64[np.ndarray, "frames joints 3"], height: float) -> Bool[np.ndarray, "steps joints"]:
    low = joints[..., 1] < height
    return np.asarray(low[:-1] & low[1:])


METRICS = (
    Metric("gmd_skating_ratio", "GMD skating ratio", "", False, "GMD", gmd_skating_ratio),
    Metric("mdm_contact_share", "MDM contact", "", None, "MDM", mdm_contact_share),
    Metric("mdm_contact_loss", "MDM contact loss", "m²/frame²", False, "MDM", mdm_contact_loss),
    Metric("humanml3d_contact_share", "HumanML3D contact", "", None, "HumanML3D", humanml3d_contact_share),
    Metric("mbench_foot_sliding", "MBench foot sliding", "m/frame", False, "MBench", mbench_foot_sliding),
    Metric("mbench_foot_floating", "MBench foot floating", "", False, "MBench", mbench_foot_floating),
    Metric("mbench_penetration", "MBench penetration", "m", False, "MBench", mbench_penetration),
    Metric("mbench_jitter", "MBench jitter degree", "m/frame²", False, "MBench", mbench_jitter),
    Metric("kimodo_foot_skate", "Kimodo foot skate", "m/s", False, "Kimodo", kimodo_foot_skate),
    Metric("kimodo_skate_ratio", "Kimodo skate ratio", "", False, "Kimodo", kimodo_skate_ratio),
    Metric("physdiff_penetrate", "PhysDiff Penetrate", "mm", False, "PhysDiff, of joints", physdiff_penetrate),
    Metric("physdiff_float", "PhysDiff Float", "mm", False, "PhysDiff, of joints", physdiff_float),
    Metric("physdiff_skate", "PhysDiff Skate", "mm/frame", False, "PhysDiff, of joints", physdiff_skate),
)
