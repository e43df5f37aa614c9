"""Actions on the spot with both feet planted, or one lifted: gestures, exercises, fighting, sitting."""

from collections.abc import Callable

import numpy as np

from motionkit.synthetic.bodies import Body
from motionkit.synthetic.curves import constant, cosine, product, pulse, scaled, total, wave
from motionkit.synthetic.script import SIDES, Layer, Part, Swing


def stand(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
    """Stand idle, shifting the weight."""
    shift = wave(float(rng.uniform(0.12, 0.25)), float(rng.uniform(0, 8)), float(rng.uniform(0.01, 0.035)))
    layers = (
        Layer("pelvis_left", shift),
        Layer("pelvis_roll", scaled(1.2, shift)),
        Layer("spine_roll", scaled(-1.6, shift)),
        Layer("head_yaw", wave(float(rng.uniform(0.08, 0.2)), float(rng.uniform(0, 8)), float(rng.uniform(0.1, 0.4)))),
    )
    return Part("stand", start, end, layers, (), ("stands still", "stands idle", "waits, standing on the spot"))


def _wave(sides: tuple[str, ...]) -> Callable[[np.random.Generator, Body, float, float], Part]:
    words = "both hands" if len(sides) == 2 else f"the {sides[0]} hand"

    def build(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
        rise = float(rng.uniform(0.5, 0.8))
        up = pulse(start, rise, end - start - 2 * rise, rise)
        frequency = float(rng.uniform(1.3, 2.6))
        swing = float(rng.uniform(0.25, 0.55))
        raised, bent = float(rng.uniform(1.1, 1.9)), float(rng.uniform(0.9, 1.6))
        layers = [Layer("head_pitch", scaled(-0.06, up))]
        for side in sides:
            lean = 0.05 if side == "left" else -0.05
            layers += [
                Layer(f"{side}_arm_elevation", scaled(raised, up)),
                Layer(f"{side}_arm_azimuth", scaled(0.35, up)),
                Layer(f"{side}_arm_twist", scaled(1.45, up)),
                Layer(f"{side}_elbow", scaled(bent, up)),
                Layer(f"{side}_elbow", product(up, wave(frequency, start, swing))),
                Layer(f"{side}_arm_twist", product(up, wave(frequency, start + 0.05, 0.3 * swing))),
                Layer("spine_roll", scaled(lean, up)),
            ]
        phrases = (f"waves {words}", f"waves hello with {words}", f"raises {words} and waves")
        name = "wave_both" if len(sides) == 2 else f"wave_{sides[0]}"
        return Part(name, start, end, tuple(layers), (), phrases)

    return build


wave_left, wave_right, wave_both = _wave(("left",)), _wave(("right",)), _wave(("left", "right"))


def bow(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
    """Bow once."""
    seconds = min(end - start, float(rng.uniform(2.0, 3.2)))
    depth = float(rng.uniform(0.5, 1.1))
    down = pulse(start, 0.4 * seconds, 0.2 * seconds, 0.4 * seconds)
    layers = (
        Layer("pelvis_pitch", scaled(0.55 * depth, down)),
        Layer("spine_pitch", scaled(0.65 * depth, down)),
        Layer("head_pitch", scaled(0.25 * depth, down)),
        Layer("pelvis_forward", scaled(-0.13 * depth, down)),
        *(Layer(f"{side}_arm_elevation", scaled(0.75 * depth, down)) for side in SIDES),
        *(Layer(f"{side}_arm_azimuth", scaled(-0.8, down)) for side in SIDES),
    )
    manner = "deeply" if depth > 0.85 else "politely"
    return Part("bow", start, start + seconds, layers, (), (f"bows {manner}", "bows", "takes a bow and straightens up"))


def squat(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
    """Squat one or several times."""
    count = max(1, int((end - start) / float(rng.uniform(1.7, 2.6))))
    period = (end - start) / count
    depth = float(rng.uniform(0.28, 0.46)) * body.leg_length / 0.805
    layers: list[Layer] = []
    for k in range(count):
        down = pulse(start + k * period, 0.42 * period, 0.10 * period, 0.42 * period)
        layers += [
            Layer("pelvis_drop", scaled(depth, down)),
            Layer("pelvis_forward", scaled(-0.32 * depth, down)),
            Layer("pelvis_pitch", scaled(0.9 * depth, down)),
            Layer("spine_pitch", scaled(0.8 * depth, down)),
            Layer("head_pitch", scaled(-0.9 * depth, down)),
            *(Layer(f"{side}_arm_elevation", scaled(1.35, down)) for side in SIDES),
            *(Layer(f"{side}_arm_azimuth", scaled(-0.8, down)) for side in SIDES),
            *(Layer(f"{side}_knee_out", scaled(0.25, down)) for side in SIDES),
        ]
    times = "once" if count == 1 else "twice" if count == 2 else f"{count} times"
    return Part("squat", start, end, tuple(layers), (), (f"squats {times}", "does squats", "squats down and stands up"))


def sit(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
    """Sit down on an unseen chair and stand up again."""
    seconds = end - start
    down_for, up_for = 0.30 * seconds, 0.28 * seconds
    scale = body.leg_length / 0.805
    seat = float(rng.uniform(0.36, 0.42)) * scale
    seated = pulse(start + 0.05 * seconds, down_for, 0.30 * seconds, up_for)
    lean_down = pulse(start, 0.5 * down_for, 0.0, 0.8 * down_for)
    rise = start + 0.05 * seconds + down_for + 0.30 * seconds
    lean_up = pulse(rise - 0.4 * up_for, 0.5 * up_for, 0.0, 0.8 * up_for)
    leaning = total(lean_down, lean_up)
    layers = (
        Layer("pelvis_drop", scaled(seat, seated)),
        Layer("pelvis_forward", scaled(-0.42 * scale, seated)),
        Layer("pelvis_pitch", scaled(-0.12, seated)),
        Layer("pelvis_pitch", scaled(0.45, leaning)),
        Layer("spine_pitch", scaled(0.45, leaning)),
        Layer("head_pitch", scaled(-0.35, leaning)),
        *(Layer(f"{side}_arm_elevation", scaled(0.45, seated)) for side in SIDES),
        *(Layer(f"{side}_arm_azimuth", scaled(-0.9, seated)) for side in SIDES),
        *(Layer(f"{side}_elbow", scaled(0.65, seated)) for side in SIDES),
    )
    phrases = ("sits down and stands up again", "sits on a chair, then gets up", "takes a seat and rises")
    return Part("sit", start, end, layers, (), phrases)


def raise_arms(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
    """Raise both arms, in front or to the sides, and lower them."""
    seconds = end - start
    sideways = bool(rng.random() < 0.5)
    height = float(rng.uniform(1.4, 2.75))
    up = pulse(start, 0.35 * seconds, 0.25 * seconds, 0.35 * seconds)
    layers: list[Layer] = [Layer("spine_pitch", scaled(-0.08, up)), Layer("head_pitch", scaled(-0.12, up))]
    for side in SIDES:
        layers += [
            Layer(f"{side}_arm_elevation", scaled(height, up)),
            Layer(f"{side}_arm_azimuth", scaled(0.5 if sideways else -0.8, up)),
            Layer(f"{side}_shrug", scaled(0.12 * height, up)),
        ]
    way = "to the sides" if sideways else "in front of the body"
    phrases = (f"raises both arms {way} and lowers them", "lifts the arms", f"lifts both arms {way}")
    return Part("raise_arms", start, end, tuple(layers), (), phrases)


def clap(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
    """Clap the hands."""
    ready = pulse(start, 0.6, end - start - 1.2, 0.6)
    frequency = float(rng.uniform(1.6, 2.8))
    layers: list[Layer] = []
    for side in SIDES:
        layers += [
            Layer(f"{side}_arm_elevation", scaled(float(rng.uniform(0.65, 0.85)), ready)),
            Layer(f"{side}_arm_azimuth", scaled(-1.05, ready)),
            Layer(f"{side}_elbow", scaled(1.1, ready)),
            Layer(f"{side}_arm_twist", scaled(-0.38, ready)),
            Layer(f"{side}_arm_twist", product(ready, cosine(frequency, start + 0.6, -0.22))),
        ]
    manner = "quickly" if frequency > 2.3 else "slowly" if frequency < 1.9 else "steadily"
    return Part("clap", start, end, tuple(layers), (), (f"claps {manner}", "claps the hands", "applauds"))


def punch(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
    """Punch with alternating or always the same fist out of a guard."""
    guard = pulse(start, 0.6, end - start - 1.2, 0.6)
    layers: list[Layer] = [
        Layer("pelvis_drop", scaled(0.05, guard)),
        Layer("spine_pitch", scaled(0.12, guard)),
        *(Layer(f"{side}_arm_elevation", scaled(0.35, guard)) for side in SIDES),
        *(Layer(f"{side}_arm_azimuth", scaled(-0.9, guard)) for side in SIDES),
        *(Layer(f"{side}_elbow", scaled(1.75, guard)) for side in SIDES),
    ]
    pause = float(rng.uniform(0.75, 1.1))
    count = max(1, int((end - start - 1.2) / pause))
    sides = [SIDES[(k + int(rng.integers(2))) % 2] for k in range(2)] if rng.random() < 0.5 else list(SIDES)
    for k in range(count):
        side = sides[k % 2]
        sign = 1.0 if side == "right" else -1.0
        strike = pulse(start + 0.6 + k * pause, 0.25, 0.05, 0.35)
        layers += [
            Layer(f"{side}_arm_elevation", scaled(1.0, strike)),
            Layer(f"{side}_elbow", scaled(-1.75, strike)),
            Layer("spine_yaw", scaled(0.45 * sign, strike)),
            Layer("pelvis_yaw", scaled(0.18 * sign, strike)),
            Layer("head_yaw", scaled(-0.4 * sign, strike)),
            Layer("pelvis_forward", scaled(0.04, strike)),
        ]
    fist = f"with the {sides[0]} fist" if sides[0] == sides[1] else "with both fists"
    return Part("punch", start, end, tuple(layers), (), (f"punches {fist}", "throws punches", "boxes the air"))


def kick(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
    """Kick forward with one leg, one or several times."""
    side = SIDES[int(rng.integers(2))]
    other = "right" if side == "left" else "left"
    sign = 1.0 if side == "left" else -1.0
    height = float(rng.uniform(0.35, 0.75)) * body.leg_length / 0.805
    reach = 0.95 * float(np.sqrt(body.leg_length**2 - (body.leg_length - height) ** 2))
    period = float(rng.uniform(1.9, 2.4))
    count = max(1, int((end - start) / period))
    layers: list[Layer] = []
    swings: list[Swing] = []
    for k in range(count):
        begin = start + k * period
        off = begin + 0.45
        weight = pulse(begin, 0.45, 0.9, 0.5)
        strike = pulse(off + 0.1, 0.32, 0.04, 0.42)
        swings.append(Swing(side, off, off + 1.0, lift=0.12, heel_rise=0.35, toe_up=0.0))
        layers += [
            Layer("pelvis_left", scaled(-0.075 * sign, weight)),
            Layer("pelvis_drop", scaled(0.02, weight)),
            Layer(f"{side}_foot_forward", scaled(reach, strike)),
            Layer(f"{side}_foot_lift", scaled(height, strike)),
            Layer(f"{side}_foot_pitch", scaled(-0.9 * height, strike)),
            Layer("pelvis_pitch", scaled(-0.25 * height, strike)),
            Layer("spine_pitch", scaled(-0.15, strike)),
            Layer("pelvis_yaw", scaled(-0.2 * sign, strike)),
            Layer(f"{other}_arm_elevation", scaled(0.7, strike)),
            Layer(f"{side}_arm_elevation", scaled(-0.4, strike)),
            *(Layer(f"{arm}_elbow", scaled(0.9, weight)) for arm in SIDES),
        ]
    times = "" if count == 1 else " twice" if count == 2 else f" {count} times"
    phrases = (f"kicks{times} with the {side} leg", f"kicks forward{times}", f"does a {side} front kick{times}")
    return Part("kick", start, start + count * period, tuple(layers), tuple(swings), phrases)


def throw(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
    """Throw something overarm, again and again if there is time."""
    side = SIDES[int(rng.integers(2))]
    sign = 1.0 if side == "right" else -1.0
    period = float(rng.uniform(2.5, 3.2))
    count = max(1, int((end - start) / period))
    layers: list[Layer] = []
    for k in range(count):
        begin = start + k * period + 0.1
        wind_up = pulse(begin, 0.7, 0.25, 0.35)
        release = pulse(begin + 0.95, 0.3, 0.1, 0.9)
        layers += [
            Layer(f"{side}_arm_elevation", scaled(1.5, wind_up)),
            Layer(f"{side}_arm_azimuth", scaled(0.5, wind_up)),
            Layer(f"{side}_arm_twist", scaled(1.6, wind_up)),
            Layer(f"{side}_elbow", scaled(1.4, wind_up)),
            Layer("spine_yaw", scaled(-0.6 * sign, wind_up)),
            Layer(f"{side}_arm_elevation", scaled(1.25, release)),
            Layer(f"{side}_arm_azimuth", scaled(-0.9, release)),
            Layer("spine_yaw", scaled(0.4 * sign, release)),
            Layer("spine_pitch", scaled(0.3, release)),
            Layer("pelvis_forward", scaled(0.06, release)),
        ]
    phrases = (f"throws something with the {side} hand", "throws a ball overarm", f"throws with the {side} arm")
    return Part("throw", start, start + count * period, tuple(layers), (), phrases)


def stretch(rng: np.random.Generator, body: Body, start: float, end: float) -> Part:
    """Bend the trunk from side to side with the arms up."""
    seconds = end - start
    up = pulse(start, 0.25 * seconds, 0.5 * seconds, 0.25 * seconds)
    count = max(1, round(seconds / 3.5))
    bend = product(up, wave(count / (0.7 * seconds), start + 0.15 * seconds, float(rng.uniform(0.35, 0.6))))
    layers: list[Layer] = [Layer("spine_roll", bend), Layer("pelvis_left", scaled(0.10, bend))]
    for side in SIDES:
        layers += [
            Layer(f"{side}_arm_elevation", scaled(2.5, up)),
            Layer(f"{side}_arm_azimuth", scaled(0.4, up)),
            Layer(f"{side}_shrug", scaled(0.3, up)),
            Layer(f"{side}_elbow", product(up, constant(0.3))),
        ]
    phrases = ("stretches to both sides", "bends from side to side with raised arms", "stretches the upper body")
    return Part("stretch", start, end, tuple(layers), (), phrases)
