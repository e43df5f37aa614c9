"""T of the detail profile falls with every frequency that motion loses: low-passed, and upsampled by a cubic spline.

    python -m benchmarks.eval.timing STORE [--fps 60 120]

Test sequences by source; the predictor is fitted on the training split. `*` is outside of what real sequences show.
"""

from fractions import Fraction
from pathlib import Path

import numpy as np

from benchmarks.command import arguments_parser
from eval.detail import RealDetail
from eval.sets.damage import FAMILIES
from eval.sets.motions import real_motion
from motionkit.store import Store

LEVELS = {"low-pass": (30.0, 20.0, 15.0, 12.0, 10.0, 8.0), "upsampling-cubic": (60.0, 40.0, 30.0, 20.0)}


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("--fps", type=Fraction, nargs="+", default=[Fraction(60), Fraction(120)])
    arguments = parser.parse_args()
    store = Store.open(arguments.store)
    families = {family.name: family for family in FAMILIES if family.name in LEVELS}
    for fps in arguments.fps:
        train = real_motion(store, "train").at(fps)
        tested = f"SELECT DISTINCT source FROM sequences WHERE split = 'test' AND fps >= {float(fps)} ORDER BY source"
        for source in store.sql(tested)["source"]:
            real = real_motion(store, "test", f"source = '{source}'").at(fps)
            detail = RealDetail.of(real, train)
            print(
                f"\n{source}, {fps} fps, {real.num_sequences} sequences, slope of real motion {detail.real_slope:.2f}"
            )
            for name, family in families.items():
                cells = []
                for level in (level for level in LEVELS[name] if level < fps):
                    rng = np.random.default_rng(0)
                    moved = [family.corrupt(motion, float(fps), level, rng) for motion in real.sequences]
                    timing = detail.profile(real.with_positions(moved, name=name)).timing
                    cells.append(f"{level:g} {family.unit}: {timing.value:.2f}{'' if timing.is_real else '*'}")
                print(f"{name:17} {', '.join(cells)}")


if __name__ == "__main__":
    main()
