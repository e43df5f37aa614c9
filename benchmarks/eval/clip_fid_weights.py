"""Choice of the kinematic descriptor's weights: by linear programming on training takes only.

    python -m benchmarks.eval.clip_fid_weights STORE [--fps 40 …] [--rise 1.3] [--json]

The descriptor is fitted on 60 % of the store's training takes. The others are damaged, and the damage is hidden, as in
a calibration. A score is about the sum of what its parts score alone, which is linear in their weights. So for every
share that games have to leave there is a linear programme: every level of damage scores `--rise` times the milder one,
every game that share, and what other takes score is least. The largest share for which it has a solution is printed
with its weights, and beside it what the weights in force make of the same sets.
"""

import argparse
import json
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog

from eval.clip_fid.calibration import level_name
from eval.clip_fid.clips import OTHER, REAL, Protocol, describe_clips, draw_clips, place_clips, readable
from eval.clip_fid.features import fit_on
from eval.clip_fid.kinematic import LEAST_FOLLOWING, TIMING_WEIGHT, WEIGHTS, KinematicDescriptor
from eval.metrics.gaussian import Gaussian, fit_gaussian, frechet_distance
from eval.sets.corruptions import families
from eval.sets.games import TIMED, games
from eval.sets.real import real_motion
from eval.sets.sets import SampleSet
from motionkit.store import Store

RATES = (40, 60, 100, 120)
FITTED_SHARE = 0.6
REPLICATIONS = 4
NUM_HALVES = 4
PARTS = (*WEIGHTS, "timing")
FIXED = {"pose": 1.0, "spread": 1.0, "speed": 1.0}
"""Weights that set the scale of a score."""
LEAST, MOST = 0.01, 6.0
LEAST_SCORE = 0.08
"""Minimum score of upsampling from 20 fps."""
ABOVE_FLOOR = 0.003
"""Minimum difference of scores between the mildest damage and none."""
Parts = npt.NDArray[np.float64]


class Sets:
    """Scores of every damaged set of one framerate by part, at weights of 1: vectors in the order of `PARTS`."""

    def __init__(self, train: SampleSet) -> None:
        order = np.random.default_rng(1).permutation(train.num_sequences)
        fitted = round(FITTED_SHARE * len(order))
        self.descriptor: KinematicDescriptor = fit_on(train.select(order[:fitted]))
        self.real = train.select(order[fitted:])
        self.reference = self._gaussians(self.real, REAL)
        self.scores = {"clean": self.parts(self.real)}
        self.graded: list[list[str]] = []
        self.games: list[tuple[str, str]] = []
        for family in families():
            names = []
            for strength in family.levels_at(float(train.fps)):
                rng = np.random.default_rng((0, 5))
                takes = [family.corrupt(take[None], float(train.fps), strength, rng)[0] for take in self.real.sequences]
                names.append(level_name(family, strength))
                self.scores[names[-1]] = self.parts(self.real.with_positions(names[-1], train.fps, takes))
            self.graded.append(names)
        for each in games(self.real):
            for name, samples in {each.parent: each.honest, **each.cheats}.items():
                self.scores[name] = self.parts(samples)
            # No weights lose every timed game, so they are left out (docs/results/games.md).
            untimed = [name for name in each.cheats if not any(kind in name for kind in TIMED)]
            self.games += [(each.parent, name) for name in untimed]
        halves = [
            np.random.default_rng(30 + number).permutation(self.real.num_sequences) for number in range(NUM_HALVES)
        ]
        middle = self.real.num_sequences // 2
        self.disjoint = np.mean(
            [
                self._compared(
                    self._gaussians(self.real, REAL, half[:middle]), self._gaussians(self.real, OTHER, half[middle:])
                )
                for half in halves
            ],
            axis=0,
        )

    def parts(self, samples: SampleSet) -> Parts:
        """A set's scores against the real one, by part."""
        return self._compared(self.reference, self._gaussians(samples, OTHER))

    def _gaussians(self, samples: SampleSet, side: int, among: npt.NDArray[np.int64] | None = None) -> list[Gaussian]:
        rows, protocol = readable(samples, self.descriptor), replace(Protocol(), resamplings=0)
        drawn = [
            place_clips(draw_clips(protocol, samples.fps, each, side), rows, among) for each in range(REPLICATIONS)
        ]
        return [fit_gaussian(describe_clips(rows, places, self.descriptor)) for places in drawn]

    def _compared(self, real: list[Gaussian], other: list[Gaussian]) -> Parts:
        rows = []
        for one, two in zip(real, other, strict=True):
            distances = [
                frechet_distance(one.part(block), two.part(block)) / WEIGHTS[name] if block.stop > block.start else 0.0
                for name, block in self.descriptor.blocks.items()
            ]
            follows = self.descriptor.following(one)
            lost = max(0.0, follows - self.descriptor.following(two)) / max(follows, LEAST_FOLLOWING)
            rows.append([*distances, lost**2])
        return np.mean(rows, axis=0)


def solved(sets: list[Sets], share: float, rise: float) -> Parts | None:
    """Weights at which every game leaves `share`, and other takes score least; None if there are none."""
    bounds: list[Parts] = []
    limits: list[float] = []
    for each in sets:
        for parent, game in each.games:
            bounds.append(share * each.scores[parent] - each.scores[game])
            limits.append(0.0)
        for names in each.graded:
            for mild, severe in pairwise(["clean", *names]):
                first = mild == "clean"
                bounds.append((1.0 if first else rise) * each.scores[mild] - each.scores[severe])
                limits.append(-ABOVE_FLOOR if first else 0.0)
        bounds.append(-each.scores["upsampled from 20 fps"])
        limits.append(-LEAST_SCORE)
    allowed = [(FIXED[name], FIXED[name]) if name in FIXED else (LEAST, MOST) for name in PARTS]
    found = linprog(np.mean([each.disjoint for each in sets], axis=0), np.array(bounds), limits, bounds=allowed)
    return found.x if found.success else None


def best(sets: list[Sets], rise: float) -> tuple[float, Parts]:
    """The largest feasible share, in hundredths, and its weights. Raises `ValueError` if there are none."""
    for share in np.arange(0.99, 0.0, -0.01):
        weights = solved(sets, float(share), rise)
        if weights is not None:
            return float(share), weights
    raise ValueError("no weights let every kind of damage score more the more there is of it")


def report(sets: list[Sets], weights: Parts) -> list[dict[str, object]]:
    """Scores of the sets under the weights at every framerate."""
    rows = []
    for each in sets:
        score = {name: float(parts @ weights) for name, parts in each.scores.items()}
        ratios = {game: score[game] / score[parent] for parent, game in each.games}
        rises = {
            f"{mild} < {severe}": score[severe] / score[mild]
            for names in each.graded
            for mild, severe in pairwise(names)
        }
        worst, least = min(ratios, key=ratios.__getitem__), min(rises, key=rises.__getitem__)
        rows.append(
            {
                "fps": str(each.real.fps),
                "worst game": [worst, ratios[worst]],
                "least rise": [least, rises[least]],
                "upsampled from 20 fps": score["upsampled from 20 fps"],
                "low-passed at 8 Hz": score["low-passed at 8 Hz"],
                "disjoint halves of the takes (P2)": float(each.disjoint @ weights),
                "the same takes (P1)": score["clean"],
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("store", type=Path)
    parser.add_argument("--fps", type=Fraction, nargs="+", default=[Fraction(rate) for rate in RATES])
    parser.add_argument("--rise", type=float, nargs="+", default=[1.3])
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    train = real_motion(Store.open(options.store), "train")
    sets = [Sets(train.at(fps)) for fps in options.fps]
    made = {"in force": np.array([*WEIGHTS.values(), TIMING_WEIGHT])}
    for rise in options.rise:
        share, weights = best(sets, rise)
        made[f"solved: rises by {rise:g}, games leave {share:.2f}"] = weights
    found = {
        name: {"weights": dict(zip(PARTS, weights.round(3).tolist(), strict=True)), "framerates": report(sets, weights)}
        for name, weights in made.items()
    }
    if options.json:
        print(json.dumps(found))
        return
    for name, each in found.items():
        print(name, each["weights"], *each["framerates"], sep="\n  ")


if __name__ == "__main__":
    main()
