"""Actions that leave the floor: jumps and jumping jacks, with ballistic flight."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import BPoly

from motionkit.synthetic.bodies import Body
from motionkit.synthetic.curves import pulse, scaled, shock
from motionkit.synthetic.locomotion import GRAVITY
from motionkit.synthetic.script import SIDES, Layer, Part, Swing


@dataclass(frozen=True, eq=False)
class Spring:
    """A piecewise polynomial between its first and last knot, 0 outside them."""

    spline: BPoly

    def __call__(self, t: Float64[np.ndarray, " times"]) -> Float64[np.ndarray, " times"]:
        """The height at times in seconds."""
        first, last = self.spline.x[0], self.spline.x[-1]
        return np.asarray(np.where((t > first) & (t < last), self.spline(np.clip(t, first, last)), 0.0))


def _spring(start: float, crouch: float, rise: float, dip: float) -> tuple[Spring, float, float, float]:
    """Height of the pelvis (m over standing) through crouch, flight and landing; liftoff, touchdown and end in s.

    A C² piecewise quintic whose flight is exactly a parabola: speed and −g are prescribed at both of its ends.
    """
    speed = float(np.sqrt(2.0 * GRAVITY * rise))
    flight = 2.0 * speed / GRAVITY
    down, push, absorb, recover = 0.45, 0.28, 0.22, 0.55
    toes = 0.04
    knots = start + np.cumsum([0.0, down, push, flight, absorb, recover])
    states = [
        [0.0, 0.0, 0.0],
        [-crouch, 0.0, 8.0],
        [toes, speed, -GRAVITY],
        [toes, -speed, -GRAVITY],
        [-dip, 0.0, 8.0],
        [0.0, 0.0, 0.0],
    ]
    spring = Spring(BPoly.from_derivatives(knots, states))
    return spring, float(knots[2]), float(knots[3]), float(knots[-1])


def _leap(
    body: Body, start: float, rise: float, distance: float, arms: float, spread: float | None = None
) -> tuple[list[Layer], list[Swing], float]:
    scale = body.leg_length / 0.805
    crouch, dip = min(0.12 + 0.5 * rise, 0.32) * scale, min(0.08 + 0.4 * rise, 0.25) * scale
    height, off, on, end = _spring(start, crouch, rise, dip)
    flight = on - off
    bent = pulse(start, 0.45, 0.0, 0.28)
    landed = pulse(on - 0.05, 0.22, 0.05, 0.55)
    layers = [
        Layer("pelvis_drop", scaled(-1.0, height)),
        Layer("forward_speed", pulse(off - 0.2, 0.2, flight - 0.1, 0.3, distance / (flight + 0.15))),
        Layer("pelvis_pitch", scaled(1.3 * crouch, bent)),
        Layer("spine_pitch", scaled(1.6 * crouch, bent)),
        Layer("pelvis_forward", scaled(-0.35 * crouch, bent)),
        Layer("pelvis_pitch", scaled(1.2 * dip, landed)),
        Layer("spine_pitch", scaled(1.2 * dip, landed)),
        Layer("pelvis_forward", scaled(-0.3 * dip, landed)),
        Layer("spine_pitch", shock(on, 0.03)),
        *(Layer(f"{side}_arm_elevation", scaled(-0.8, bent)) for side in SIDES),
        *(Layer(f"{side}_arm_azimuth", scaled(-0.8, pulse(start, 0.3, end - start - 0.6, 0.3))) for side in SIDES),
        *(Layer(f"{side}_arm_elevation", pulse(off - 0.30, 0.45, 0.4 * flight, 0.6, arms)) for side in SIDES),
        *(Layer(f"{side}_elbow", pulse(off - 0.2, 0.3, 0.5 * flight, 0.6, 0.5)) for side in SIDES),
    ]
    swings = [Swing(side, off, on, 0.85 * rise + 0.04, 0.75, 0.0, out=spread) for side in SIDES]
    return layers, swings, end


def _jump(action: str) -> Callable[[np.random.Generator, Body, float, float], Part]:
    forward = action == "jump_forward"

    def build(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
        layers: list[Layer] = []
        swings: list[Swing] = []
        now, count = start, 0
        rise = float(rng.uniform(0.12, 0.36))
        distance = float(rng.uniform(0.4, 1.0)) if forward else 0.0
        while count == 0 or now + 2.2 < end:
            arms = float(rng.uniform(0.6, 1.5))
            more, own, now = _leap(body, now, rise * float(rng.uniform(0.85, 1.1)), distance, arms)
            layers, swings, count = layers + more, swings + own, count + 1
            now += float(rng.uniform(0.1, 0.5))
        times = "once" if count == 1 else "twice" if count == 2 else f"{count} times"
        where = "forward" if forward else "in place"
        phrases = (f"jumps {where} {times}", f"jumps {where}", "leaps forward" if forward else "jumps up and down")
        return Part(action, start, now, tuple(layers), tuple(swings), phrases)

    return build


jump, jump_forward = _jump("jump"), _jump("jump_forward")


def jumping_jacks(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
    """Jumping jacks: feet apart with the arms up, feet together with the arms down."""
    beat = float(rng.uniform(0.55, 0.75))
    pairs = max(1, int((end - start) / (2.0 * beat)))
    wide = float(rng.uniform(0.26, 0.36))
    flight = 0.5 * beat
    rise = GRAVITY * flight**2 / 8.0 * 0.6
    layers: list[Layer] = []
    swings: list[Swing] = []
    for k in range(2 * pairs):
        off = start + k * beat + 0.3 * beat
        opening = k % 2 == 0
        swings += [Swing(side, off, off + flight, rise, 0.6, 0.0, out=wide if opening else None) for side in SIDES]
        layers.append(Layer("pelvis_drop", pulse(off - 0.25 * beat, 0.2 * beat, 0.0, 0.2 * beat, 0.05)))
        layers.append(Layer("pelvis_drop", pulse(off, 0.5 * flight, 0.0, 0.5 * flight, -rise)))
        layers.append(Layer("pelvis_drop", pulse(off + 0.8 * flight, 0.2 * beat, 0.0, 0.3 * beat, 0.06)))
        layers.append(Layer("spine_pitch", shock(off + flight, 0.015)))
        if opening:
            up = pulse(off - 0.1 * beat, 0.65 * beat, 0.35 * beat, 0.65 * beat)
            layers += [Layer(f"{side}_arm_elevation", scaled(2.6, up)) for side in SIDES]
            layers += [Layer(f"{side}_arm_azimuth", scaled(0.5, up)) for side in SIDES]
    phrases = ("does jumping jacks", f"does {pairs} jumping jacks" if pairs > 1 else "does a jumping jack", "exercises")
    return Part("jumping_jacks", start, start + 2 * pairs * beat, tuple(layers), tuple(swings), phrases)
