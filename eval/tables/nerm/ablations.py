"""NeRM's Tables 5 to 9 and ours: runs of `motionkit ablate`, by reconstruction and generation.

A row is a variant; its numbers are means over the seeds it was trained with. An untrained variant is a row without
numbers, with the command that trains it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

from eval.clip_fid.score import CLIP_FID
from eval.report.results import Block, Cell, Result, Row, measure
from eval.sets.partial import PartialResult
from eval.tables.ablation_runs import ablate_command, find_ablations, run_name
from eval.tables.models import Trained
from eval.tables.nerm.clip_fid_column import P1, P2
from eval.tables.nerm.run_figures import HELD_OUT, MPJPE, MRE, SYNTHESIS, TRAINING, Yardstick, error_of, label
from eval.tables.nerm.table2 import ROW_NOTES
from eval.tables.parts import SOURCES, Part, Reported, printed_rows, reported_figures
from eval.tables.registry import Table, TableRequest
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.progress import OnProgress, task
from motionkit.edit.encoders import EncoderLoader, encoder_loader
from motionkit.generate.models import ModelLoader, model_loader
from motionkit.training.ablations import Ablation, Entry
from motionkit.training.run import Loader, RunFolder
from motionkit.training.stage import recorded_settings

NERM = find_ablations("nerm")
VERSION = "ablation/1"
COLUMNS = tuple(Fraction(rate) for rate in (20, 40, 60, 100, 120))
LOWEST, HIGHEST = "lowest of the seeds", "highest of the seeds"
MOST_SEEDS = 100
WINDOW_SETS = {
    TRAINING: "Reconstruction of training windows, from their μ",
    HELD_OUT: "Reconstruction of held-out windows, encoded by optimisation",
}
MEASURES = {MPJPE: measure("mpjpe", unit="mm"), MRE: measure("mre")}
WANTED_ERRORS = ((TRAINING, MPJPE), (TRAINING, MRE), (HELD_OUT, MPJPE))


@dataclass(frozen=True)
class _Trained:
    """A row with its runs, one a seed."""

    entry: Entry
    runs: tuple[Path, ...]


def build_ablation(ablation: Ablation, request: TableRequest) -> Result:
    """Build the table of an ablation from its runs.

    Raises `UsageError` without a run's name, or if none of the table's runs is trained, and what loading the store
    raises.
    """
    prefix = request.evaluated.run
    if prefix is None:
        raise UsageError("an ablation table needs the name of its runs: --run NAME for runs/NAME-VARIANT")
    rows = [_Trained(entry, _runs(prefix, entry)) for entry in ablation.entries]
    if not any(row.runs for row in rows):
        raise UsageError(
            f"no run of this table is trained in {str(prefix.parent)!r}: motionkit ablate {ablation.table} --run "
            f"{prefix.name} trains {', '.join(run_name(prefix.name, variant, 0) for variant in ablation.variants)}"
        )
    yardstick = Yardstick(request.open_store(), request, request.fps or COLUMNS)
    reconstruction = _reconstruction_blocks(ablation, rows, yardstick)
    blocks, missing = list(reconstruction.value), list(reconstruction.missing)
    generating = _model().stages[-1]
    if generating in ablation.stages:
        synthesis = _synthesis_block(ablation, rows, yardstick)
        blocks.append(synthesis.value)
        missing += synthesis.missing
        if not any(row.cells for row in blocks[-1].rows):
            missing.append(
                f"clip-FID: no {generating} is trained (motionkit ablate {ablation.table} --run {prefix.name})"
            )
    paper = _paper_blocks(ablation)
    return Result(
        task=f"nerm-table{ablation.table}",
        version=VERSION,
        title=f"{_name(ablation)}: {ablation.title}",
        caption=(
            "What one setting does to the first stage's reconstructions and to generated motion. All rows have the "
            "same recipe but for what they name, the same codebook and the same windows; 'global' is the paper's "
            f"layout of z, 'local' ours. Compared with {request.real.named}."
        ),
        blocks=(*(block for block in blocks if any(row.cells for row in block.rows)), *paper),
        definition=_definition(rows, request),
        notes=(*_differences(rows), *(() if paper else (_nothing_printed(ablation),))),
        missing=tuple(dict.fromkeys(missing)),
        provenance=request.provenance(
            yardstick.store,
            *(run for row in rows for run in row.runs),
            runs={run.name: _facts(run) for row in rows for run in row.runs},
        ),
    )


def _encoder() -> EncoderLoader:
    """The loader of the encoders in these runs."""
    return encoder_loader(NERM.paper)


def _model() -> ModelLoader:
    """The loader of the generative models in these runs."""
    return model_loader(NERM.paper)


def _runs(prefix: Path, entry: Entry) -> tuple[Path, ...]:
    """The runs of a row that reconstruct, by seed."""
    named = (prefix.parent / run_name(prefix.name, entry.variant, seed) for seed in range(MOST_SEEDS))
    return tuple(run for run in named if _encoder().complete_in(run))


def _reconstruction_blocks(
    ablation: Ablation, rows: Sequence[_Trained], yardstick: Yardstick
) -> PartialResult[list[Block]]:
    encoder = _encoder()
    measured = _measure(rows, encoder, yardstick.reconstruction, yardstick.request.on_progress)
    blocks = []
    for windows, error in WANTED_ERRORS:
        name = error_of(windows, error)
        found = {
            row.entry.label: _mean([part.rows[name] for part in measured.value[row.entry.label] if name in part.rows])
            for row in rows
        }
        blocks.append(
            Block(
                f"{WINDOW_SETS[windows]}: {error}",
                tuple(label(fps) for fps in yardstick.rates),
                tuple(_row(ablation, row, found[row.entry.label], encoder, yardstick.request) for row in rows),
                metrics=(MEASURES[error],),
            )
        )
    return PartialResult(blocks, measured.missing)


def _synthesis_block(ablation: Ablation, rows: Sequence[_Trained], yardstick: Yardstick) -> PartialResult[Block]:
    model = _model()
    measured = _measure(rows, model, yardstick.synthesis, yardstick.request.on_progress)
    missing = measured.missing
    found = {row.entry.label: _mean([part.rows[SYNTHESIS] for part in measured.value[row.entry.label]]) for row in rows}
    references: tuple[Row, ...] = ()
    if any(found.values()):
        floors = yardstick.floors()
        missing = (*missing, *floors.missing)
        references = tuple(Row(str(row), "reference", floors.rows[str(row)], ROW_NOTES[row]) for row in (P1, P2))
    protocol = yardstick.request.clip_fid.protocol
    block = Block(
        "Motion synthesis: clip-FID on the kinematic descriptor",
        tuple(label(fps) for fps in yardstick.rates),
        (
            *references,
            *(_row(ablation, row, found[row.entry.label], model, yardstick.request) for row in rows),
        ),
        note=(
            f"Mean over {protocol.replications} replications of N = {protocol.num_clips:,} clips a side ± half the 95 "
            "% interval over takes: how far one run's number would move with other takes, not with another seed."
        ),
        metrics=(measure(CLIP_FID),),
    )
    return PartialResult(block, missing)


def _measure(
    rows: Sequence[_Trained],
    loader: Loader[Any],
    figure: Callable[[Trained[Any]], Part],
    on_progress: OnProgress,
) -> PartialResult[dict[str, list[Part]]]:
    """A measurement of the loader's object in every run, each run once, by the row's label."""
    parts: dict[Path, Part] = {}
    missing: list[str] = []
    stage = loader.stages[-1]
    runs = list(dict.fromkeys(run for row in rows for run in row.runs if RunFolder(run).stage(stage).is_complete))
    with task(on_progress, f"measuring {stage}", len(runs)) as work:
        for run in runs:
            work.note(run.name)
            try:
                parts[run] = figure(Trained(loader, run))
            except MotionkitError as error:
                missing.append(f"{run.name}: {error}")
            else:
                missing.extend(parts[run].missing)
            work.advance()
    by_row = {row.entry.label: [parts[run] for run in row.runs if run in parts] for row in rows}
    return PartialResult(by_row, tuple(missing))


def _mean(of_seeds: Sequence[Mapping[str, Cell]]) -> dict[str, Cell]:
    """The mean over seeds of each column; one seed's numbers as they are."""
    if len(of_seeds) == 1:
        return dict(of_seeds[0])
    columns = {
        column: [cells[column] for cells in of_seeds if column in cells] for cells in of_seeds for column in cells
    }
    return {column: _mean_cell(cells) for column, cells in columns.items()}


def _mean_cell(cells: Sequence[Cell]) -> Cell:
    values = [cell.value for cell in cells]
    shared = [name for name in cells[0].details if all(name in cell.details for cell in cells)]
    details = {name: sum(cell.details[name] for cell in cells) / len(cells) for name in shared}
    return Cell(sum(values) / len(values), None, {**details, LOWEST: min(values), HIGHEST: max(values)})


def _row(
    ablation: Ablation, row: _Trained, cells: Mapping[str, Cell], loader: Loader[Any], request: TableRequest
) -> Row:
    assert request.evaluated.run is not None
    stage = loader.stages[-1]
    num_seeds = sum(RunFolder(run).stage(stage).is_complete for run in row.runs)
    if not num_seeds:
        what = "not trained" if loader is _encoder() else f"its {stage} is not trained"
        command = ablate_command(NERM, ablation.table, request.evaluated.run.name, row.entry.variant)
        return Row(row.entry.label, "ours", {}, f"{what}: {command}")
    several = f"mean of {num_seeds} seeds" if num_seeds > 1 else ""
    return Row(row.entry.label, "ours", cells, several)


def _definition(rows: Sequence[_Trained], request: TableRequest) -> dict[str, Any]:
    return {
        "rows": {row.entry.label: list(row.entry.variant.change) for row in rows},
        "training windows": "do not overlap, not mirrored; decoded from the posterior mean, not fitted again",
        "held-out windows": "z by L-BFGS on evenly spaced native poses against the frozen field",
        "MRE": "root of the mean squared difference of `native` pose vectors (263 numbers; m, m/s, rad/s)",
        "truth": "the capture, brought down band-limited to the column's framerate; slower takes are left out",
        "split": request.real.split,
        "where": request.real.where,
        "low_pass_hz": request.clip_fid.low_pass_hz,
        "motions": request.evaluated.max_motions,
    }


def _facts(run: Path) -> dict[str, Any]:
    """A run's training summary: steps, losses, seconds of its stages."""
    folder = RunFolder(run)
    stages = [name for name in _model().stages if folder.stage(name).is_complete]
    return {name: folder.stage(name).read_summary() for name in stages}


def _differences(rows: Sequence[_Trained]) -> tuple[str, ...]:
    """A warning if runs differ in more than what the table varies, such as training time or sequences."""
    varied = frozenset[str]().union(*(row.entry.variant.varied for row in rows))
    values: dict[str, dict[str, list[str]]] = {}
    for run in dict.fromkeys(run for row in rows for run in row.runs):
        for stage in _model().stages:
            folder = RunFolder(run).stage(stage)
            if folder.is_complete:
                for key, value in _leaves(recorded_settings(RunFolder(run), stage)[stage], f"{stage}."):
                    values.setdefault(key, {}).setdefault(str(value), []).append(run.name)
    return tuple(
        f"These runs differ in more than the table varies: {key} is "
        + ", ".join(f"{value} in {' and '.join(runs)}" for value, runs in found.items())
        + "."
        for key, found in values.items()
        if len(found) > 1 and key not in varied
    )


def _leaves(values: Mapping[str, Any], prefix: str) -> list[tuple[str, Any]]:
    found: list[tuple[str, Any]] = []
    for name, value in values.items():
        found += _leaves(value, f"{prefix}{name}.") if isinstance(value, dict) else [(prefix + name, value)]
    return found


def _paper_blocks(ablation: Ablation) -> tuple[Block, ...]:
    """The paper's own figures in its own units: MRE, and clip-FID by its own evaluator."""
    figures = [figure for figure in reported_figures("nerm", ablation.table) if figure.value is not None]
    titles = {"mre": "motion reconstruction, MRE", "clip_fid": "motion synthesis, clip-FID"}
    notes = dict.fromkeys(
        f"{_printed_row(each)} at {_printed_fps(each)}: {each.note}." for each in figures if each.note
    )
    blocks = []
    for metric, title in titles.items():
        rows = printed_rows([each for each in figures if each.metric == metric], _printed_fps, _printed_row)
        if rows:
            columns = dict.fromkeys(column for row in rows for column in row.cells)
            scale = f"100 sequences of another data set, trained for far longer. Source: {SOURCES['nerm']}."
            title = f"Printed in the NeRM paper (HumanML3D): {title}"
            blocks.append(Block(title, tuple(columns), rows, note=" ".join((scale, *notes))))
    return tuple(blocks)


def _printed_row(figure: Reported) -> str:
    return figure.setting.partition(";")[2].replace("=", " = ") or figure.method


def _printed_fps(figure: Reported) -> str:
    return f"{figure.setting.partition(';')[0].removesuffix('fps')} fps"


def _name(ablation: Ablation) -> str:
    return f"Table {ablation.table}" if ablation.table.isdigit() else "Ours"


def _nothing_printed(ablation: Ablation) -> str:
    if ablation.table.isdigit():
        return "The paper's figures of this table are illegible in the copy that the reported figures were read from."
    return "The paper has no such table; its NeRM-fixed is a row of its Table 1."


TABLES = {
    name: Table("nerm", name, ablation.title, partial(build_ablation, ablation), takes_samples=False)
    for name, ablation in NERM.tables.items()
}
TABLE_5, TABLE_6, TABLE_7, TABLE_8, TABLE_9 = (TABLES[number] for number in "56789")
TABLE_OURS = TABLES["ours"]
