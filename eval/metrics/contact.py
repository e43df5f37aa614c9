"""Contact consistency: whether a motion's own contact labels say what its feet do."""

import numpy as np
from jaxtyping import Float

from eval.metrics.checks import checked_features, checked_fps

CONTACT_SPEED = 0.894


def contact_consistency(
    contacts: Float[np.ndarray, "labels labelled_feet"],
    feet: Float[np.ndarray, "frames feet 3"],
    fps: float,
    contact_speed: float = CONTACT_SPEED,
) -> float:
    """Share of labels (frames × foot joints) that agree with the speed of the foot at that frame.

    A label above ½ says contact; a foot is in contact when it moves slower than `contact_speed` (m/s, all three axes;
    0.894 is what HumanML3D's threshold means at 20 fps) to the next frame. The last frame has no next one and doesn't
    count. Defined here: nobody publishes it under a fixed definition.
    """
    if feet.shape[:2] != contacts.shape or not contacts.shape[1]:
        raise ValueError(f"contacts are {contacts.shape}, feet are {feet.shape}: the same frames and foot joints")
    labels = checked_features(contacts, "contacts", minimum=2) > 0.5
    values = checked_features(feet.reshape(len(feet), -1), "feet", minimum=2).reshape(feet.shape)
    speed = np.linalg.norm(np.diff(values, axis=0), axis=-1) * checked_fps(fps)
    return float((labels[:-1] == (speed < contact_speed)).mean())
