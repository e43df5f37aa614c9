"""How far a trained field's motions move when conditioned on another framerate, in millimetres.

    python -m benchmarks.nerm.framerate_shift runs/nano [--windows 256] [--json]

Each window's posterior mean is decoded with s = 20, 30, 60 and 120 fps at the instants that these share; distances
of joints over every pair of framerates. Needs the stage `field` alone.
"""

from pathlib import Path

import numpy as np

from benchmarks.command import arguments_parser, print_json
from nerm.field.trained import load_field
from nerm.model import RATES, FramerateShift, framerate_shift


def measure(run: Path, num_windows: int) -> FramerateShift:
    """The shift of windows spread over the run's."""
    trained = load_field(run)
    rows = np.linspace(0, len(trained.windows) - 1, min(num_windows, len(trained.windows))).round().astype(int)
    seconds = trained.windows.duration_seconds
    fields = [trained.as_motion_field(trained.posterior_mean[row], float(seconds[row])) for row in rows.tolist()]
    return framerate_shift(fields, RATES)


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("--windows", type=int, default=256)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    found = measure(arguments.run, arguments.windows)
    if arguments.json:
        print_json(found.plain(), runs=[arguments.run])
        return
    rates = ", ".join(str(rate) for rate in found.rates)
    print(f"{found.num_motions} windows, {found.num_instants} instants, at {rates} fps")
    print(f"mean {found.mean_mm:.3f} mm, largest {found.max_mm:.3f} mm")


if __name__ == "__main__":
    main()
