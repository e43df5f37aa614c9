"""Physical plausibility of motion: height of the floor, foot contact and sliding, jerk and jitter, bone lengths.

Each function takes one motion, joint positions [frames, joints, 3] in metres, y up (computed in float64), and its
framerate. Values are comparable across framerates: speeds are taken over 0.1 s, heights over time, jerk and jitter in
bands resampled to one framerate. None if a motion has nothing to measure. Tables show PhysDiff's Penetrate and Float
(`eval.metrics.physical_published`) beside them, with the motion's own floor (`ground_height`): captures' floors are not
at y = 0.
"""

from fractions import Fraction

import numpy as np

from eval.metrics.metric import Metric
from eval.metrics.physical_published import FEET, checked_motion
from motionkit.core.shapes import Bool, Float, Float64
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import Framerate, parse_fps
from motionkit.fields.resample import resample_positions

Positions = Float[np.ndarray, "frames joints 3"]

GROUND_QUANTILE = 0.05
LOW_METRES = 0.02
SLIDE_SECONDS = 0.1
SLIDING_SPEED = 0.25
SHORTEST_SECONDS = 0.5
JERK_FPS = Fraction(20)
JITTER_FPS, JITTER_HERTZ, JITTER_ORDER = Fraction(40), 10.0, 4
BONE_SECONDS = 0.5


def ground_height(positions: Positions, fps: Framerate) -> float:
    """Height in millimetres of the floor under a motion: the 5 % quantile over time of its lowest joint.

    Not the minimum, which a single bad frame determines. `fps` is not used.
    """
    return 1000.0 * float(np.quantile(checked_motion(positions)[..., 1].min(axis=1), GROUND_QUANTILE))


def foot_rests(
    positions: Positions, fps: Framerate
) -> tuple[Bool[np.ndarray, "instants feet"], Float64[np.ndarray, "instants feet"]]:
    """Which ankles and toes are on the ground, and their horizontal speed over the 0.1 s that follow, m/s.

    A joint is low while it stays within 2 cm of its own lowest level (exceeded for 95 % of the time): ankles are higher
    than toes, and within 5 cm runners' feet swing. Positions are linearly interpolated; instants end 0.1 s before the
    motion does.
    """
    values = checked_motion(positions)[:, FEET]
    reach = SLIDE_SECONDS * float(parse_fps(fps))
    whole = int(reach + 1e-9)
    share = max(0.0, reach - whole)
    num = max(0, len(values) - whole - (share > 1e-9))
    later = values[whole : whole + num]
    if share > 1e-9:
        later = (1.0 - share) * later + share * values[whole + 1 : whole + 1 + num]
    moved = (later - values[:num])[..., ::2] / SLIDE_SECONDS
    height = values[..., 1]
    near = height <= np.quantile(height, GROUND_QUANTILE, axis=0) + LOW_METRES
    stays = np.logical_and.reduce([near[first : first + num] for first in range(whole + 1)])
    return stays, np.hypot(moved[..., 0], moved[..., 1])


def _steadiest(positions: Positions, fps: Framerate) -> Float64[np.ndarray, "contacts"]:
    """Speed of the slowest joint on the ground, at the instants that have one, m/s."""
    low, speed = foot_rests(positions, fps)
    return np.asarray(np.where(low, speed, np.inf).min(axis=1)[low.any(axis=1)])


def slide_speed(positions: Positions, fps: Framerate) -> float | None:
    """Mean speed of the slowest foot joint on the ground, m/s: 0 for a foot that stands or rolls over one point.

    While a body stands, walks or runs, one joint of the feet on the ground rests, so dragging the other foot is not
    skating. None if no foot stays down for 0.1 s.
    """
    speeds = _steadiest(positions, fps)
    return float(speeds.mean()) if len(speeds) else None


def slide_share(positions: Positions, fps: Framerate) -> float | None:
    """Fraction of the time on the ground in which the slowest foot joint exceeds 0.25 m/s; None as `slide_speed`."""
    speeds = _steadiest(positions, fps)
    return float((speeds > SLIDING_SPEED).mean()) if len(speeds) else None


def contact_share(positions: Positions, fps: Framerate) -> float | None:
    """Fraction of time in which a foot is on the ground: 1 for a frozen body, 0 for one that shakes or climbs."""
    low, _ = foot_rests(positions, fps)
    return float(low.any(axis=1).mean()) if len(low) else None


def height_speed_agreement(positions: Positions, fps: Framerate) -> float | None:
    """Fraction of (time × foot joints) in which height and speed agree on contact: low and under 0.25 m/s, or neither.

    They disagree for a foot that slides on the ground or stops in the air, which real feet do too, but less.
    """
    low, speed = foot_rests(positions, fps)
    return float((low == (speed < SLIDING_SPEED)).mean()) if len(low) else None


def jerk(positions: Positions, fps: Framerate) -> float | None:
    """Mean third derivative of joint positions below 10 Hz, m/s³: differences after resampling to 20 fps.

    The raw difference at a capture's own framerate is its noise times the framerate cubed. None under 0.5 s.
    """
    motion = resample_positions(checked_motion(positions), parse_fps(fps), JERK_FPS)
    if len(motion) <= SHORTEST_SECONDS * JERK_FPS:
        return None
    return float(np.linalg.norm(np.diff(motion, n=3, axis=0), axis=-1).mean() * float(JERK_FPS) ** 3)


def jitter(positions: Positions, fps: Framerate) -> float | None:
    """Median displacement between 10 and 20 Hz over joints and time, in millimetres.

    Computed at 40 fps with a zero-phase Butterworth high-pass. The median, since fast movement dominates the mean. None
    below 40 fps, which cannot represent that band, and under 0.5 s.
    """
    from scipy.signal import butter, sosfiltfilt

    if parse_fps(fps) < JITTER_FPS:
        return None
    motion = resample_positions(checked_motion(positions), parse_fps(fps), JITTER_FPS)
    if len(motion) <= SHORTEST_SECONDS * JITTER_FPS:
        return None
    sections = butter(JITTER_ORDER, JITTER_HERTZ, "high", fs=float(JITTER_FPS), output="sos")
    return 1000.0 * float(np.median(np.linalg.norm(sosfiltfilt(sections, motion, axis=0), axis=-1)))


def bone_length_drift(positions: Positions, fps: Framerate) -> float | None:
    """Mean over bones of (longest − shortest) / mean length, lengths averaged over stretches of about 0.5 s.

    Averaged because noise and resampling perturb every frame a little. None if no bone has a length.
    """
    values = checked_motion(positions)
    lengths = np.linalg.norm(values[:, 1:] - values[:, list(SMPL22.parents[1:])], axis=-1)
    num = max(1, int(len(lengths) / (BONE_SECONDS * float(parse_fps(fps)))))
    edges = np.linspace(0, len(lengths), num + 1).astype(np.int64)
    means = np.add.reduceat(lengths, edges[:-1], axis=0) / np.diff(edges)[:, None]
    mean = means.mean(axis=0)
    known = mean > 0
    return float(((means.max(axis=0) - means.min(axis=0))[known] / mean[known]).mean()) if known.any() else None


_GAMES = "docs/results/physical.md"
_FREEZE = f"a frozen body has none, slow motion less, {_GAMES}"
_AGREEMENT, _CONSISTENT = "height_speed_agreement", f"a frozen body has 1, {_GAMES}"
_NOISE = f"white noise of 0.3 mm brings upsampled motion nearer to real motion's, {_GAMES}"

METRICS = (
    Metric("slide_speed", "Skating speed", "m/s", None, "motionkit", slide_speed, calibration=_FREEZE),
    Metric("slide_share", "Skating share", "", None, "motionkit", slide_share, calibration=_FREEZE),
    Metric("contact_share", "Time on the ground", "", None, "motionkit", contact_share),
    Metric(_AGREEMENT, "Contact consistency", "", None, "motionkit", height_speed_agreement, calibration=_CONSISTENT),
    Metric("ground_height", "Floor", "mm", None, "motionkit", ground_height),
    Metric("jerk", "Jerk below 10 Hz", "m/s³", None, "motionkit", jerk),
    Metric("jitter", "Jitter of 10 to 20 Hz", "mm", None, "motionkit", jitter, calibration=_NOISE),
    Metric("bone_length_drift", "Bone-length drift", "", None, "motionkit", bone_length_drift),
)
