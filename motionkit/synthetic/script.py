"""The script of a performance: curves on named channels, and steps. Parts are summed, so that actions can overlap."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import CubicSpline, PPoly

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
    """A curve added to a channel: m, m/s, rad or rad/s. Raises `ValueError` for an unknown channel."""

    channel: str
    curve: Curve

    def __post_init__(self) -> None:
        if self.channel not in CHANNELS:
            raise ValueError(f"no channel is called {self.channel!r}; there are {', '.join(CHANNELS)}")


@dataclass(frozen=True)
class Swing:
    """A foot's swing: it leaves the floor at `liftoff` and is planted again at `touchdown` (seconds).

    It lands at the trajectory's position in the middle of the following stance, `out` metres to its own side (None: the
    body's standing width) and `forward` metres ahead; `lift` is the ankle's height in the swing, `heel_rise` and
    `toe_up` the foot's pitch in radians at liftoff and at touchdown. The heel begins to rise `heel_lead` swing
    durations before liftoff.
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
    """An action in an interval of time: layers, swings, its phrases and its label."""

    action: str
    start: float
    end: float
    layers: tuple[Layer, ...]
    swings: tuple[Swing, ...] = ()
    phrases: tuple[str, ...] = field(default=())


def evaluate(
    layers: tuple[Layer, ...], times: Float64[np.ndarray, " times"]
) -> dict[str, Float64[np.ndarray, " times"]]:
    """All channels at the given times: the sums of their layers."""
    values = {channel: np.zeros(times.shape) for channel in CHANNELS}
    for layer in layers:
        values[layer.channel] = values[layer.channel] + layer.curve(times)
    return values


SECONDS_BETWEEN_KNOTS = 1.0 / 60.0


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A path on the floor, as splines with continuous acceleration."""

    start_seconds: float
    end_seconds: float
    place_spline: PPoly
    heading_spline: PPoly

    def position(self, times: Float64[np.ndarray, " times"]) -> Float64[np.ndarray, "times 3"]:
        """Points on the floor (y = 0) in metres."""
        left_forward = self.place_spline(times)
        return np.stack((left_forward[:, 0], np.zeros(times.shape), left_forward[:, 1]), axis=-1)

    def heading(self, times: Float64[np.ndarray, " times"]) -> Float64[np.ndarray, " times"]:
        """Yaw in radians about +Y; 0 faces +Z."""
        return np.asarray(self.heading_spline(times), dtype=np.float64)


def turned(
    vectors: Float64[np.ndarray, "times 3"], yaw: Float64[np.ndarray, " times"]
) -> Float64[np.ndarray, "times 3"]:
    """Vectors rotated about +Y."""
    sine, cosine = np.sin(yaw), np.cos(yaw)
    x, y, z = vectors.T
    return np.stack((cosine * x + sine * z, y, cosine * z - sine * x), axis=-1)


def integrate(layers: tuple[Layer, ...], start_seconds: float, end_seconds: float, heading: float = 0.0) -> Trajectory:
    """Integrate the travel channels' speeds to a path from the origin at time 0, with an initial heading in radians."""
    num_knots = int(np.ceil((end_seconds - start_seconds) / SECONDS_BETWEEN_KNOTS)) + 1
    knots = np.linspace(start_seconds, end_seconds, num_knots)
    speeds = evaluate(layers, knots)
    turning = CubicSpline(knots, speeds["turn_rate"]).antiderivative()
    turning.c[-1] += heading - turning(0.0)
    local = np.stack((speeds["left_speed"], np.zeros(num_knots), speeds["forward_speed"]), axis=-1)
    place = CubicSpline(knots, turned(local, turning(knots))[:, [0, 2]]).antiderivative()
    place.c[-1] -= place(0.0)
    return Trajectory(start_seconds, end_seconds, place, turning)
