"""A synthetic motion: a script performed by a body, exact at every instant."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64

from motionkit.core.motion import Caption
from motionkit.core.skeleton import Skeleton
from motionkit.fields.motion_field import Poses, check_times
from motionkit.synthetic.bodies import Body
from motionkit.synthetic.feet import FootPath, foot_path
from motionkit.synthetic.rig import pose
from motionkit.synthetic.script import SIDES, Layer, Swing, Trajectory, evaluate, integrate

RUN_IN_SECONDS = 3.0


@dataclass(frozen=True, eq=False)
class SyntheticMotion:
    """A `MotionField` on [0, end_seconds] with exact ground truth: any framerate samples the same functions of time.

    The floor is y = 0; the pelvis starts over the origin with `heading` radians about +Y (0 faces +Z).
    """

    body: Body
    end_seconds: float
    layers: tuple[Layer, ...]
    swings: tuple[Swing, ...]
    heading: float = 0.0
    action: str = ""
    captions: tuple[Caption, ...] = ()

    @property
    def skeleton(self) -> Skeleton:
        """The body's skeleton."""
        return self.body.skeleton

    @property
    def start_seconds(self) -> float:
        """0."""
        return 0.0

    @cached_property
    def trajectory(self) -> Trajectory:
        """The path on the floor, some seconds longer than the motion at both ends for steps that cross them."""
        return integrate(self.layers, -RUN_IN_SECONDS, self.end_seconds + RUN_IN_SECONDS, self.heading)

    def query(self, times_seconds: Float64[np.ndarray, "times"]) -> Poses:
        """Poses at any times in [0, end_seconds]; raises `ValueError` outside."""
        check_times(self, times_seconds)
        feet = {side: self._foot(side, times_seconds) for side in SIDES}
        return pose(self.body, self.trajectory, feet, evaluate(self.layers, times_seconds), times_seconds)

    def contacts(self, times_seconds: Float64[np.ndarray, "times"]) -> Bool[np.ndarray, "times 4"]:
        """Whether left ankle, left toe, right ankle, right toe stand still on the floor by construction."""
        check_times(self, times_seconds)
        planted = [self._foot(side, times_seconds) for side in SIDES]
        return np.stack([contact for foot in planted for contact in (foot.ankle_planted, foot.toe_planted)], axis=-1)

    def _foot(self, side: str, times: Float64[np.ndarray, "times"]) -> FootPath:
        return foot_path(side, self.swings, self.trajectory, self.body, times)
