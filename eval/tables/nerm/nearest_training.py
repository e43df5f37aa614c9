"""Table 2's last block: how far motions are from the nearest training motion, generated beside held-out real ones."""

from collections.abc import Mapping

import numpy as np

from eval.report.results import Block, Cell, Origin, Row
from eval.samples.sets import SampleSet
from eval.scoring.memorisation import STRETCH_SECONDS, distances_to_training
from motionkit.mirror import mirror_positions
from motionkit.skeleton import SMPL22

SHARES = {"nearest": 0.0, "5 %": 0.05, "25 %": 0.25, "50 %": 0.5, "75 %": 0.75, "95 %": 0.95}
TITLE = "Distance to the nearest training motion (mm)"
HELD_OUT = "real, held out"
MIRRORED = ", mirrored"
NOTE = (
    f"The middle {STRETCH_SECONDS:g} s of each motion against every {STRETCH_SECONDS:g} s of the training split at 10 "
    "poses a second: joints relative to the root, every pose turned to face the same way, mean joint distance to the "
    "nearest stretch. A column holds the distance within which that share of the motions lies. A copy that a model "
    "makes is as far from its original as the model reconstructs (Table 4); motions about as far as held-out real ones "
    'are no copies. The rows "mirrored" are of mirror images: a model that learnt from mirrored motion may copy that '
    "(docs/metrics.md)."
)


def nearest_training_block(
    held_out: SampleSet, training: SampleSet, others: Mapping[str, SampleSet], notes: Mapping[str, str]
) -> Block:
    """Quantiles of the distance to the nearest training motion, in millimetres; all sets at 20 fps.

    Sets without a motion of 2 s have no row. Raises `ValueError` where the training motion has none.
    """
    rows = []
    for name, samples in {HELD_OUT: held_out, **others}.items():
        origin: Origin = "reference" if name == HELD_OUT else "ours"
        rows.append(_row(name, origin, samples, training, notes.get(name, "")))
        rows.append(_row(name + MIRRORED, origin, _mirrored(samples), training, ""))
    return Block(TITLE, tuple(SHARES), tuple(row for row in rows if row.cells), lower_is_better=False, note=NOTE)


def _mirrored(samples: SampleSet) -> SampleSet:
    images = [mirror_positions(sequence, SMPL22.left_right_pairs) for sequence in samples.sequences()]
    return samples.with_positions(samples.name, samples.fps, images)


def _row(name: str, origin: Origin, samples: SampleSet, training: SampleSet, note: str) -> Row:
    millimetres = 1000.0 * distances_to_training(samples, training)
    if not millimetres.size:
        return Row(name, origin, {})
    cells = {label: Cell(float(np.quantile(millimetres, share))) for label, share in SHARES.items()}
    return Row(name, origin, cells, f"{len(millimetres)} motions" + (f"; {note}" if note else ""))
