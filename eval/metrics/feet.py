"""Foot skating as in computer animation, horizontal foot speed weighted by closeness to the floor; contact labels.

Both take one sequence, y up, metres; velocities are per second, from each frame to the next.
"""

import numpy as np

from eval.metrics.checks import checked_features, checked_fps
from eval.metrics.metric import Metric, by_steps
from motionkit.core.shapes import Float, Float64

ANKLE_HEIGHT = 0.08
TOE_HEIGHT = 0.04


def skating_speed(
    feet: Float[np.ndarray, "frames feet 3"],
    fps: float,
    heights: tuple[float, ...] = (ANKLE_HEIGHT, TOE_HEIGHT, ANKLE_HEIGHT, TOE_HEIGHT),
    *,
    floor: float = 0.0,
) -> float:
    """Mean of v·(2 − 2^clamp(h/H, 0, 1)) over frames and foot joints, m/s: lower feet have more weight.

    `heights` are H of each foot joint, 8 cm for ankles and 4 cm for toes; v is horizontal speed from a frame to the
    next, h the height at the first of the two. Source: Zhang et al. 2018 (MANN), as in NeMF (He et al. 2022).
    """
    values, speed = _feet_and_speed(feet, fps)
    if len(heights) != values.shape[1] or min(heights) <= 0:
        raise ValueError(f"there are {values.shape[1]} foot joints and heights {heights}: one positive height for each")
    height = (values[:-1, :, 1] - floor) / np.asarray(heights)
    return float((speed * (2.0 - np.exp2(np.clip(height, 0.0, 1.0)))).mean())


SKATING_SPEED_METRIC = Metric(
    "skating_speed", "Foot skating", "m/s", False, "Zhang et al. 2018; NeMF", "one set", skating_speed, by_steps
)


def _feet_and_speed(
    feet: Float[np.ndarray, "frames feet 3"], fps: float
) -> tuple[Float64[np.ndarray, "frames feet 3"], Float64[np.ndarray, "steps feet"]]:
    if feet.shape[1] == 0:
        raise ValueError("there are no foot joints to measure")
    values = checked_features(feet.reshape(len(feet), -1), "feet", minimum=2).reshape(feet.shape)
    steps = np.diff(values[..., ::2], axis=0)
    return values, np.hypot(steps[..., 0], steps[..., 1]) * checked_fps(fps)


CONTACT_SPEED = 0.894


def contact_consistency(
    contacts: Float[np.ndarray, "labels labelled_feet"],
    feet: Float[np.ndarray, "frames feet 3"],
    fps: float,
    contact_speed: float = CONTACT_SPEED,
) -> float:
    """Fraction of labels (frames × foot joints) that agree with the speed of the foot at that frame.

    A label above ½ says contact; a foot is in contact when it moves slower than `contact_speed` (m/s, all three axes;
    0.894 is HumanML3D's threshold at 20 fps) to the next frame. The last frame is ignored. Defined here: there is no
    published definition.
    """
    if feet.shape[:2] != contacts.shape or not contacts.shape[1]:
        raise ValueError(f"contacts are {contacts.shape}, feet are {feet.shape}: the same frames and foot joints")
    labels = checked_features(contacts, "contacts", minimum=2) > 0.5
    values = checked_features(feet.reshape(len(feet), -1), "feet", minimum=2).reshape(feet.shape)
    speed = np.linalg.norm(np.diff(values, axis=0), axis=-1) * checked_fps(fps)
    return float((labels[:-1] == (speed < contact_speed)).mean())


CONTACT_CONSISTENCY = Metric(
    "contact_consistency", "Contact consistency", "", True, "motionkit", "one set", contact_consistency, by_steps
)
