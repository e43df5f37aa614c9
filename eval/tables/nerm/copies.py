"""A table's block on copies of training motion."""

from collections.abc import Mapping

import numpy as np

from eval.report.results import Block, Cell, Origin, Row
from eval.sets.copies import HELD_OUT_SHARE, STILL_METRES, TrainingWindows, held_out_limit
from eval.sets.row_ids import REAL, RowId, Variant
from eval.sets.sets import SampleSet

TITLE = "Copies of training motion"
HELD_OUT = RowId(REAL.system, Variant.HELD_OUT)
COPIED = "copied (%)"
SHARES = {"nearest (mm)": 0.0, "5 % (mm)": 0.05, "25 % (mm)": 0.25, "50 % (mm)": 0.5, "95 % (mm)": 0.95}
MAX_MOTIONS = 60
NOTE = (
    "The nearest training motion to every second of a motion, whatever its body, tempo (0.8 to 1.25) and side. Copied "
    f"are windows that are nearer, for how much they move, than {HELD_OUT_SHARE:.0%} of held-out real motion's are. "
    f"Windows that move less than {1000 * STILL_METRES:g} mm say nothing and are left out. The last columns hold the "
    "distance within which that share of the windows has training motion. A copy that a model makes is as far from its "
    "original as the model reconstructs (Table 4), so where that is more than about 10 mm read these beside held-out "
    f"motion's. Of rows with more than {MAX_MOTIONS} motions, {MAX_MOTIONS} random ones are looked at."
)


def copies_block(
    held_out: SampleSet, training: SampleSet, others: Mapping[RowId, SampleSet], notes: Mapping[RowId, str]
) -> Block:
    """The share of windows that are copies, and quantiles of the distance to training motion.

    Sets without a moving second have no row. Raises `ValueError` where the training motion is too short.
    """
    windows = TrainingWindows.of(training)
    found = {row: windows.nearest(_some(samples)) for row, samples in {HELD_OUT: held_out, **others}.items()}
    limit, rows = held_out_limit(found[HELD_OUT]), []
    for row, nearest in found.items():
        if not len(nearest.distance):
            continue
        cells = {COPIED: Cell(100.0 * float(nearest.is_copied(limit).mean()))}
        cells |= {label: Cell(1000.0 * float(np.quantile(nearest.distance, share))) for label, share in SHARES.items()}
        origin: Origin = "reference" if row == HELD_OUT else "ours"
        count = f"{len(np.unique(nearest.motion))} motions, {len(nearest.distance)} windows"
        rows.append(Row(str(row), origin, cells, "; ".join(filter(None, (count, notes.get(row, ""))))))
    return Block(TITLE, (COPIED, *SHARES), tuple(rows), note=NOTE, provenance={"limit": limit})


def _some(samples: SampleSet) -> SampleSet:
    return samples.select(np.sort(np.random.default_rng(0).permutation(samples.num_sequences)[:MAX_MOTIONS]))
