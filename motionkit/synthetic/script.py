"""What a performer is told: curves on named channels, and steps. Parts add up, so actions can follow and overlap."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64

from motionkit.synthetic.curves import Curve

TRAVEL_CHANNELS = ("forward_speed", "left_speed", "turn_rate")
PELVIS_CHANNELS = (
    "pelvis_drop",
    "pelvis_left",
    "pelvis_forward",
    "pelvis_pitch",
    "pelvis_roll",
    "pelvis_yaw",
)
TRUNK_CHANNELS = ("spine_pitch", "spine_roll", "spine_yaw", "head_pitch", "head_roll", "head_yaw")
LIMB_CHANNELS = (
    "arm_elevation",
    "arm_azimuth",
    "arm_twist",
    "elbow",
    "shrug",
    "foot_lift",
    "foot_forward",
    "foot_out",
    "foot_pitch",
    "knee_out",
)
SIDES = ("left", "right")
CHANNELS = (
    *TRAVEL_CHANNELS,
    *PELVIS_CHANNELS,
    *TRUNK_CHANNELS,
    *(f"{side}_{channel}" for side in SIDES for channel in LIMB_CHANNELS),
)


@dataclass(frozen=True)
class Layer:
    """One curve added to one channel: m, m/s, rad or rad/s. Raises `ValueError` for a channel that doesn't exist."""

    channel: str
    curve: Curve

    def __post_init__(self) -> None:
        if self.channel not in CHANNELS:
            raise ValueError(f"no channel is called {self.channel!r}; there are {', '.join(CHANNELS)}")


@dataclass(frozen=True)
class Swing:
    """One foot leaves the floor at `liftoff` and is planted again at `touchdown` (seconds).

    It lands where the trajectory is in the middle of the stance that follows, `out` metres to its own side (None: the
    body's standing width) and `forward` metres ahead; `lift` is how high the ankle is raised, `heel_rise` and `toe_up`
    the foot's pitch in radians at liftoff and at touchdown. The heel begins to rise `heel_lead` swing durations before
    liftoff.
    """

    side: str
    liftoff: float
    touchdown: float
    lift: float = 0.08
    heel_rise: float = 0.5
    toe_up: float = 0.2
    heel_lead: float = 0.7
    out: float | None = None
    forward: float = 0.0


@dataclass(frozen=True)
class Part:
    """An action between two instants: layers, swings, the words for it, and its label."""

    action: str
    start: float
    end: float
    layers: tuple[Layer, ...]
    swings: tuple[Swing, ...] = ()
    phrases: tuple[str, ...] = field(default=())


def evaluate(
    layers: tuple[Layer, ...], times: Float64[np.ndarray, " times"]
) -> dict[str, Float64[np.ndarray, " times"]]:
    """All channels at some times: the sums of their layers."""
    values = {channel: np.zeros(times.shape) for channel in CHANNELS}
    for layer in layers:
        values[layer.channel] = values[layer.channel] + layer.curve(times)
    return values
