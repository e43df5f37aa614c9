"""Table 2's last block: how far motions are from the nearest training motion, generated beside held-out real ones."""

from collections.abc import Mapping

import numpy as np

from eval.memorisation import STRETCH_SECONDS, distances_to_training
from eval.report.results import Block, Cell, Origin, Row
from eval.samples import SampleSet

SHARES = {"nearest": 0.0, "5 %": 0.05, "25 %": 0.25, "50 %": 0.5, "75 %": 0.75, "95 %": 0.95}
TITLE = "Distance to the nearest training motion (mm)"
HELD_OUT = "real, held out"
NOTE = (
    f"The middle {STRETCH_SECONDS:g} s of each motion against every {STRETCH_SECONDS:g} s of the training split at 10 "
    "poses a second: joints relative to the root, every pose turned to face the same way, mean joint distance to the "
    "nearest stretch. A column holds the distance within which that share of the motions lies. A copy that a model "
    "makes is as far from its original as the model reconstructs (Table 4); motions about as far as held-out real ones "
    "are no copies (docs/metrics.md)."
)


def nearest_training_block(
    held_out: SampleSet, training: SampleSet, others: Mapping[str, SampleSet], notes: Mapping[str, str]
) -> Block:
    """Quantiles of the distance to the nearest training motion, in millimetres; all sets at 20 fps.

    Sets without a motion of 2 s have no row. Raises `ValueError` where the training motion has none.
    """
    rows = [_row(HELD_OUT, "reference", held_out, training, "")]
    rows += [_row(name, "ours", samples, training, notes.get(name, "")) for name, samples in others.items()]
    return Block(TITLE, tuple(SHARES), tuple(row for row in rows if row.cells), lower_is_better=False, note=NOTE)


def _row(name: str, origin: Origin, samples: SampleSet, training: SampleSet, note: str) -> Row:
    millimetres = 1000.0 * distances_to_training(samples, training)
    if not millimetres.size:
        return Row(name, origin, {})
    cells = {label: Cell(float(np.quantile(millimetres, share))) for label, share in SHARES.items()}
    return Row(name, origin, cells, f"{len(millimetres)} motions" + (f"; {note}" if note else ""))
