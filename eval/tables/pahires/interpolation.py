"""PA-HiRes' tables of interpolation: at integer and other scales (1 and 2), and ablations at ×4 (4, Figures 5 and 6).

An ablation's variant is a cell; its entry names row and column. If it was trained from several seeds its number is
their mean, and a block shows them one by one. Variants that are not trained have no number; a note names the command
that trains them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from statistics import fmean
from typing import Any

from eval.completion.data_sets import (
    DataSet,
    NoTakesError,
    TrueClips,
    data_sets_of,
    open_clips,
    shared_reason,
    split_remark,
)
from eval.completion.encoders import INTERPOLATION, Completer, completer_of, trained_completers
from eval.completion.interpolation import (
    CEILING_DB,
    CLIP_FRAMES,
    INTEGER_SCALES,
    NUM_GIVEN,
    OTHER_SCALES,
    TIMED_METRICS,
    VERSION,
    measure_interpolation,
    measure_scale,
    scale_label,
)
from eval.completion.scores import Scope, Scores, Shown, blocks_of, shown_measure, with_pools
from eval.config import EvalConfig
from eval.metrics.metric import find_metric
from eval.report.results import Block, Cell, Row
from eval.tables.ablation_runs import ablate_command, find_ablations, trained_runs
from eval.tables.table import SOURCES, Content, Reported, Table, cached, printed_block, reported_figures
from motionkit.core.errors import MotionkitError
from motionkit.core.progress import task
from motionkit.edit.encoders import installed_encoders
from motionkit.store.reader import Store
from motionkit.training.ablations import Ablation
from motionkit.training.run import RunFolder, recorded_settings

METRICS = {
    "psnr": "PSNR (dB)",
    "ssim": "SSIM",
    "mpjpe_global": "MPJPE (cm)",
    "acceleration_error": "acceleration error (m/s²)",
}
ABLATED_METRICS = ("psnr", "ssim", "acceleration_error")
SMALL_TAKES = 100
NOTES = (
    "± is half the 95 % interval over takes: all clips of a take are resampled together.",
    "The paper defines neither the pose vector nor PSNR and SSIM of motion: orders and gaps of methods may be compared "
    "with it, decibels may not (docs/metrics.md).",
    "Interpolators need no training and may win; then a trained row is not worth its training at that scale.",
)
PAHIRES = find_ablations("pahires")
STAGE = next(iter(PAHIRES.stages))
SCALE = Fraction(4)
REFERENCES = tuple(row for row in INTERPOLATION if row.name in ("SLERP", "cubic spline"))
PRINTED_TITLES = {"psnr_db": "PSNR (dB)", "ssim": "SSIM"}


@dataclass(frozen=True, eq=False)
class Measured:
    """One data set's figures by row, and remarks."""

    data_set: DataSet
    clips: TrueClips
    rows: dict[str, Scores]
    remarks: tuple[str, ...]

    @property
    def scope(self) -> Scope:
        """The clips' scope for blocks."""
        return Scope(self.data_set.label, self.data_set.fps, self.rows)


def compute(scales: Sequence[Fraction], table: str, config: EvalConfig, store: Store) -> Content:
    """All rows of all data sets of the store, and which are not available.

    Raises `NoTakesError` if no data set has takes, and `UsageError` for an unknown encoder.
    """
    store.select(config.condition)  # raises at once for SQL that is wrong
    trained = trained_completers("interpolation", config.run, config.encoders, config.missing)
    completers = [*INTERPOLATION, *trained]
    measured = measure_all(store, data_sets_of(store, config.fps), scales, completers, config)
    labels = tuple(scale_label(scale) for scale in scales)
    scopes = with_pools([each.scope for each in measured], "clips")
    return Content(
        caption=_caption(measured, config),
        blocks=(*blocks_of(scopes, completers, Shown(labels, METRICS, _details())), *_printed(table, labels)),
        definition=_definition(),
        notes=(*(remark for each in measured for remark in each.remarks), *NOTES),
        provenance={
            "encoders": {completer.name: completer.fingerprint for completer in completers},
            "trained": {completer.name: completer.facts for completer in trained},
        },
    )


TABLE_1, TABLE_2 = (
    Table(
        "pahires",
        name,
        f"interpolation at {kind} scales",
        VERSION,
        partial(compute, scales, name),
        heading=f"PA-HiRes, Table {name}: interpolation at {heading} scales",
        shown=partial(installed_encoders, "interpolation"),
    )
    for name, kind, heading, scales in (
        ("1", "integer", "integer", INTEGER_SCALES),
        ("2", "other", "non-integer", OTHER_SCALES),
    )
)


def _details() -> dict[str, dict[str, str]]:
    """Further metrics, those of clips of joint positions among them."""
    names = ["rotation_angle_error", *(name for name in TIMED_METRICS if name not in METRICS)]
    titles = {}
    for metric in map(find_metric, names):
        title = metric.title[0].lower() + metric.title[1:]
        titles[metric.name] = f"{title} ({metric.unit})" if metric.unit else title
    return {"mpjpe_global": titles}


def measure_all(
    store: Store,
    data_sets: Sequence[DataSet],
    scales: Sequence[Fraction],
    completers: Sequence[Completer],
    config: EvalConfig,
) -> list[Measured]:
    """The figures of every data set that has clips; raises `NoTakesError` if none has."""
    measured, without = [], []
    for data_set in data_sets:
        try:
            measured.append(_measure(store, data_set, scales, completers, config))
        except NoTakesError as error:
            without.append(f"{data_set.label}: {error}")
    if not measured:
        raise NoTakesError(shared_reason(without))
    config.missing.add(*without)
    return measured


def _measure(
    store: Store,
    data_set: DataSet,
    scales: Sequence[Fraction],
    completers: Sequence[Completer],
    config: EvalConfig,
) -> Measured:
    """A data set's figures, cached; raises `NoTakesError` if the compared split has no clip."""
    clips = open_clips(store, data_set, config.split, config.where, CLIP_FRAMES, CLIP_FRAMES)
    remarks = []
    try:
        training = open_clips(store, data_set, "train", None, CLIP_FRAMES, CLIP_FRAMES)
    except NoTakesError:
        training = clips
        remarks.append(f"{data_set.label} has no training split: its deviations are those of the compared clips.")
    scale = measure_scale(training)
    terms = {
        "version": VERSION,
        "store": store.fingerprint,
        "data set": [data_set.column, data_set.value, str(data_set.fps)],
        "split": config.split,
        "where": config.where,
        "scales": [str(each) for each in scales],
    }
    rows: dict[str, Scores] = {}

    with task(config.on_progress, data_set.label, len(completers), note=f"{clips.num_clips} clips") as work:
        for completer in completers:
            with config.missing.skipping(f"{data_set.label}, {completer.name}", (MotionkitError, ValueError)):
                rows[completer.name] = cached(
                    config.results,
                    "interpolation",
                    {**terms, "encoder": completer.fingerprint},
                    partial(measure_interpolation, clips, scale, scales, completer),
                )
            work.advance()
    left_out = {
        f"shorter than {clips.num_frames} frames": clips.num_short,
        "of framerates that are no multiple of the table's": clips.num_other_fps,
    }
    reasons = " and ".join(f"{count:,} {why}" for why, count in left_out.items() if count)
    remarks.append(
        f"{data_set.label}: {clips.num_clips:,} clips of {clips.num_takes:,} takes"
        + (f"; left out are {reasons}." if reasons else ".")
    )
    remarks.append(f"{data_set.label}: {split_remark(store, clips, config.split)}")
    return Measured(data_set, clips, rows, tuple(remarks))


def _caption(measured: Sequence[Measured], config: EvalConfig) -> str:
    """The data of the numbers, with a remark on small samples."""
    counts = ", ".join(
        f"{each.clips.num_clips:,} clips of {each.clips.num_takes:,} takes of {each.data_set.label}"
        for each in measured
    )
    small = min(each.clips.num_takes for each in measured) < SMALL_TAKES
    return (
        f"Of every clip {NUM_GIVEN} real frames are given and all frames between them asked "
        f"for; no frame of the truth is interpolated. S{config.real[1:]}: {counts}."
        + (" **Small scale**: a data set of fewer than 100 takes says little about others." if small else "")
    )


def _definition() -> dict[str, Any]:
    return {"given_frames": NUM_GIVEN, "clip_frames": CLIP_FRAMES, "psnr_ceiling_db": CEILING_DB}


def _printed(table: str, columns: tuple[str, ...]) -> list[Block]:
    """The paper's figures, one block per data set and metric."""
    groups: dict[tuple[str, str], list[Reported]] = {}
    for figure in reported_figures("pahires", table):
        if figure.value is not None:
            groups.setdefault((figure.dataset, figure.metric), []).append(figure)
    return [
        printed_block(
            f"Printed in the PA-HiRes paper, {data_set}: {PRINTED_TITLES[metric]}",
            figures,
            lambda figure: "×" + figure.setting.removeprefix("x"),
            columns=columns,
            lower_is_better=False,
            note=f"Undefined pose vector, range and clips; trained for 1,000 epochs. Source: {SOURCES['pahires']}.",
        )
        for (data_set, metric), figures in groups.items()
    ]


# Trained runs by the entries' names, then by seed.
_Runs = Mapping[str, Mapping[int, RunFolder]]


def compute_ablation(ablation: Ablation, config: EvalConfig, store: Store) -> Content:
    """Scores of the runs RUN-VARIANT on every data set, at their training framerate.

    Raises `UsageError` without a run's name, or if none of the runs is trained, and as `compute`.
    """
    runs = trained_runs(PAHIRES, ablation.table, config.run, STAGE)
    assert config.run is not None
    store.select(config.condition)  # raises at once for SQL that is wrong
    trained = {name: of_entry for name, of_entry in runs.items() if of_entry}
    folders = list(dict.fromkeys(run for of_entry in trained.values() for run in of_entry.values()))
    rates = {Fraction(recorded_settings(run, STAGE)["training"]["fps"]) for run in folders}
    completers = [replace(completer_of(PAHIRES.paper, run.path), name=run.path.name) for run in folders]
    data_sets = [each for each in data_sets_of(store) if each.fps in rates]
    if not data_sets:
        named = ", ".join(f"{float(rate):g}" for rate in rates)
        raise NoTakesError(f"no data set stands at {named} fps, which the runs were trained for")
    measured = measure_all(store, data_sets, (SCALE,), [*REFERENCES, *completers], config)
    scopes = with_pools([each.scope for each in measured], "clips")
    for entry in ablation.entries:
        if entry.name not in trained:
            command = ablate_command(PAHIRES, ablation.table, config.run.name, entry.variant)
            config.missing.add(f"{entry.variant.name}: not trained ({command})")
    is_figure = ablation.table.startswith("figure")
    notes = [remark for each in measured for remark in each.remarks]
    if all(len(of_entry) == 1 for of_entry in trained.values()):
        notes.append(
            "One start each: how much a start does by itself is not known (motionkit ablate with --only full --seed 1)."
        )
    if is_figure:
        notes.append("The paper draws this figure without numbers; it is of HumanML3D at ×4.")
    return Content(
        caption=(
            f"What one setting does to interpolation at {scale_label(SCALE)}; all else is the same, "
            f"{_described_training(folders)}. {_caption(measured, config)}"
        ),
        blocks=(
            *(block for scope in scopes for block in _ablated(ablation, scope, trained)),
            *_starts(scopes, trained),
            *([] if is_figure else _printed_ablation(ablation.table)),
        ),
        definition={
            **_definition(),
            "variants": {entry.name: list(entry.variant.change) for entry in ablation.entries},
        },
        notes=tuple(notes),
        runs=tuple(run.path for run in folders),
        provenance={
            "runs": {run.path.name: run.stage(STAGE).read_summary() for run in folders},
            "trained": {completer.name: completer.facts for completer in completers},
        },
    )


def _described_training(runs: Sequence[RunFolder]) -> str:
    """Steps, form and batch of the runs; all values if they differ."""
    training = [recorded_settings(run, STAGE)["training"] for run in runs]
    settings = {
        "steps": ("schedule", "steps"),
        "batch": ("schedule", "batch_size"),
        "form": ("answer", "form"),
        "base": ("answer", "base"),
    }
    values = {
        name: sorted({str(each[part][setting]) for each in training}) for name, (part, setting) in settings.items()
    }
    return ", ".join(f"{name} {' and '.join(found)}" for name, found in values.items())


def _ablated(ablation: Ablation, scope: Scope, trained: _Runs) -> list[Block]:
    columns = tuple(dict.fromkeys(entry.column for entry in ablation.entries))
    blocks = []
    for metric in ABLATED_METRICS:
        cells: dict[str, dict[str, Cell]] = {entry.label: {} for entry in ablation.entries}
        for entry in ablation.entries:
            if values := _by_seed(scope, trained.get(entry.name, {}), metric):
                cells[entry.label][entry.column] = Cell(fmean(values.values()))
        references = [
            # The same number in every column, for rows that do not depend on the setting.
            Row(
                f"{each.name}, not trained",
                "reference",
                dict.fromkeys(columns, Cell(scope.number(each.name, metric, scale_label(SCALE)).value)),
            )
            for each in REFERENCES
        ]
        ours = [Row(row, "ours", found) for row, found in cells.items() if found]
        blocks.append(_block(f"{scope.label}: {METRICS[metric]}", metric, columns, [*references, *ours], scope.note))
    return blocks


def _block(title: str, metric: str, columns: tuple[str, ...], rows: Sequence[Row], note: str) -> Block:
    lower = find_metric(metric).higher_is_better is False
    return Block(title, columns, tuple(rows), lower_is_better=lower, note=note, metrics=(shown_measure(metric),))


def _starts(scopes: Sequence[Scope], trained: _Runs) -> list[Block]:
    """Runs that differ in their seed only, one by one."""
    several = {name: runs for name, runs in trained.items() if len(runs) > 1}
    seeds = tuple(f"seed {seed}" for seed in sorted({seed for runs in several.values() for seed in runs}))
    blocks = []
    for metric in ABLATED_METRICS if several else ():
        rows = []
        for scope in scopes:
            for name, runs in several.items():
                found = _by_seed(scope, runs, metric)
                cells = {f"seed {seed}": Cell(value) for seed, value in found.items()}
                rows.append(Row(f"{scope.label}: {name}", "ours", cells))
        note = "Settings that differ by less than these runs do are not told apart."
        blocks.append(_block(f"From other starts: {METRICS[metric]}", metric, seeds, rows, note))
    return blocks


def _by_seed(scope: Scope, runs: Mapping[int, RunFolder], metric: str) -> dict[int, float]:
    return {
        seed: scope.number(run.path.name, metric, scale_label(SCALE)).value
        for seed, run in runs.items()
        if run.path.name in scope.rows
    }


def _printed_ablation(table: str) -> list[Block]:
    def setting(figure: Reported) -> dict[str, str]:
        return dict(part.partition("=")[::2] for part in figure.setting.split(";")[1:])

    figures = [figure for figure in reported_figures("pahires", table) if figure.value is not None]
    return [
        printed_block(
            f"Printed in the PA-HiRes paper: {PRINTED_TITLES[metric]}",
            [figure for figure in figures if figure.metric == metric],
            lambda figure: f"ζ = {setting(figure)['terms']}",
            name=lambda figure: "shared" if setting(figure)["shared"] == "yes" else "own parameters",
            lower_is_better=False,
            note=(
                "HumanML3D at ×4, 1,000 epochs. At ζ = 16 it does not agree with the paper's own Table 1 (31.03 dB, "
                f"0.975). Source: {SOURCES['pahires']}."
            ),
        )
        for metric in dict.fromkeys(figure.metric for figure in figures)
    ]


TABLE_4, FIGURE_5, FIGURE_6 = (
    replace(table, heading=f"PA-HiRes, {table.place}: {table.title}")
    for table in (
        Table("pahires", name, PAHIRES.tables[name].title, VERSION, partial(compute_ablation, PAHIRES.tables[name]))
        for name in ("4", "figure5", "figure6")
    )
)
