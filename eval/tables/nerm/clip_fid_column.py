"""One framerate of Table 2: the real set, what is made of it, what a model and other systems have for it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING

from eval.baselines.low_pass import low_passed
from eval.baselines.upsampled import upsampled
from eval.baselines.vectors import upsample_as_vectors
from eval.sample_folder import SampleFolder
from eval.samples.generated import Window, sample_fields
from eval.samples.real import NoRealMotionError, RealMotion
from eval.samples.sets import SampleSet
from motionkit.motionfield import MotionField

if TYPE_CHECKING:
    from rich.progress import Progress

LOW_FPS = Fraction(20)
P1 = "real, independent draws (P1)"
P2 = "real, disjoint halves of the takes (P2)"
SLERP = "real kept at 20 fps, SLERP"
VECTORS = "real kept at 20 fps, as vectors (handicapped)"
REFERENCES = (P1, P2, SLERP, VECTORS)
NERM = "NeRM"
NERM_SLERP = "NeRM generated at 20 fps, SLERP"


@dataclass(frozen=True, eq=False)
class Column:
    """Everything that one framerate's numbers are made of; `train` is None where there is no training motion."""

    fps: Fraction
    real: SampleSet
    rows: Mapping[str, SampleSet]
    train: SampleSet | None

    @property
    def others(self) -> dict[str, SampleSet]:
        """The rows that are not made of the real set."""
        return {name: samples for name, samples in self.rows.items() if name not in REFERENCES}

    @property
    def label(self) -> str:
        """Its name in a table."""
        return framerate_label(self.fps)

    @property
    def size(self) -> "ColumnSize":
        """What remains to be said of it when its motions are gone."""
        generated = self.rows[NERM].num_sequences if NERM in self.rows else None
        return ColumnSize(self.fps, self.real.num_sequences, self.real.duration_seconds, generated)

    def low_passed(self, cutoff_hz: float | None) -> "Column":
        """The same column with every set smoothed alike; itself where no cut-off is given."""
        if cutoff_hz is None:
            return self
        return Column(
            self.fps,
            low_passed(self.real, cutoff_hz),
            {name: low_passed(samples, cutoff_hz) for name, samples in self.rows.items()},
            None if self.train is None else low_passed(self.train, cutoff_hz),
        )


@dataclass(frozen=True)
class ColumnSize:
    """How much real motion a column has, and how many generated motions; None where there are none."""

    fps: Fraction
    num_sequences: int
    duration_seconds: float
    num_generated: int | None

    @property
    def label(self) -> str:
        """Its name in a table."""
        return framerate_label(self.fps)


def make_column(
    fps: Fraction,
    real: RealMotion,
    train: RealMotion,
    fields: Mapping[Window, MotionField],
    samples: Mapping[str, SampleSet],
    missing: list[str],
) -> Column:
    """Everything for one framerate; a model that has no motion for it is named in `missing`.

    Raises `NoRealMotionError` where too few sequences are as fast.
    """
    reference = real.at(fps)
    rows = {P1: reference}
    if fps >= LOW_FPS:
        low = _same_sequences(real.at(LOW_FPS), reference)
        rows[SLERP] = upsampled(low, fps, SLERP)
        rows[VECTORS] = upsample_as_vectors(low, fps, VECTORS)
    native = sample_fields(fields, reference.sequence_ids, fps, NERM)
    if native is not None:
        rows[NERM] = native
    elif fields:
        missing.append(f"{NERM}, {framerate_label(fps)}: no generated motion is for a sequence this fast")
    coarse = sample_fields(fields, reference.sequence_ids, LOW_FPS, NERM_SLERP)
    if coarse is not None and fps >= LOW_FPS:
        rows[NERM_SLERP] = upsampled(coarse, fps, NERM_SLERP)
    rows |= samples
    try:
        training = train.at(fps)
    except NoRealMotionError:
        training = None
    return Column(fps, reference, rows, training)


def samples_at(folders: Sequence[SampleFolder], fps: Fraction, display: "Progress") -> dict[str, SampleSet]:
    """Every folder's motions at a framerate, by name."""
    made = {}
    for folder in folders:
        task = display.add_task(f"{folder.name}, {framerate_label(fps)}", total=folder.num_motions, note="")
        made[folder.name] = folder.at(fps, partial(display.advance, task))
        display.remove_task(task)
    return made


def _same_sequences(low: SampleSet, reference: SampleSet) -> SampleSet:
    place = {sequence_id: index for index, sequence_id in enumerate(low.sequence_ids)}
    return low.select([place[sequence_id] for sequence_id in reference.sequence_ids])


def framerate_label(fps: Fraction | str) -> str:
    """`20 fps`, `12.5 fps` for a framerate, or for the paper's `20fps`."""
    if isinstance(fps, Fraction):
        return f"{float(fps):.5g} fps"
    return f"{fps.removesuffix('fps').strip()} fps"
