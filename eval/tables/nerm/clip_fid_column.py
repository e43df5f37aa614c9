"""One framerate of Table 2: the real set, what is made of it, what a model and other systems have for it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

from eval.baselines.low_pass import low_passed
from eval.baselines.upsampled import upsampled
from eval.baselines.vectors import upsample_as_vectors
from eval.sample_folder import SampleFolder
from eval.samples.generated import Window, sample_fields
from eval.samples.real import NoRealMotionError, RealMotion
from eval.samples.sets import SampleSet
from motionkit.core.progress import OnProgress, task
from motionkit.motionfield import MotionField

LOW_FPS = Fraction(20)
P1 = "real, independent draws (P1)"
P2 = "real, disjoint halves of the takes (P2)"
SLERP = "real kept at 20 fps, SLERP"
VECTORS = "real kept at 20 fps, as vectors (handicapped)"
REFERENCES = (P1, P2, SLERP, VECTORS)
GENERATED_LOW = "{} generated at 20 fps, SLERP"
"""The row of a model's motions that were asked for at 20 fps, then upsampled like the real ones."""

# A model's motions for stretches of real sequences, by the model's name.
ModelFields = Mapping[str, Mapping[Window, MotionField]]


@dataclass(frozen=True, eq=False)
class Column:
    """Everything that one framerate's numbers are made of; `train` is None where there is no training motion.

    `models` are the rows that models generated at this framerate, `samples` those of other systems.
    """

    fps: Fraction
    real: SampleSet
    rows: Mapping[str, SampleSet]
    train: SampleSet | None
    models: tuple[str, ...] = ()
    samples: tuple[str, ...] = ()

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
        generated = {name: self.rows[name].num_sequences for name in self.models}
        return ColumnSize(self.fps, self.real.num_sequences, self.real.duration_seconds, generated)

    def low_passed(self, cutoff_hz: float | None) -> "Column":
        """The same column with every set smoothed alike; itself where no cut-off is given."""
        if cutoff_hz is None:
            return self
        return replace(
            self,
            real=low_passed(self.real, cutoff_hz),
            rows={name: low_passed(samples, cutoff_hz) for name, samples in self.rows.items()},
            train=None if self.train is None else low_passed(self.train, cutoff_hz),
        )


@dataclass(frozen=True)
class ColumnSize:
    """How much real motion a column has, and how many motions each model generated for it."""

    fps: Fraction
    num_sequences: int
    duration_seconds: float
    num_generated: Mapping[str, int]

    @property
    def label(self) -> str:
        """Its name in a table."""
        return framerate_label(self.fps)


def make_column(
    fps: Fraction,
    real: RealMotion,
    train: RealMotion,
    fields: ModelFields,
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
    models = []
    for name, own in fields.items():
        native = sample_fields(own, reference.sequence_ids, fps, name)
        if native is None:
            missing.append(f"{name}, {framerate_label(fps)}: no generated motion is for a sequence this fast")
            continue
        rows[name] = native
        models.append(name)
        coarse_name = GENERATED_LOW.format(name)
        coarse = sample_fields(own, reference.sequence_ids, LOW_FPS, coarse_name)
        if coarse is not None and fps >= LOW_FPS:
            rows[coarse_name] = upsampled(coarse, fps, coarse_name)
    rows |= samples
    try:
        training = train.at(fps)
    except NoRealMotionError:
        training = None
    return Column(fps, reference, rows, training, tuple(models), tuple(samples))


def samples_at(folders: Sequence[SampleFolder], fps: Fraction, on_progress: OnProgress) -> dict[str, SampleSet]:
    """Every folder's motions at a framerate, by name."""
    made = {}
    for folder in folders:
        with task(on_progress, f"{folder.name}, {framerate_label(fps)}", folder.num_motions) as work:
            made[folder.name] = folder.at(fps, work.advance)
    return made


def _same_sequences(low: SampleSet, reference: SampleSet) -> SampleSet:
    place = {sequence_id: index for index, sequence_id in enumerate(low.sequence_ids)}
    return low.select([place[sequence_id] for sequence_id in reference.sequence_ids])


def framerate_label(fps: Fraction | str) -> str:
    """`20 fps`, `12.5 fps` for a framerate, or for the paper's `20fps`."""
    if isinstance(fps, Fraction):
        return f"{float(fps):.5g} fps"
    return f"{fps.removesuffix('fps').strip()} fps"
