"""Generated motions before and after planting: displacement, foot skating and penetration; pages of both.

    python benchmarks/nerm/planting.py RUN --store STORE [--motions 20] [--seed 0] [--pages DIR] [--json]

Takes of the test split that have captions are drawn by the seed (in the order of md5 of "ID seed 0"); each gives its
first caption and its length, up to l_max. Motions are made as `motionkit generate` makes them and looked at at 60 fps.
Of each: the largest change of a joint, in the world and beside the pelvis; how fast feet slide in the contacts that
planting found, and by the metric of the physical table, beside the take itself; how far a foot joint is below its
floor, and below the ground of the planted motion by the physical table's (its lowest joint is lower 5 % of the time).
"""

import argparse
import hashlib
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.command import arguments_parser, print_json
from eval.metrics.physical import ground_height, slide_speed
from eval.sets.real import RealMotion, real_motion
from motionkit.core.motion import Motion
from motionkit.edit.plant import measure_change
from motionkit.fields.contact.planted import Planting
from motionkit.fields.motion_field import DerivedField, to_motion
from motionkit.generate.models import GenerationRequest, SamplingOptions
from motionkit.generate.output import motion_name, plant_generated
from motionkit.store import Store
from motionkit.viz.player import panel_of, write_page
from nerm.model import load

FPS = Fraction(60)
COLUMNS = {
    "seconds": "s",
    "moved": "moved, mm",
    "moved_pose": "of the pose, mm",
    "sliding_before": "contacts slide, cm/s",
    "sliding_after": "planted",
    "skating_before": "skating, cm/s",
    "skating_after": "planted",
    "skating_real": "the take",
    "below_before": "below the floor, mm",
    "below_after": "planted",
    "below_ground": "by the table's ground",
}


def drawn(real: RealMotion, count: int, seed: int) -> list[int]:
    """Numbers of takes with captions, in an order that depends on their ids and the seed alone."""
    captioned = [number for number, caption in enumerate(real.captions) if caption]
    captioned.sort(key=lambda number: hashlib.md5(f"{real.sequence_ids[number]} seed {seed}".encode()).hexdigest())
    return captioned[:count]


def skating(positions: np.ndarray, fps: Fraction) -> float | None:
    """Skating in cm/s; None if feet are never on the ground."""
    speed = slide_speed(positions, fps)
    return None if speed is None else 100.0 * speed


def figures_of(planting: Planting, before: Motion, after: Motion) -> dict[str, float | None]:
    """Figures of one motion; lengths in mm, speeds in cm/s."""
    change, _ = measure_change(planting, before.timegrid.seconds())
    metres_a_second = (change.sliding_before, change.sliding_after)
    slides = [None if each is None else 100.0 * each for each in metres_a_second]
    return {
        "seconds": before.duration_seconds,
        "moved": 1000.0 * change.largest_change,
        "moved_pose": 1000.0 * change.largest_pose_change,
        "sliding_before": slides[0],
        "sliding_after": slides[1],
        "skating_before": skating(before.joint_positions, FPS),
        "skating_after": skating(after.joint_positions, FPS),
        "below_before": 1000.0 * change.below_ground_before,
        "below_after": 1000.0 * change.below_ground_after,
        "below_ground": ground_height(after.joint_positions, FPS) - 1000.0 * float(after.joint_positions[..., 1].min()),
    }


def rows_of(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """A row for each motion; writes its page."""
    model, real = load(arguments.run), real_motion(Store.open(arguments.store), "test")
    rows = []
    for index, number in enumerate(drawn(real, arguments.motions, arguments.seed)):
        take, fps = np.asarray(real.sequences[number]), real.fps[number]
        seconds = min(float(len(take) / fps), model.max_duration_seconds - 0.2)
        request = GenerationRequest(seconds, real.captions[number])
        sampling = SamplingOptions(arguments.guidance, steps=arguments.steps)
        [field] = model.generate([request], seed=arguments.seed, first=index, sampling=sampling)
        shown = plant_generated(field, (request,))
        assert isinstance(shown, DerivedField) and isinstance(shown.compute, Planting)
        before, after = to_motion(field, FPS), to_motion(shown, FPS)
        row = {"caption": request.text, "take": real.sequence_ids[number], **figures_of(shown.compute, before, after)}
        rows.append(row | {"skating_real": skating(take[: int(seconds * fps)], fps)})
        if arguments.pages is not None:
            arguments.pages.mkdir(parents=True, exist_ok=True)
            path = arguments.pages / f"{motion_name(index, (request,))}.html"
            write_page(path, f"{index}: {request.text}", [panel_of(before, "as generated"), panel_of(after, "planted")])
    return rows


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("--store", type=Path, required=True)
    parser.add_argument("--motions", type=int, default=20)
    parser.add_argument("--steps", type=int)
    parser.add_argument("--guidance", type=float)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--pages", type=Path)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rows = rows_of(arguments)
    known = {key: [row[key] for row in rows if row[key] is not None] for key in COLUMNS}
    summary = {
        name: {key: float(each(values)) for key, values in known.items()}
        for name, each in (("mean", np.mean), ("largest", np.max))
    }
    if arguments.json:
        print_json({"rows": rows, **summary}, runs=[arguments.run])
        return
    print(f"| | {' | '.join(('caption', *COLUMNS.values()))} |\n|{'---|' * (len(COLUMNS) + 2)}")
    for number, row in [*enumerate(rows), *((name, {"caption": "", **row}) for name, row in summary.items())]:
        cells = ["–" if row[key] is None else f"{row[key]:.1f}" for key in COLUMNS]
        print(f"| {number} | {row['caption']} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
