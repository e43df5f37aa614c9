"""Effect of planting on real takes, whose feet already rest: how far it moves them, and their clip-FID.

    python -m benchmarks.fields.planted_takes STORE [--split test] [--fps 20,60,120] [--json]

Takes are planted at their own framerates, as `motionkit plant` does it. clip-FID of the planted takes against the same
takes, in multiples of the floor: of what the takes themselves score when clips are drawn from them once more.
"""

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.command import arguments_parser, print_json
from eval.clip_fid.score import KINEMATIC, Protocol
from eval.sets.motions import RealMotion, real_motion, training_motion
from eval.sets.sets import Ragged
from motionkit.core.motion import Motion
from motionkit.edit.plant import Change, measure_change
from motionkit.fields.contact.planted import planted_frames
from motionkit.fields.motion_field import Observation
from motionkit.store import Store

PROTOCOL = Protocol(num_clips=2048, replications=6, resamplings=0)
SHOWN = 5


def planted_takes(real: RealMotion) -> tuple[RealMotion, list[Change]]:
    """The planted takes, and the changes."""
    made, changes = [], []
    for number, fps in enumerate(real.fps):
        motion = Motion.from_joints(np.asarray(real.sequences[number]), fps)
        planting, times = planted_frames(Observation.of(motion), motion.timegrid), motion.timegrid.seconds()
        changes.append(measure_change(planting, times)[0])
        made.append(planting(times).joint_positions)
    about = (real.fps, real.sequence_ids, real.captions, real.actions)
    return RealMotion(f"{real.name}, planted", Ragged.of(made), *about), changes


def scores(store: Store, split: str, framerates: list[Fraction]) -> tuple[dict[str, Any], dict[str, Any]]:
    """By framerate the floor, the score of planted takes, and the ratio; and the changes."""
    real = real_motion(store, split)
    train = training_motion(store, real)
    planted, changes = planted_takes(real)
    table: dict[str, Any] = {}
    for fps in framerates:
        comparison = KINEMATIC.comparison(real.at(fps), train.at(fps), PROTOCOL)
        found = comparison.scores({"floor": real.at(fps), "planted": planted.at(fps)})
        row = {name: float(score.value) for name, score in found.items()}
        table[f"{fps} fps"] = row | {"ratio": row["planted"] / row["floor"]}
    order = sorted(range(len(changes)), key=lambda number: -changes[number].largest_change)
    largest = [(real.sequence_ids[number], 1000.0 * changes[number].largest_change) for number in order]
    means = 1000.0 * np.mean([each.mean_change for each in changes])
    moved = {"takes": len(changes), "mean mm": float(means), "largest mm": dict(largest[:SHOWN])}
    moved["median of the largest mm"] = float(np.median([each for _, each in largest]))
    return table, moved


def main() -> None:
    """Print the figures."""
    parser = arguments_parser(__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("--split", default="test")
    parser.add_argument("--fps", default="20,60,120")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    framerates = [Fraction(each) for each in arguments.fps.split(",")]
    table, moved = scores(Store.open(arguments.store), arguments.split, framerates)
    if arguments.json:
        print_json({"clip-FID": table, "moved": moved})
        return
    print("| | floor | planted | multiple of the floor |\n|---|---|---|---|")
    for name, row in table.items():
        print(f"| {name} | {row['floor']:.3f} | {row['planted']:.3f} | {row['ratio']:.2f} |")
    print(f"\n{moved}")


if __name__ == "__main__":
    main()
