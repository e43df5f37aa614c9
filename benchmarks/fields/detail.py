"""What `--detail` adds, by the detail profile: to low-passed real motion, and to a run's generated motion.

    python -m benchmarks.fields.detail TRAINING [TESTED] [--split test] [--run RUN] [--fps 60 120] [--json]

Detail is learnt from TRAINING's training takes, and the profile's predictor is fitted on them. Of the takes of TESTED
(by default TRAINING's own) what lies above 10 Hz is filtered out. Profiles beside the takes themselves: of that; with
detail; with noise as strong on average, joint by joint and band by band, that does not follow the motion; and of the
takes themselves with detail. With a run: of its planted motions for the takes' captions, without and with detail.
"""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from benchmarks.command import arguments_parser, print_json

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import numpy.typing as npt

from eval.detail import RealDetail
from eval.sets.motions import (
    RealMotion,
    generate_fields,
    low_pass,
    planted_fields,
    real_motion,
    sample_fields,
    windows_of,
)
from eval.sets.sets import Missing, SampleSet
from eval.tables.systems import require_models
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.fields.detail import GRID_FPS, Detail, SlowMotion, detailed, fit_detail
from motionkit.fields.interpolation import interpolate
from motionkit.fields.motion_field import MotionField, at_fps, to_motion
from motionkit.fields.resample import resample_positions
from motionkit.store import Store

CUTOFF_HZ = 10.0
GRID = Fraction(GRID_FPS)
MAX_MOTIONS = 120
Positions = npt.NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Flat(Detail):
    """Detail with constant strength, its average over the motion: noise that does not follow it."""

    def power(self, slow: SlowMotion) -> npt.NDArray[np.float64]:
        """The mean of every joint and band."""
        power = super().power(slow)
        return np.broadcast_to(power.mean(axis=0), power.shape)


def fast_takes(real: RealMotion) -> list[Positions]:
    """Takes of 120 fps or more, at 120 fps."""
    each = zip(real.sequences, real.fps, strict=True)
    return [resample_positions(take.astype(np.float64), fps, GRID) for take, fps in each if fps >= GRID]


def smooth_rows(takes: list[Positions], reference: SampleSet, detail: Detail) -> dict[str, SampleSet]:
    """The takes without what lies above 10 Hz, plain and with detail, at the reference's framerate."""
    slow = [low_pass(take, float(GRID), CUTOFF_HZ) for take in takes]

    def fields(those: Iterable[Positions], added: Detail | None) -> SampleSet:
        motions = (Motion.from_joints(take.astype(np.float32), GRID, SMPL22) for take in those)
        own: Iterable[MotionField] = (interpolate(motion, "cubic") for motion in motions)
        if added is not None:
            own = (detailed(field, added, seed=0, number=n) for n, field in enumerate(own))
        made = [to_motion(at_fps(field, reference.fps), reference.fps).joint_positions for field in own]
        return reference.with_positions(made)

    return {
        "low-passed at 10 Hz": fields(slow, None),
        "low-passed, with detail": fields(slow, detail),
        "low-passed, with noise as strong": fields(slow, Flat(**detail.arrays())),
        "the takes themselves, with detail": fields(takes, detail),
    }


def generated_rows(run: Path, reference: SampleSet, detail: Detail) -> dict[str, SampleSet]:
    """A run's motions for the captions and durations of the reference's takes, planted, without and with detail."""
    model = next(iter(require_models(run, "this", Missing()).values())).loaded
    windows = windows_of(reference, model.max_duration_seconds)
    standing = planted_fields(generate_fields(model, windows, 0, MAX_MOTIONS))
    with_detail = {
        window: detailed(field, detail, seed=0, number=n) for n, (window, field) in enumerate(standing.items())
    }
    rows = {"generated, planted": standing, "generated, planted, with detail": with_detail}
    sampled = {
        name: sample_fields(fields, reference.sequence_ids, reference.fps, name) for name, fields in rows.items()
    }
    return {name: samples for name, samples in sampled.items() if samples is not None}


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("training", type=Path)
    parser.add_argument("tested", type=Path, nargs="?")
    parser.add_argument("--split", default="test")
    parser.add_argument("--run", type=Path)
    parser.add_argument("--fps", type=Fraction, nargs="+", default=[Fraction(60), Fraction(120)])
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    training = real_motion(Store.open(arguments.training), "train")
    real = real_motion(Store.open(arguments.tested or arguments.training), arguments.split)
    detail = fit_detail(fast_takes(training))
    found: dict[str, Mapping[str, Mapping[str, float]]] = {}
    for fps in arguments.fps:
        reference = real.at(fps)
        profiled = RealDetail.of(reference, training.at(fps))
        rows = {"the takes themselves": reference, **smooth_rows(fast_takes(real), reference, detail)}
        if arguments.run:
            rows |= generated_rows(arguments.run, reference, detail)
        figures = {name: profiled.profile(samples).figures for name, samples in rows.items()}
        found[f"{fps} fps"] = {name: {key: each.value for key, each in row.items()} for name, row in figures.items()}
        if not arguments.json:
            print(f"\n| {fps} fps | {' | '.join(figures['the takes themselves'])} |")
            for name, row in figures.items():
                cells = (f"{each.value:.2f}{'' if each.is_real else '*'}" for each in row.values())
                print(f"| {name} | {' | '.join(cells)} |")
    if arguments.json:
        print_json(found, arguments.training)


if __name__ == "__main__":
    main()
