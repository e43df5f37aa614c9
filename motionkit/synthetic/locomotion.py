"""Locomotion: walking in all directions, jogging, running, marching and turning on the spot."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from motionkit.synthetic.bodies import Body
from motionkit.synthetic.curves import Curve, constant, cosine, product, pulse, scaled, shock, total, wave
from motionkit.synthetic.script import SIDES, Layer, Part, Swing

GRAVITY = 9.81


@dataclass(frozen=True)
class Gait:
    """Parameters of a gait: m, m/s, strides per second, radians; `duty` is the stance fraction of a stride."""

    forward_speed: float
    cadence: float
    duty: float
    left_speed: float = 0.0
    lift: float = 0.06
    heel_rise: float = 0.55
    toe_up: float = 0.25
    bob: float = 0.018
    sway: float = 0.025
    pelvis_yaw: float = 0.09
    arm_swing: float = 0.40
    elbow: float = 0.15
    lean: float = 0.04
    shock: float = 0.006
    out: float | None = None


def travel(
    rng: np.random.Generator, gait: Gait, start: float, end: float
) -> tuple[tuple[Layer, ...], tuple[Swing, ...], Curve]:
    """Layers and swings of locomotion from standing at `start` to standing at `end`, and the envelope of its speed."""
    stride = 1.0 / gait.cadence
    first = SIDES[int(rng.integers(2))]
    swings = _alternating(rng, gait, first, start, end)
    rise = min(0.9 * stride, (end - start) / 3.0)
    moving = pulse(start + 0.1 * stride, rise, end - start - 2.0 * rise, rise)
    lead = 0.0 if first == "left" else 0.5
    left_middle = start + (1.0 - gait.duty / 2.0 + lead) * stride
    sign = -1.0 if gait.forward_speed < 0.0 else 1.0
    # In walking the body is highest over the stance leg; with a flight phase (duty < 1/2) it is lowest there.
    rising = -1.0 if gait.duty > 0.5 else 1.0
    fore_aft = scaled(sign, product(moving, wave(gait.cadence, left_middle)))
    over_left = product(moving, cosine(gait.cadence, left_middle))
    layers = [
        Layer("forward_speed", scaled(gait.forward_speed, moving)),
        Layer("left_speed", scaled(gait.left_speed, moving)),
        Layer("pelvis_drop", product(moving, cosine(2.0 * gait.cadence, left_middle, rising * gait.bob))),
        Layer("pelvis_drop", scaled(0.028, moving)),
        Layer("pelvis_left", scaled(gait.sway, over_left)),
        Layer("pelvis_roll", scaled(0.05 * gait.duty, over_left)),
        Layer("pelvis_yaw", scaled(gait.pelvis_yaw, fore_aft)),
        Layer("spine_yaw", scaled(-2.2 * gait.pelvis_yaw, fore_aft)),
        Layer("head_yaw", scaled(1.1 * gait.pelvis_yaw, fore_aft)),
        Layer("pelvis_pitch", scaled(gait.lean, moving)),
        Layer("spine_pitch", scaled(0.6 * gait.lean, moving)),
        Layer("head_pitch", scaled(-1.2 * gait.lean, moving)),
    ]
    for side, swung in (("left", fore_aft), ("right", scaled(-1.0, fore_aft))):
        layers += [
            Layer(f"{side}_arm_elevation", scaled(gait.arm_swing, swung)),
            Layer(f"{side}_arm_azimuth", scaled(-0.55, moving)),
            Layer(f"{side}_elbow", scaled(gait.elbow, moving)),
            Layer(f"{side}_elbow", scaled(0.45 * gait.arm_swing, product(moving, total(constant(0.6), swung)))),
        ]
    for swing in swings:
        layers.append(Layer("spine_pitch", product(moving, shock(swing.touchdown, gait.shock))))
        layers.append(Layer(f"{swing.side}_elbow", product(moving, shock(swing.touchdown, 2.0 * gait.shock, 23.0))))
    return tuple(layers), swings, moving


def _alternating(rng: np.random.Generator, gait: Gait, first: str, start: float, end: float) -> tuple[Swing, ...]:
    stride = 1.0 / gait.cadence
    count = max(2, int(np.ceil((end - start) / (stride / 2.0) - 0.3)))
    sides = (first, "right" if first == "left" else "left")
    uneven = rng.uniform(0.92, 1.08, count)
    return tuple(
        Swing(
            side=sides[k % 2],
            liftoff=start + k * stride / 2.0,
            touchdown=start + k * stride / 2.0 + (1.0 - gait.duty) * stride,
            lift=gait.lift * float(uneven[k]),
            heel_rise=gait.heel_rise * float(uneven[k]),
            toe_up=gait.toe_up * float(uneven[k]),
            # In running the heel must not rise before the foot has landed.
            heel_lead=min(0.7, 0.7 * gait.duty / (1.0 - gait.duty)),
            out=gait.out,
        )
        for k in range(count)
    )


def pace(body: Body, speed: float, dimension: float = 1.0) -> float:
    """Strides per second at which a body walks at a speed: cadence grows with √speed (Grieve and Gear 1966)."""
    return float(0.90 * dimension * np.sqrt(max(speed, 0.3) / 1.3) * np.sqrt(0.805 / body.leg_length))


def _moderately(speed: float, slow: float, fast: float) -> str:
    return " slowly" if speed < slow else " quickly" if speed > fast else ""


def walk(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
    """Walk straight on."""
    speed = float(rng.uniform(0.6, 1.6)) * np.sqrt(body.leg_length / 0.805)
    layers, swings, moving = travel(rng, _walking(rng, body, speed), start, end)
    wander = Layer("turn_rate", product(moving, wave(float(rng.uniform(0.08, 0.15)), float(rng.uniform(0, 9)), 0.06)))
    manner = _moderately(speed, 0.9, 1.4)
    phrases = (f"walks{manner} forward", f"walks{manner} straight ahead", f"strolls{manner} in a straight line")
    return Part("walk", start, end, (*layers, wander), swings, phrases)


def _walking(rng: np.random.Generator, body: Body, speed: float, **changes: float) -> Gait:
    settings: dict[str, float] = {
        "lift": 0.035 + 0.02 * speed,
        "heel_rise": float(rng.uniform(0.40, 0.60)),
        "toe_up": float(rng.uniform(0.15, 0.30)),
        "bob": float(rng.uniform(0.010, 0.020)),
        "sway": float(rng.uniform(0.018, 0.035)),
        "pelvis_yaw": float(rng.uniform(0.05, 0.11)),
        "arm_swing": float(rng.uniform(0.15, 0.45)) * (0.4 + 0.5 * speed),
        "elbow": float(rng.uniform(0.05, 0.40)),
        "lean": float(rng.uniform(0.0, 0.07)),
        **changes,
    }
    return Gait(speed, pace(body, speed, float(rng.uniform(0.93, 1.07))), float(rng.uniform(0.59, 0.64)), **settings)


def _bending_walk(
    rng: np.random.Generator, body: Body, start: float, end: float, turning: Callable[[Curve], Curve], lean_in: float
) -> tuple[tuple[Layer, ...], tuple[Swing, ...]]:
    speed = float(rng.uniform(0.7, 1.3)) * float(np.sqrt(body.leg_length / 0.805))
    layers, swings, moving = travel(rng, _walking(rng, body, speed), start, end)
    turn = turning(moving)
    inward = Layer("pelvis_roll", scaled(-0.06 * lean_in, turn))
    return (*layers, Layer("turn_rate", turn), Layer("head_yaw", scaled(0.25, turn)), inward), swings


def walk_circle(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
    """Walk round a circle, left or right."""
    sign = 1.0 if rng.random() < 0.5 else -1.0
    direction = "counterclockwise" if sign > 0 else "clockwise"
    laps = float(rng.uniform(0.6, 1.1))
    rate = sign * min(laps * 2.0 * np.pi / (end - start), 1.3)
    layers, swings = _bending_walk(rng, body, start, end, lambda moving: scaled(rate, moving), 1.0)
    phrases = (f"walks in a {direction} circle", f"walks around in a circle {direction}", "walks in a circle")
    return Part("walk_circle", start, end, layers, swings, phrases)


def _walk_and_turn(side: str) -> Callable[[np.random.Generator, Body, float, float], Part]:
    sign = 1.0 if side == "left" else -1.0

    def build(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
        length = float(rng.uniform(1.2, 1.8))
        begin = float(rng.uniform(start + 0.25 * (end - start), max(start + 0.3 * (end - start), end - length - 0.8)))
        angle = sign * float(rng.uniform(0.9, 1.9))
        turn = pulse(begin, 0.4 * length, 0.2 * length, 0.4 * length, angle / (0.6 * length))
        layers, swings = _bending_walk(rng, body, start, end, lambda _: turn, 1.0)
        phrases = (f"walks forward and turns {side}", f"walks and makes a turn to the {side}", f"walks, turning {side}")
        return Part(f"turn_{side}", start, end, layers, swings, phrases)

    return build


turn_left, turn_right = _walk_and_turn("left"), _walk_and_turn("right")


def walk_backwards(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
    """Walk backwards."""
    speed = float(rng.uniform(0.5, 0.95))
    gait = _walking(rng, body, -speed, heel_rise=0.35, toe_up=0.05, lift=0.06, lean=0.08, arm_swing=0.15)
    gait = Gait(**{**gait.__dict__, "cadence": pace(body, speed, 1.1)})
    layers, swings, _ = travel(rng, gait, start, end)
    phrases = ("walks backwards", "steps backward", "walks in reverse")
    return Part("walk_backwards", start, end, layers, swings, phrases)


def sidestep(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
    """Step sideways, left or right."""
    side = SIDES[int(rng.integers(2))]
    speed = float(rng.uniform(0.3, 0.55)) * (1.0 if side == "left" else -1.0)
    gait = Gait(
        0.0,
        float(rng.uniform(0.75, 0.95)),
        0.62,
        left_speed=speed,
        lift=0.07,
        heel_rise=0.15,
        toe_up=0.0,
        bob=0.012,
        sway=0.02,
        pelvis_yaw=0.0,
        arm_swing=0.05,
        elbow=0.3,
        out=0.17,
    )
    layers, swings, _ = travel(rng, gait, start, end)
    phrases = (f"sidesteps to the {side}", f"steps sideways to the {side}", f"shuffles {side}")
    return Part("sidestep", start, end, layers, swings, phrases)


def _running(rng: np.random.Generator, body: Body, speed: float, duty: float) -> Gait:
    cadence = float(rng.uniform(1.28, 1.42)) + 0.05 * (speed - 2.5)
    flight = (0.5 - duty) / cadence
    return Gait(
        speed,
        cadence,
        duty,
        lift=0.10 + 0.05 * speed,
        heel_rise=float(rng.uniform(0.9, 1.1)),
        toe_up=0.10,
        bob=min(0.035, GRAVITY * flight**2 / 8.0 + 0.02),
        sway=0.010,
        pelvis_yaw=float(rng.uniform(0.08, 0.14)),
        arm_swing=float(rng.uniform(0.45, 0.65)),
        elbow=float(rng.uniform(1.1, 1.5)),
        lean=float(rng.uniform(0.08, 0.16)),
        shock=0.012,
        out=0.045,
    )


def jog(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
    """Jog forward."""
    layers, swings, _ = travel(rng, _running(rng, body, float(rng.uniform(1.7, 2.3)), 0.40), start, end)
    phrases = ("jogs forward", "jogs at an easy pace", "trots forward")
    return Part("jog", start, end, layers, swings, phrases)


def run(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
    """Run forward."""
    layers, swings, _ = travel(rng, _running(rng, body, float(rng.uniform(2.6, 3.4)), 0.31), start, end)
    phrases = ("runs forward", "runs fast in a straight line", "sprints ahead")
    return Part("run", start, end, layers, swings, phrases)


def march(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
    """March on the spot with high knees."""
    gait = Gait(
        0.0,
        float(rng.uniform(0.8, 1.1)),
        0.55,
        lift=float(rng.uniform(0.18, 0.34)),
        heel_rise=0.35,
        toe_up=0.0,
        bob=0.008,
        sway=0.035,
        pelvis_yaw=0.04,
        arm_swing=float(rng.uniform(0.3, 0.7)),
        elbow=float(rng.uniform(0.3, 1.0)),
        lean=0.0,
    )
    layers, swings, _ = travel(rng, gait, start, end)
    phrases = ("marches in place", "marches on the spot lifting the knees", "steps in place")
    return Part("march", start, end, layers, swings, phrases)


def turn_in_place(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
    """Turn around on the spot, left or right, by a quarter to a whole turn."""
    side = SIDES[int(rng.integers(2))]
    sign = 1.0 if side == "left" else -1.0
    gait = Gait(
        0.0, float(rng.uniform(0.75, 0.95)), 0.64, lift=0.05, heel_rise=0.2, toe_up=0.0, bob=0.006,
        sway=0.03, pelvis_yaw=0.0, arm_swing=0.08, elbow=0.1, lean=0.0, out=0.12,
    )  # fmt: skip
    angle = float(min(rng.uniform(0.5, 2.0) * np.pi, 1.5 * (end - start)))
    layers, swings, _ = travel(rng, gait, start, end)
    turn = pulse(start + 0.1, 0.4, end - start - 1.2, 0.4, sign * angle / (end - start - 0.8))
    amount = "all the way around" if angle > 1.6 * np.pi else "around" if angle > 0.75 * np.pi else "a little"
    phrases = (f"turns {amount} to the {side} on the spot", f"turns {amount} in place", f"rotates to the {side}")
    layers = (*layers, Layer("turn_rate", turn), Layer("head_yaw", scaled(0.3, turn)))
    return Part("turn_in_place", start, end, layers, swings, phrases)
