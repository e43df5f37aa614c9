"""Paths of the feet: exactly planted between swings, along smooth arcs during them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from motionkit.synthetic.bodies import Body
from motionkit.synthetic.curves import glide, smoothstep
from motionkit.synthetic.script import Swing, Trajectory, turned

TOE_OUT = 0.12  # radians
TOE_DOWN_LAG = 0.30  # time from touchdown until the toe is down, as a fraction of the swing's duration


@dataclass(frozen=True, eq=False)
class FootPath:
    """One foot at some instants.

    `base` [T, 3] is the ankle of the flat foot (m, world); `yaw`, `heel_rise`, `toe_up` in radians; `airborne` is 0
    where the foot is planted and reaches 1 in the middle of a swing. While planted, the toe is exactly stationary
    while `toe_up` is 0, and the ankle while `heel_rise` is 0.
    """

    base: Float64[np.ndarray, "times 3"]
    yaw: Float64[np.ndarray, " times"]
    heel_rise: Float64[np.ndarray, " times"]
    toe_up: Float64[np.ndarray, " times"]
    airborne: Float64[np.ndarray, " times"]

    @property
    def ankle_planted(self) -> Bool[np.ndarray, " times"]:
        """Mask of the times at which the ankle is stationary."""
        return np.asarray((self.airborne == 0.0) & (self.heel_rise == 0.0))

    @property
    def toe_planted(self) -> Bool[np.ndarray, " times"]:
        """Mask of the times at which the toe is stationary."""
        return np.asarray((self.airborne == 0.0) & (self.toe_up == 0.0))


def foot_path(
    side: str, swings: tuple[Swing, ...], trajectory: Trajectory, body: Body, times: Float64[np.ndarray, " times"]
) -> FootPath:
    """The path of one foot through its swings; raises `ValueError` if two swings overlap."""
    own = sorted((swing for swing in swings if swing.side == side), key=lambda swing: swing.liftoff)
    liftoff = np.array([swing.liftoff for swing in own])
    touchdown = np.array([swing.touchdown for swing in own])
    if np.any(touchdown[:-1] > liftoff[1:]):
        raise ValueError(f"two swings of the {side} foot overlap")
    prints, yaws = _footprints(side, own, liftoff, touchdown, trajectory, body)
    u = (times[:, None] - liftoff) / (touchdown - liftoff)
    carried = glide(u)
    base = prints[0] + carried @ np.diff(prints, axis=0)
    inside = (u > 0.0) & (u < 1.0)
    arc = np.where(inside, (4.0 * u * (1.0 - u)) ** 2, 0.0)
    # The ankle is highest early in the swing, as in walking: the arc is skewed by (1.6 − 1.2 u).
    base[:, 1] += (arc * (1.6 - 1.2 * u)) @ np.array([swing.lift for swing in own])
    lead = np.array([swing.heel_lead for swing in own])
    rise = smoothstep((u + lead) / lead) * smoothstep((0.55 - u) / 0.55)
    toe_up = smoothstep((u - 0.5) / 0.45) * smoothstep((1.0 + TOE_DOWN_LAG - u) / TOE_DOWN_LAG)
    return FootPath(
        base=base,
        yaw=yaws[0] + carried @ np.diff(yaws),
        heel_rise=rise @ np.array([swing.heel_rise for swing in own]),
        toe_up=toe_up @ np.array([swing.toe_up for swing in own]),
        airborne=np.where(inside, arc, 0.0).sum(axis=1),
    )


def _footprints(
    side: str,
    swings: list[Swing],
    liftoff: Float64[np.ndarray, " swings"],
    touchdown: Float64[np.ndarray, " swings"],
    trajectory: Trajectory,
    body: Body,
) -> tuple[Float64[np.ndarray, "prints 3"], Float64[np.ndarray, " prints"]]:
    """Ankles and yaws of the flat foot before the first swing and after each."""
    sign = 1.0 if side == "left" else -1.0
    following = np.append(liftoff[1:], trajectory.end_seconds)
    middles = np.concatenate(([trajectory.start_seconds], (touchdown + np.maximum(following, touchdown)) / 2.0))
    stance = body.stance_half_width
    aside = np.array([stance, *(stance if swing.out is None else swing.out for swing in swings)]) * sign
    ahead = np.array([0.0, *(swing.forward for swing in swings)])
    heading = trajectory.heading(middles)
    prints = trajectory.position(middles) + turned(np.stack((aside, np.zeros_like(aside), ahead), axis=-1), heading)
    prints[:, 1] = body.ankle_height
    return prints, heading + sign * TOE_OUT
