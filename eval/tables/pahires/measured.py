"""One data set's interpolation figures by row, cached in RESULTS/parts."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eval.completion.blocks import Scope
from eval.completion.encoders import Completer
from eval.completion.interpolation import InterpolationTask, measure_interpolation, measured_metrics, num_batches
from eval.completion.protocol import VERSION, InterpolationProtocol, scale_label
from eval.completion.scores import Scores, TakeSums, measure_scale, split_remark
from eval.completion.takes import DataSet, NoTakesError, TrueClips, open_clips, shared_reason
from eval.metrics.metric import MeanSums
from eval.report.results import Cell
from eval.sets.partial import PartialResult, collect
from eval.tables.parts import Part, find_part, keep_part
from eval.tables.registry import TableRequest
from motionkit.core.progress import task, warn

WEIGHT = "weight"


def find_scores(
    results: Path, name: str, terms: Mapping[str, Any], metrics: Collection[str], columns: Collection[str]
) -> Scores | None:
    """The cached scores of these metrics and columns for the terms; None if there are none."""
    part = find_part(results, _name(name), terms)
    if part is None:
        return None
    try:
        return {metric: {column: _means(part.rows[f"{metric} {column}"]) for column in columns} for metric in metrics}
    except KeyError as error:
        warn(f"a kept part of {name} lacks {error}: computing it anew")
        return None


def _means(cells: Mapping[str, Cell]) -> TakeSums:
    return {take: MeanSums().added(cell.value, cell.details[WEIGHT]) for take, cell in cells.items()}


def keep_scores(results: Path, name: str, terms: Mapping[str, Any], scores: Scores) -> None:
    """Write scores for `find_scores`: means of every take, and their weights."""
    rows = {
        f"{metric} {column}": {take: Cell(sums.mean, None, {WEIGHT: sums.weight}) for take, sums in means.items()}
        for metric, columns in scores.items()
        for column, means in columns.items()
    }
    keep_part(results, _name(name), terms, Part(rows))


def _name(table: str) -> str:
    return f"{table}-means-by-take"


if TYPE_CHECKING:
    from motionkit.store.reader import Store


@dataclass(frozen=True, eq=False)
class Measured:
    """One data set's figures by row, and remarks."""

    data_set: DataSet
    clips: TrueClips
    rows: dict[str, Scores]
    remarks: tuple[str, ...] = ()

    @property
    def scope(self) -> Scope:
        """The clips' scope for blocks."""
        return Scope(self.data_set.label, self.data_set.fps, self.rows)


def measure_all(
    store: "Store",
    data_sets: Sequence[DataSet],
    scales: Sequence[Fraction],
    completers: Sequence[Completer],
    request: TableRequest,
) -> PartialResult[list[Measured]]:
    """The figures of every data set that has clips; raises `NoTakesError` if none has."""
    found = collect(
        data_sets,
        lambda data_set: _measure(store, data_set, scales, completers, request),
        lambda data_set: data_set.label,
        (NoTakesError,),
    )
    if not found.value:
        raise NoTakesError(shared_reason(found.missing))
    measured = list(found.value.values())
    failed = [line for each in measured for line in each.missing]
    return PartialResult([each.value for each in measured], (*failed, *found.missing))


def _measure(
    store: "Store",
    data_set: DataSet,
    scales: Sequence[Fraction],
    completers: Sequence[Completer],
    request: TableRequest,
) -> PartialResult[Measured]:
    """A data set's figures; those cached for the same terms are read from RESULTS/parts.

    Raises `NoTakesError` if the compared split has no clip.
    """
    protocol = InterpolationProtocol()
    clips = open_clips(
        store, data_set, request.real.split, request.real.where, protocol.clip_frames, protocol.clip_frames
    )
    remarks, missing = [], []
    try:
        training = open_clips(store, data_set, "train", None, protocol.clip_frames, protocol.clip_frames)
    except NoTakesError:
        training = clips
        remarks.append(f"{data_set.label} has no training split: its deviations are those of the compared clips.")
    terms = {
        "version": VERSION,
        "store": store.fingerprint,
        "data set": [data_set.column, data_set.value, str(data_set.fps)],
        "split": request.real.split,
        "where": request.real.where,
        "scales": [str(scale) for scale in scales],
    }
    rows: dict[str, Scores] = {}
    for completer in completers:
        of_row = {**terms, "encoder": completer.fingerprint}
        kept = find_scores(request.results, "interpolation", of_row, measured_metrics(), list(map(scale_label, scales)))
        if kept is not None:
            rows[completer.name] = kept
    wanted = [completer for completer in completers if completer.name not in rows]
    if wanted:
        asked = InterpolationTask(clips, measure_scale(training), protocol)
        note = f"{clips.num_clips} clips"
        with task(request.on_progress, data_set.label, num_batches(clips), note=note) as work:
            made, failed = measure_interpolation(asked, scales, wanted, work.advance)
        for completer in wanted:
            if completer.name in made:
                scores = rows[completer.name] = made[completer.name]
                keep_scores(request.results, "interpolation", {**terms, "encoder": completer.fingerprint}, scores)
        missing += [f"{data_set.label}, {name}: {why}" for name, why in failed.items()]
    remarks.append(_clips_remark(data_set, clips))
    remarks.append(f"{data_set.label}: {split_remark(store, clips, request.real.split)}")
    ordered = {completer.name: rows[completer.name] for completer in completers if completer.name in rows}
    return PartialResult(Measured(data_set, clips, ordered, tuple(remarks)), tuple(missing))


def _clips_remark(data_set: DataSet, clips: TrueClips) -> str:
    left_out = {
        f"shorter than {clips.num_frames} frames": clips.num_short,
        "of framerates that are no multiple of the table's": clips.num_other_fps,
    }
    reasons = " and ".join(f"{count:,} {why}" for why, count in left_out.items() if count)
    return f"{data_set.label}: {clips.num_clips:,} clips of {clips.num_takes:,} takes" + (
        f"; left out are {reasons}." if reasons else "."
    )
