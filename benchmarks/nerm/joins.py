"""Joins of long motions: pieces that each begin as the one before ends, and pieces that cross-fade.

    python benchmarks/nerm/joins.py RUN [--seconds 30] [--overlap 0.5] [--motions 20] [--steps 10] [--seed 0] [--json]

Both ways make the same long motions of mixed captions by the trained run. Where two pieces overlap, and elsewhere: how
far apart the pieces are (mean distance of joints), the speed on the floor of feet below 8 cm, jerk of all joints, and
the largest change of a joint's velocity from one frame of 60 fps to the next. Then skating of the whole planted motion
and what a motion costs.
"""

import time
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch

from benchmarks.command import arguments_parser, print_json
from eval.metrics.physical import slide_speed
from motionkit.core.skeleton import SMPL22
from motionkit.fields.assembly import AssembledField, chain
from motionkit.fields.motion_field import to_motion
from motionkit.generate.long_motions import Script, generate_joined, pieces_of
from motionkit.generate.models import GenerationRequest, SamplingOptions
from motionkit.generate.output import plant_generated
from nerm.model import NermModel, load

TEXTS = (
    "a person walks forward",
    "a person walks in a circle",
    "a person runs",
    "a person dances",
    "a person bows",
    "a person walks and turns around",
    "a person jumps",
    "a person waves with the right hand",
    "a person kicks",
    "",
)
FPS, LOW_METRES, INSTANTS = 60, 0.08, 13
FEET = tuple(SMPL22.joint_names.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("ankle", "foot"))


@dataclass(frozen=True)
class Figures:
    """Figures of one motion; pairs are at joins and elsewhere."""

    apart_cm: float
    foot_speed: tuple[float, float]
    jerk: tuple[float, float]
    largest_velocity_change: tuple[float, float]
    skating: float
    seconds: float


def cross_faded(
    model: NermModel, script: Script, *, seed: int, number: int, sampling: SamplingOptions, overlap_seconds: float
) -> AssembledField:
    """A long motion as it was made before, and is of models that follow no poses."""
    pieces = pieces_of(script, model.max_duration_seconds, overlap_seconds)
    own_seed = int(np.random.SeedSequence(seed, spawn_key=(number,)).generate_state(1, np.uint64)[0] >> np.uint64(1))
    return chain(model.generate(pieces, seed=own_seed, sampling=sampling), overlap_seconds)


def figures_of(field: AssembledField, script: Script, seconds: float) -> Figures:
    """Figures of the unplanted motion, except skating."""
    apart = []
    for number, (before, after) in enumerate(zip(field.pieces, field.pieces[1:], strict=False)):
        times = np.linspace(field.fade_start[number], field.fade_end[number], INSTANTS)
        one, other = (each.query(times).joint_positions for each in (before, after))
        apart.append(100.0 * float(np.linalg.norm(one - other, axis=-1).mean()))
    motion = to_motion(field, Fraction(FPS)).joint_positions.astype(np.float64)
    velocity = np.diff(motion, axis=0) * FPS
    third = np.linalg.norm(np.diff(motion, 3, axis=0), axis=-1).mean(axis=1) * FPS**3
    change = np.linalg.norm(np.diff(velocity, axis=0), axis=-1).max(axis=1)
    instants = np.arange(len(motion)) / FPS
    joins = ((instants[:, None] >= field.fade_start) & (instants[:, None] <= field.fade_end)).any(axis=1)
    foot_speed = np.linalg.norm(velocity[:, FEET][..., [0, 2]], axis=-1)
    low = motion[:-1, FEET, 1] < LOW_METRES + np.quantile(motion[:, FEET, 1], 0.05, axis=0)

    def of_feet(rows: np.ndarray) -> float:
        return float(foot_speed[low & rows[:-1, None]].mean()) if (low & rows[:-1, None]).any() else float("nan")

    planted = to_motion(plant_generated(field, script), Fraction(FPS))
    return Figures(
        apart_cm=float(np.mean(apart)),
        foot_speed=(of_feet(joins), of_feet(~joins)),
        jerk=(float(third[joins[1:-2]].mean()), float(third[~joins[1:-2]].mean())),
        largest_velocity_change=(float(change[joins[1:-1]].max()), float(change[~joins[1:-1]].max())),
        skating=slide_speed(planted.joint_positions, Fraction(FPS)) or 0.0,
        seconds=seconds,
    )


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--overlap", type=float, default=0.5)
    parser.add_argument("--motions", type=int, default=20)
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    model, sampling = load(arguments.run), SamplingOptions(steps=arguments.steps)
    rows = {}
    for name, make in (("cross-faded", cross_faded), ("in phase", generate_joined)):
        found = []
        for number in range(arguments.motions):
            script = (GenerationRequest(arguments.seconds, text=TEXTS[number % len(TEXTS)]),)
            begin = time.process_time()
            options = {"seed": arguments.seed, "number": number, "sampling": sampling}
            field = make(model, script, overlap_seconds=arguments.overlap, **options)
            assert isinstance(field, AssembledField)
            found.append(asdict(figures_of(field, script, time.process_time() - begin)))
        rows[name] = {key: np.nanmean([each[key] for each in found], axis=0).tolist() for key in found[0]}
    if arguments.json:
        print_json({"run": str(arguments.run), "rows": rows}, runs=[arguments.run])
        return
    print(f"{'':12}{'apart, cm':>10}{'foot speed, m/s':>20}{'jerk, m/s³':>16}{'jump, m/s':>16}{'skating':>9}{'s':>7}")
    for name, row in rows.items():
        pairs = [f"{row[key][0]:.3g} / {row[key][1]:.3g}" for key in ("foot_speed", "jerk", "largest_velocity_change")]
        print(
            f"{name:12}{row['apart_cm']:10.2f}{pairs[0]:>20}{pairs[1]:>16}{pairs[2]:>16}{row['skating']:9.3f}"
            f"{row['seconds']:7.2f}"
        )


if __name__ == "__main__":
    main()
