"""A stage-1 step in float32 and in bfloat16, as it is and compiled by torch: CPU seconds a step on a store's windows.

    python benchmarks/nerm/precision.py --store STORE [--recipe nano] [--batch N] [--steps 20] [--json]

One thread; the median over the steps, the first ones (and compilation) left out. The settings are `field.precision` and
`field.compile`; the codes of the time encoding are random, which costs the same.
"""

import dataclasses
import statistics
import time
from pathlib import Path

import torch

from benchmarks.command import arguments_parser, print_json
from motionkit.data.corpus import FrameValues
from motionkit.data.poses import WindowPoses
from motionkit.store.cache import open_cache
from motionkit.store.reader import Store
from motionkit.training.config import Precision, apply_overrides
from motionkit.training.loop import step_generator
from nerm.field.training import FieldTraining, training_windows
from nerm.recipes import RECIPES
from nerm.settings import FieldConfig

WARMING = 3
PRECISIONS: tuple[Precision, ...] = ("float32", "bfloat16")


def seconds_a_step(poses: WindowPoses, config: FieldConfig, codes: torch.Tensor, steps: int) -> float:
    """The median CPU seconds of a step."""
    training = FieldTraining(poses, config, codebook=codes, seed=0, device=torch.device("cpu"))
    found = []
    for step in range(WARMING + steps):
        started = time.process_time()
        training.step(step, step_generator(0, "field", step))
        found.append(time.process_time() - started)
    return statistics.median(found[WARMING:])


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("--store", type=Path, required=True)
    parser.add_argument("--recipe", choices=RECIPES, default="nano")
    parser.add_argument("--batch", type=int)
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    recipe = RECIPES[arguments.recipe]()
    config = apply_overrides(
        recipe.field, [f"schedule.batch_size={arguments.batch or recipe.field.schedule.batch_size}"]
    )
    source = open_cache(Store.open(arguments.store), layout="smpl22", where=config.where or None)
    poses = WindowPoses(training_windows(source, config), FrameValues.of_positions(source))
    codes = torch.randn(recipe.codebook.network.num_codes, recipe.codebook.network.code_dimension)
    figures = {
        f"{precision}{', compiled' if compiled else ''}": seconds_a_step(
            poses, dataclasses.replace(config, precision=precision, compile=compiled), codes, arguments.steps
        )
        for precision in PRECISIONS
        for compiled in (False, True)
    }
    if arguments.json:
        asked = {"recipe": arguments.recipe, "batch": config.schedule.batch_size}
        print_json({**asked, "cpu_seconds_a_step": figures}, arguments.store)
        return
    print(
        f"recipe {arguments.recipe}, {config.schedule.batch_size} × {config.clips.num_poses} poses, "
        f"width {config.decoder.width}"
    )
    for name, seconds in figures.items():
        print(f"{name:22} {1000 * seconds:8.1f} CPU ms a step")


if __name__ == "__main__":
    main()
