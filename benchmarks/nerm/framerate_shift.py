"""How far a trained field's motions move when it is told another framerate, in millimetres.

    python benchmarks/nerm/framerate_shift.py runs/nano [--windows 256] [--json]

Each window's posterior mean is decoded told 20, 30, 60 and 120 fps, at the instants that all of these share; distances
of joints over every pair of framerates. Needs the stage `field` alone.
"""

import argparse
import json
from fractions import Fraction
from itertools import combinations
from pathlib import Path

import numpy as np

from nerm.field_model import load_field
from nerm.framerate_shift import RATES, FramerateShift, framerate_shift


def measure(run: Path, num_windows: int) -> list[FramerateShift]:
    """The shift over all of `RATES`, then of each pair."""
    trained = load_field(run)
    rows = np.linspace(0, len(trained.windows) - 1, min(num_windows, len(trained.windows))).round().astype(int)
    seconds = trained.windows.duration_seconds
    fields = [trained.as_motion_field(trained.posterior_mean[row], float(seconds[row])) for row in rows.tolist()]
    choices: list[tuple[Fraction, ...]] = [RATES, *combinations(RATES, 2)]
    return [framerate_shift(fields, rates) for rates in choices]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--windows", type=int, default=256)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    found = measure(arguments.run, arguments.windows)
    if arguments.json:
        print(json.dumps([each.plain() for each in found], indent=2))
        return
    print(f"{found[0].num_motions} windows, {found[0].num_instants} instants; mm")
    for each in found:
        rates = ", ".join(str(rate) for rate in each.rates)
        print(f"{rates:>16} fps  mean {each.mean_mm:7.3f}  largest {each.max_mm:7.3f}")


if __name__ == "__main__":
    main()
