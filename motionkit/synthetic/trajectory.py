"""Where the body is on the floor and which way it faces: the integral of its speeds."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import CubicSpline, PPoly

from motionkit.synthetic.script import Layer, evaluate

SECONDS_BETWEEN_KNOTS = 1.0 / 60.0


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A path on the floor: splines with continuous acceleration, so that it is exact at every instant."""

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
    """The path that the travel channels' speeds lead along, from the origin at time 0 with a heading in radians."""
    num_knots = int(np.ceil((end_seconds - start_seconds) / SECONDS_BETWEEN_KNOTS)) + 1
    knots = np.linspace(start_seconds, end_seconds, num_knots)
    speeds = evaluate(layers, knots)
    turning = CubicSpline(knots, speeds["turn_rate"]).antiderivative()
    turning.c[-1] += heading - turning(0.0)
    local = np.stack((speeds["left_speed"], np.zeros(num_knots), speeds["forward_speed"]), axis=-1)
    place = CubicSpline(knots, turned(local, turning(knots))[:, [0, 2]]).antiderivative()
    place.c[-1] -= place(0.0)
    return Trajectory(start_seconds, end_seconds, place, turning)
