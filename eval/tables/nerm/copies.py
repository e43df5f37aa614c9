"""A table's block on copies of training motion."""

from collections.abc import Mapping
from dataclasses import asdict

import numpy as np

from eval.report.results import Block, Cell, Origin, Row
from eval.sets.copies import STRETCH_SECONDS, TrainingMotion, nearest_training
from eval.sets.memorisation import (
    ACCUSED_HELD_OUT,
    ACCUSED_SHARE,
    STILL_BONES,
    Limits,
    copied,
    moving,
    verdicts,
)
from eval.sets.row_ids import REAL, RowId, Variant
from eval.sets.sets import SampleSet

TITLE = "Copies of training motion"
HELD_OUT = RowId(REAL.system, Variant.HELD_OUT)
ACCUSED = "accused (%)"
COPIED = {seconds: f"copied, {seconds:g} s (%)" for seconds in STRETCH_SECONDS}
SHARES = {"nearest (mm)": 0.0, "5 % (mm)": 0.05, "25 % (mm)": 0.25, "50 % (mm)": 0.5, "95 % (mm)": 0.95}
DISTANCE_SECONDS = 1.0
MOST_MOTIONS = 60
NOTE = (
    "The nearest training stretch to every stretch of 0.5, 1 and 2 s, whatever body, tempo (0.8 to 1.25), side and "
    "direction it has. Copied are the stretches that are nearer, for how much they move, than held-out motion of this "
    f"store comes; accused are the motions with more than {ACCUSED_SHARE:.0%} of their stretches of one length copied, "
    f"{ACCUSED_HELD_OUT:.0%} of held-out motions at the most. "
    f"Stretches that move less than {1000 * STILL_BONES:g} mm say nothing and are left out. The last columns hold the "
    f"distance within which that share of the stretches of {DISTANCE_SECONDS:g} s has training motion: a copy that a "
    "model makes is as far from its original as the model reconstructs (Table 4), so where that is more than about "
    "10 mm read these beside held-out motion's (docs/metrics.md). "
    f"Of rows with more than {MOST_MOTIONS} motions, {MOST_MOTIONS} random ones are looked at."
)


def copies_block(
    held_out: SampleSet,
    training: TrainingMotion,
    limits: Limits,
    others: Mapping[RowId, SampleSet],
    notes: Mapping[RowId, str],
) -> Block:
    """Shares of motions and stretches that are copies by the limits, and quantiles of the distance to training motion.

    Sets without a motion of half a second have no row; of large ones, 60 random motions are looked at. Raises
    `ValueError` where the training motion is too short.
    """
    rows = []
    for row, samples in {HELD_OUT: held_out, **others}.items():
        origin: Origin = "reference" if row == HELD_OUT else "ours"
        chosen = np.random.default_rng(0).permutation(samples.num_sequences)[:MOST_MOTIONS]
        rows.append(_row(str(row), origin, samples.select(np.sort(chosen)), training, limits, notes.get(row, "")))
    columns = (ACCUSED, *COPIED.values(), *SHARES)
    return Block(
        TITLE,
        columns,
        tuple(row for row in rows if row.cells),
        note=f"{NOTE} The limits are {limits}.",
        provenance={"limits": asdict(limits)},
    )


def _row(name: str, origin: Origin, samples: SampleSet, training: TrainingMotion, limits: Limits, note: str) -> Row:
    found = nearest_training(samples, training)
    result = verdicts(found, samples.num_sequences, limits)
    number = int(result.decidable.sum())
    still = f"{samples.num_sequences - number} motions too still or short to tell"
    remarks = "; ".join(filter(None, (f"{number} motions", still if number < samples.num_sequences else "", note)))
    if not number:
        return Row(name, origin, {}, remarks)
    cells = {ACCUSED: Cell(100.0 * float(result.accused[result.decidable].mean()))}
    for nearest in found:
        chosen = moving(nearest)
        if not chosen.any():
            continue
        cells[COPIED[nearest.seconds]] = Cell(100.0 * float(copied(nearest, limits)[chosen].mean()))
        if nearest.seconds == DISTANCE_SECONDS:
            metres = nearest.distance[chosen]
            cells |= {label: Cell(1000.0 * float(np.quantile(metres, share))) for label, share in SHARES.items()}
    return Row(name, origin, cells, remarks)
