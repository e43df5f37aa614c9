"""Effect of detail on low-passed real takes and on a run's generated motion, and its cost.

    python -m benchmarks.fields.detail TRAINING [TESTED] [--run RUN] [--fps 60 120] [--json]

Detail is learnt from TRAINING's training takes. Of the test takes of TESTED (by default TRAINING's) what lies above
10 Hz is filtered out; scored by clip-FID/2 and kinematic/1 against the takes themselves, on descriptors of the same
training takes, are: that; with detail; with noise as strong on average, joint by joint and band by band, that does not
follow the motion; with what another take has above 10 Hz; and the takes themselves with detail. With a run, its planted
motions, the same with detail, with the noise, and with detail first and planted then; and physical figures at 120 fps.
"Follows" is by how much log power above 12 Hz rises where the descriptor's predictor says that it rises by 1.
Differences have a paired 95 % interval over takes. Strikes: how much of the energy above 10 Hz within 67 ms of foot
strikes the mean course of it explains, scaled by the speed of the strike, on other takes than those it was fitted on.
"""

import argparse
import json
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from benchmarks.command import arguments_parser

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import numpy.typing as npt

from eval.clip_fid.clips import REAL, Protocol, describe_clips, draw_clips, place_clips, readable
from eval.clip_fid.features import Comparison, kinematic1_source, kinematic_source
from eval.clip_fid.kinematic import KinematicDescriptor
from eval.metrics.gaussian import fit_gaussian
from eval.metrics.physical import METRICS
from eval.report.results import provenance
from eval.sets.corruptions import low_pass
from eval.sets.generated import Window, generate_fields, sample_fields, windows_of
from eval.sets.planted import planted_fields
from eval.sets.real import RealMotion, real_motion
from eval.sets.sets import SampleSet
from eval.tables.models import require_models
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.fields.detail import FEET, GRID_FPS, Detail, SlowMotion, detailed, fit_detail
from motionkit.fields.interpolation import interpolate
from motionkit.fields.motion_field import to_motion
from motionkit.fields.resample import resample_positions
from motionkit.store.reader import Store
from tests.helpers.analytic import analytic_motion

CUTOFF_HZ, SMOOTH_HZ = 10.0, 6.0
RATES = (40, 60, 100, 120)
GRID = Fraction(GRID_FPS)
CLIPS, REPLICATIONS, RESAMPLINGS, FOLLOWING_DRAWS = 2048, 5, 200, 3
MINUTES = 2
REAL_TAKES, GENERATED = "real takes", "generated"
AROUND = 24
NEAR = slice(AROUND - 8, AROUND + 9)
Positions = npt.NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Flat(Detail):
    """Detail with constant strength, its average over half a minute: noise independent of the motion."""

    def power(self, slow: SlowMotion) -> npt.NDArray[np.float64]:
        """The mean of every joint and band."""
        power = super().power(slow)
        return np.broadcast_to(power.mean(axis=0), power.shape)


def fast_takes(real: RealMotion) -> list[Positions]:
    """Takes of 120 fps or more, at 120 fps."""
    each = zip(real.sequences, real.fps, strict=True)
    return [resample_positions(take.astype(np.float64), fps, GRID) for take, fps in each if fps >= GRID]


def field_of(take: Positions) -> MotionField:
    """A take at 120 fps as a motion field."""
    return interpolate(Motion.from_joints(take.astype(np.float32), GRID, SMPL22), "cubic")


def smooth_rows(takes: list[Positions], reference: SampleSet, detail: Detail) -> dict[str, SampleSet]:
    """The rows of one framerate that low-passed takes make."""
    fps = reference.fps
    slow = [low_pass(take[None], float(GRID), CUTOFF_HZ)[0] for take in takes]
    fast = [take - each for take, each in zip(takes, slow, strict=True)]
    step = 1 + int(np.random.default_rng(0).integers(len(takes) - 1))
    borrowed = [each + np.resize(fast[(n + step) % len(fast)], each.shape) for n, each in enumerate(slow)]

    def with_detail(those: list[Positions], of: Detail) -> SampleSet:
        made = (detailed(field_of(take), of, seed=0, number=n).at_fps(fps) for n, take in enumerate(those))
        return reference.with_positions("", fps, [to_motion(each, fps).joint_positions for each in made])

    def plain(those: list[Positions]) -> SampleSet:
        return reference.with_positions(
            "", fps, [resample_positions(each.astype(np.float32), GRID, fps) for each in those]
        )

    return {
        "low-passed at 10 Hz": plain(slow),
        "with detail": with_detail(slow, detail),
        "with noise as strong": with_detail(slow, Flat(**detail.arrays())),
        "with another take's fast part": plain(borrowed),
        "the takes themselves": reference,
        "the takes themselves, with detail": with_detail(takes, detail),
    }


def generated_rows(fields: Mapping[str, dict[Window, MotionField]], reference: SampleSet) -> dict[str, SampleSet]:
    """The rows of one framerate that a run's motions make."""
    ids = reference.sequence_ids
    made = {name: sample_fields(own, ids, reference.fps, name) for name, own in fields.items()}
    return {name: samples for name, samples in made.items() if samples is not None}


def generated(run: Path, wanted: SampleSet, detail: Detail) -> dict[str, dict[Window, MotionField]]:
    """A run's motions for some takes, in every way."""
    model = next(iter(require_models(run).value.values())).loaded
    own = generate_fields(model, windows_of(wanted, model.max_duration_seconds), 0, 10**6)
    standing = planted_fields(own)

    def each(of: Detail, those: Mapping[Window, MotionField]) -> dict[Window, MotionField]:
        numbered = enumerate(those.items())
        return {window: detailed(field, of, seed=0, number=number) for number, (window, field) in numbered}

    return {
        "generated, planted": standing,
        "generated, planted, with detail": each(detail, standing),
        "generated, planted, with noise as strong": each(Flat(**detail.arrays()), standing),
        "generated, with detail, planted": planted_fields(each(detail, own)),
    }


def scored(rows: Mapping[str, SampleSet], real: SampleSet, train: SampleSet, against: str) -> dict[str, dict[str, Any]]:
    """Both scores of every row, how much its fast motion follows, and how far it is from the row `against`."""
    found: dict[str, dict[str, Any]] = {name: {} for name in rows}
    asked = Protocol(num_clips=CLIPS, replications=REPLICATIONS, detailed_replications=0, resamplings=RESAMPLINGS)
    for source in (kinematic_source(), kinematic1_source()):
        comparison = source.comparison(real, train, asked)
        scores = comparison.scores(rows)
        for name, score in scores.items():
            difference = None if name == against else score.less(scores[against])
            found[name][source.name] = {
                "score": score.clip_fid.mean,
                "ci95": score.clip_fid.ci95,
                "less than without": None if difference is None else vars(difference),
            }
        if isinstance(comparison.features, KinematicDescriptor):
            for name, samples in {**rows}.items():
                found[name]["follows"] = following(comparison, samples)
    return found


def following(comparison: Comparison, samples: SampleSet) -> float:
    """The slope of log power against the predictor's."""
    descriptor = comparison.features
    assert isinstance(descriptor, KinematicDescriptor)
    rows = readable(samples, descriptor)
    lists = (draw_clips(comparison.protocol, samples.fps, draw, REAL) for draw in range(FOLLOWING_DRAWS))
    each = [fit_gaussian(describe_clips(rows, place_clips(clips, rows), descriptor)) for clips in lists]
    return float(np.mean([descriptor.following(one) for one in each]))


def physical(samples: SampleSet) -> dict[str, float]:
    """Means of the physical figures, weighing by seconds."""
    found = {}
    for metric in METRICS:
        values = [metric.function(positions, samples.fps) for positions in samples.sequences]
        known = [n for n, value in enumerate(values) if value is not None]
        weights = samples.sequences.num_frames[known]
        found[metric.title] = float(np.average([values[n] for n in known], weights=weights))
    return found


def strikes(takes: list[Positions]) -> dict[str, float]:
    """The share of energy that the mean course explains, with the time of strikes known from slow motion or exactly."""
    found = {}
    for title, cutoff in (("seen in slow motion", SMOOTH_HZ), ("seen in the capture", None)):
        courses: list[list[npt.NDArray[np.float64]]] = [[], []]
        speeds: list[list[float]] = [[], []]
        for number, take in enumerate(takes):
            shown = take if cutoff is None else low_pass(take[None], float(GRID), cutoff)[0]
            fast = take - low_pass(take[None], float(GRID), CUTOFF_HZ)[0]
            for joint in FEET:
                for at, speed in strikes_of(shown[:, joint, 1], shown[:, FEET, 1].min(axis=1)):
                    courses[number % 2].append(fast[at - AROUND : at + AROUND + 1, joint, 1])
                    speeds[number % 2].append(speed)
        learnt, tested = (np.clip(np.array(each), -0.02, 0.02) for each in courses)
        inputs = [np.stack((np.ones(len(each)), each), axis=1) for each in speeds]
        course = np.linalg.lstsq(inputs[0], learnt, rcond=None)[0]
        left = np.square(tested - inputs[1] @ course)[:, NEAR].sum()
        found[f"{title}, {len(tested)} strikes"] = float(1.0 - left / np.square(tested[:, NEAR]).sum())
    return found


def strikes_of(height: Positions, lowest: Positions) -> list[tuple[int, float]]:
    """Where a foot joint that came down at 0.15 m/s or more is stopped near the ground, and how fast it came."""
    from scipy.ndimage import minimum_filter1d
    from scipy.signal import find_peaks

    velocity = np.gradient(height) * GRID_FPS
    peaks, _ = find_peaks(np.gradient(velocity) * GRID_FPS, height=5.0)
    ground = minimum_filter1d(lowest, 2 * GRID_FPS + 1, mode="nearest")
    inner = [at for at in peaks.tolist() if AROUND <= at < len(height) - AROUND and height[at] < ground[at] + 0.12]
    came = [(at, -float(velocity[at - 12 : at].min())) for at in inner]
    return [(at, speed) for at, speed in came if speed > 0.15]


def costs(detail: Detail) -> dict[str, float]:
    """Frames per second of process time."""
    motion = to_motion(analytic_motion("walk", 60.0 * MINUTES), GRID)
    base = interpolate(replace(motion, local_rotations=None, root_translation=None), "linear")
    spent = {}
    for name, field in (("without", base), ("with", detailed(base, detail, seed=0))):
        begun = time.process_time()
        to_motion(field, GRID)
        spent[name] = time.process_time() - begun
    return {"frames a second": motion.num_frames / (spent["with"] - spent["without"])}


def measured(options: argparse.Namespace) -> dict[str, Any]:
    """All figures."""
    learning = real_motion(Store.open(options.training), "train")
    tested = Store.open(options.tested or options.training)
    real = real_motion(tested, options.split)
    begun = time.process_time()
    taught = fast_takes(learning)
    detail = fit_detail(taught)
    figures: dict[str, Any] = {"seconds to learn": time.process_time() - begun}
    figures |= {"strikes": strikes(taught), "costs": costs(detail)}
    takes = fast_takes(real)
    fields = None if options.run is None else generated(options.run, real.at(GRID), detail)
    for fps in options.fps:
        reference, fitted = real.at(fps), learning.at(fps)
        known = {name: n for n, name in enumerate(reference.sequence_ids)}
        fast = [name for name, own in zip(real.sequence_ids, real.fps, strict=True) if own >= GRID]
        reference = reference.select([known[name] for name in fast])
        rows = smooth_rows(takes, reference, detail)
        figures[f"{fps} fps, {REAL_TAKES}"] = scored(rows, reference, fitted, "low-passed at 10 Hz")
        if fields is not None:
            made = generated_rows(fields, reference)
            figures[f"{fps} fps, {GENERATED}"] = scored(made, reference, fitted, "generated, planted")
            if fps == GRID:
                rows = {"the takes themselves": reference, **made}
                figures["physical"] = {name: physical(samples) for name, samples in rows.items()}
    return figures


def main() -> None:
    """Print the figures."""
    parser = arguments_parser(__doc__)
    parser.add_argument("training", type=Path)
    parser.add_argument("tested", type=Path, nargs="?")
    parser.add_argument("--split", default="test", help="of TESTED; all for every take")
    parser.add_argument("--run", type=Path)
    parser.add_argument("--fps", type=Fraction, nargs="+", default=[Fraction(rate) for rate in RATES])
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    figures = measured(options)
    if options.json:
        runs = [] if options.run is None else [options.run]
        origin = {
            **provenance(options.training, runs),
            "tested": provenance(options.tested or options.training)["store"],
        }
        print(json.dumps({**figures, "provenance": origin}, indent=1))
        return
    print(page(figures))


def page(figures: dict[str, Any]) -> str:
    """Markdown of all figures; of every row the score and its interval, and in brackets how much it follows."""
    lines = [f"Learnt in {figures['seconds to learn']:.1f} s."]
    for title in ("strikes", "costs"):
        lines += ["", f"| {title} | |", "|---|---|"]
        each = figures[title].items()
        lines += [f"| {name} | {value:,.0f} |" if value >= 10 else f"| {name} | {value:.1%} |" for name, value in each]
    for kind in (REAL_TAKES, GENERATED):
        columns = {title: part for title, part in figures.items() if title.endswith(kind)}
        for score in ("kinematic", "kinematic/1") if columns else ():
            lines += ["", f"| {kind}, {score} | {' | '.join(title.split(',')[0] for title in columns)} |"]
            lines.append("|---" * (1 + len(columns)) + "|")
            names = next(iter(columns.values()))
            for name in names:
                lines.append(f"| {name} | {' | '.join(shown(each[name], score) for each in columns.values())} |")
    if "physical" in figures:
        rows = figures["physical"]
        lines += ["", f"| at 120 fps | {' | '.join(rows)} |", "|---" * (1 + len(rows)) + "|"]
        titles = next(iter(rows.values()))
        lines += [f"| {each} | {' | '.join(f'{row[each]:.3g}' for row in rows.values())} |" for each in titles]
    return "\n".join(lines)


def shown(row: dict[str, Any], score: str) -> str:
    """A row's score; what it is less than without detail, in italics, where the paired interval leaves out 0."""
    found, less = row[score], row[score]["less than without"]
    said = f"{found['score']:.2f} ± {found['ci95']:.2f}"
    if score == "kinematic":
        said += f" ({row['follows']:.2f})"
    significant = less is not None and abs(less["value"]) > less["ci95"]
    return f"{said} *{less['value']:+.2f} ± {less['ci95']:.2f}*" if significant else said


if __name__ == "__main__":
    main()
