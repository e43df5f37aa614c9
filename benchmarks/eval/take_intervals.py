"""Coverage of intervals over takes: repeated draws of Gaussian takes with known Fréchet distances.

    python benchmarks/eval/take_intervals.py [--trials 300] [--json]

A take has a random centre, its clips lie around it. Each trial draws the takes of a real set, of a generator and of
another one, scores both by the Fréchet distance of all clips, and resamples takes as Table 2 does. Printed for each
case: the mean score; its standard deviation over trials and the mean of what a bootstrap makes of it; how often score ±
interval holds the mean score of other draws of as many takes; the same of the interval of drawing clips alone; how
often the true distance lies in it (not often where takes are few, for these push the score up); how often two
generators differ significantly, where one is as good as the other (wrongly) and where it is better.
"""

import argparse
import json
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from eval.metrics.gaussian import Gaussian, fit_gaussian, frechet_distance, quick_frechet_distance
from eval.metrics.resampling import (
    NORMAL_95,
    Resampling,
    UnitSums,
    half_width,
    paired_difference,
    resampled_scores,
    units_of,
)

FEATURES, CLIPS_PER_TAKE, WITHIN = 12, 64, 0.6
DRAWS = 20


@dataclass(frozen=True)
class Case:
    """Takes on either side, how far both generators are from real motion, and whether they are made for real takes."""

    takes: int
    shift: float
    other_shift: float
    paired: bool


CASES = tuple(
    Case(takes, shift, other, paired)
    for takes in (15, 30, 60, 120)
    for shift, other in ((0.0, 0.0), (0.5, 0.5), (0.5, 0.7))
    for paired in (False, True)
)


def clips_of(centres: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    noise = WITHIN * rng.normal(size=(len(centres) * CLIPS_PER_TAKE, FEATURES))
    return np.repeat(centres, CLIPS_PER_TAKE, axis=0) + noise


def true_distance(shift: float) -> float:
    covariance = np.eye(FEATURES) * (1 + WITHIN**2)
    a, b = (Gaussian(np.full(FEATURES, mean), covariance, 2) for mean in (0.0, shift))
    return frechet_distance(a, b)


def drawing_of_clips(real: np.ndarray, other: np.ndarray, rng: np.random.Generator) -> float:
    """Half the 95 % interval of the mean over draws of half of the clips, as in earlier versions."""
    scores = []
    for _ in range(DRAWS):
        a, b = (each[rng.choice(len(each), len(each) // 2, replace=False)] for each in (real, other))
        scores.append(frechet_distance(fit_gaussian(a), fit_gaussian(b)))
    return float(NORMAL_95 * np.std(scores) / np.sqrt(DRAWS))


def trial(case: Case, seed: int) -> dict[str, float]:
    rng = np.random.default_rng((seed, 1))
    centres = rng.normal(size=(case.takes, FEATURES))
    made = []
    for shift in (case.shift, case.other_shift):
        # Half of the variance between takes is shared with the real takes that they were generated for.
        own = rng.normal(size=centres.shape)
        made.append(shift + (np.sqrt(0.5) * (centres + own) if case.paired else own))
    sets = [clips_of(each, rng) for each in (centres, *made)]
    unit = np.repeat(np.arange(case.takes), CLIPS_PER_TAKE)
    sums = []
    for features in sets:
        sums.append(UnitSums(case.takes, sets[0].mean(axis=0)))
        sums[-1].add(features, unit)
    names = [[f"{seed} {number}" for number in range(case.takes)]]
    names += [names[0] if case.paired else [f"{side}{name}" for name in names[0]] for side in "ab"]
    units = [units_of(each) for each in names]
    pairs = list(zip(sums, units, strict=True))
    found = resampled_scores(*pairs[0], pairs[1:], quick_frechet_distance, Resampling())
    real, *others = map(fit_gaussian, sets)
    scores = [frechet_distance(real, each) for each in others]
    difference = paired_difference(scores[0], found[0], scores[1], found[1])
    assert difference is not None
    return {
        "score": scores[0],
        "width": half_width(found[0]) or 0.0,
        "drawing": drawing_of_clips(sets[0], sets[1], rng),
        "told": float(difference.verdict != "not told apart"),
        "first is better": float(difference.verdict == "lower"),
    }


def measured(case: Case, trials: int) -> dict[str, float]:
    found = [trial(case, seed) for seed in range(trials)]
    column = {name: np.array([each[name] for each in found]) for name in found[0]}
    error = np.abs(column["score"] - column["score"].mean())
    true = true_distance(case.shift)
    return {
        "true distance": true,
        "mean score": float(column["score"].mean()),
        "SD over trials": float(column["score"].std()),
        "SD by bootstrap": float(column["width"].mean() / NORMAL_95),
        "covers mean score": float((error <= column["width"]).mean()),
        "drawing of clips covers it": float((error <= column["drawing"]).mean()),
        "covers true distance": float((np.abs(column["score"] - true) <= column["width"]).mean()),
        "told apart": float(column["told"].mean()),
        "first called better": float(column["first is better"].mean()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=300)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    figures = {}
    with threadpool_limits(1, "blas"):
        for case in CASES:
            made_for = "made for the real takes" if case.paired else "of other takes"
            name = f"{case.takes} takes, {made_for}, shifts {case.shift:g} and {case.other_shift:g}"
            figures[name] = measured(case, arguments.trials)
            if not arguments.json:
                print(name, *(f"  {key}: {value:.3g}" for key, value in figures[name].items()), sep="\n", flush=True)
    if arguments.json:
        print(json.dumps(figures, indent=2))


if __name__ == "__main__":
    main()
