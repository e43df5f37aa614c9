"""How well generated motions follow a path, and the cost in quality.

    python benchmarks/nerm/constraints.py RUN --store STORE [--motions 96] [--steps 10] [--seed 0] [--json]

Held-out takes give captions, lengths of up to l_max and paths on the floor; motions are made of the captions alone and
along the paths, planted. Distances from the path (mean over motions, the worst tenth, the largest, and the share of
motions that are within 5 cm on average), skating, jerk, and clip-FID of both against the held-out takes at 20 fps.
"""

import time
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch

from benchmarks.command import arguments_parser, print_json
from eval.clip_fid.clips import Protocol
from eval.clip_fid.features import Comparison, kinematic_source
from eval.metrics.physical import jerk, slide_speed
from eval.sets.real import real_motion, training_motion
from eval.sets.sets import SampleSet, sample_set
from motionkit.fields.motion_field import to_motion
from motionkit.generate.constraints import Constraint, followed
from motionkit.generate.models import GenerationRequest, SamplingOptions
from motionkit.generate.output import plant_generated
from motionkit.store import Store
from nerm.model import NermModel, load

FPS = 20
PATH_POINTS_PER_SECOND = 8.0


def requests_of(real: SampleSet, longest_seconds: float, count: int) -> dict[int, GenerationRequest]:
    """Caption and path of the beginning of takes that are evenly chosen, by their number."""
    chosen = np.unique(np.linspace(0, real.num_sequences - 1, count).astype(int)).tolist()
    found = {}
    for number in chosen:
        positions = np.asarray(real.sequences[number])
        seconds = min((len(positions) - 1) / FPS, longest_seconds)
        points = np.linspace(0.0, seconds, max(2, int(seconds * PATH_POINTS_PER_SECOND)))
        frames = np.arange(len(positions)) / FPS
        places = np.stack([np.interp(points, frames, positions[:, 0, axis]) for axis in (0, 2)], axis=1)
        caption = real.captions[number] if real.captions else ""
        found[number] = GenerationRequest(seconds, caption, constraints=(Constraint.path(places, points),))
    return found


def made(model: NermModel, requests: dict[int, GenerationRequest], seed: int, steps: int) -> tuple[dict, list, float]:
    """Poses at 60 fps by take, how far each followed its path, and seconds per motion."""
    begin, poses, met = time.process_time(), {}, []
    for number, request in requests.items():
        [field] = model.generate([request], seed=seed, first=number, sampling=SamplingOptions(steps=steps))
        shown = plant_generated(field, (request,))
        poses[number] = to_motion(shown, Fraction(60)).joint_positions
        met += [followed(shown, each) for each in request.constraints]
    return poses, met, (time.process_time() - begin) / len(requests)


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("--store", type=Path, required=True)
    parser.add_argument("--motions", type=int, default=96)
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    store, model = Store.open(arguments.store), load(arguments.run)
    held_out = real_motion(store, "test")
    real, train = held_out.at(Fraction(FPS)), training_motion(store, held_out).at(Fraction(FPS))
    comparison = Comparison(
        real, kinematic_source().fit(train), Protocol(num_clips=2048, replications=6, resamplings=0), {}
    )
    along = requests_of(real, model.max_duration_seconds, arguments.motions)
    rows, sets = {}, {}
    for name, requests in (
        ("captions alone", {number: replace(each, constraints=()) for number, each in along.items()}),
        ("along paths", along),
    ):
        poses, met, seconds = made(model, requests, arguments.seed, arguments.steps)
        ids = [real.sequence_ids[number] for number in poses]
        some = sample_set(name, Fraction(FPS), [each[::3] for each in poses.values()], ids)
        sets[name] = replace(some, takes=tuple(ids))
        row = {
            "seconds": seconds,
            "skating": np.mean([slide_speed(each, Fraction(60)) or 0.0 for each in poses.values()]),
        }
        row["jerk"] = np.mean([jerk(each, Fraction(60)) for each in poses.values()])
        if met:
            mean = np.array([each.mean_metres for each in met])
            row |= {"path_cm": 100 * mean.mean(), "worst_tenth_cm": 100 * np.quantile(mean, 0.9)}
            row |= {"largest_cm": 100 * max(each.max_metres for each in met), "within_5_cm": (mean <= 0.05).mean()}
        rows[name] = {key: float(value) for key, value in row.items()}
    for name, score in comparison.scores(sets).items():
        rows[name]["clip_fid"] = float(score.clip_fid.mean)
    if arguments.json:
        print_json({"rows": rows, "motions": len(along)}, runs=[arguments.run])
        return
    for name, row in rows.items():
        print(f"{name:15}", *(f"{key} {value:.3g}" for key, value in row.items()))


if __name__ == "__main__":
    main()
