"""NeRM's Tables 5 to 9 and ours: runs of `motionkit ablate`, by reconstruction and generation.

A row is a variant; its numbers are means over the seeds it was trained with. An untrained variant is a row without
numbers, with the command that trains it.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from eval.clip_fid.score import CLIP_FID
from eval.config import EvalConfig
from eval.reconstruction import HELD_OUT, TRAINING
from eval.report.results import Block, Cell, Row, measure
from eval.tables.ablation_runs import ablate_command, find_ablations, trained_runs
from eval.tables.columns import COLUMNS, label
from eval.tables.models import Trained
from eval.tables.runs import MPJPE, MRE, SYNTHESIS, Rows, Yardstick, error_of
from eval.tables.table import SOURCES, Content, Reported, Table, printed_block, reported_figures
from motionkit.core.progress import task
from motionkit.edit.encoders import encoder_loader
from motionkit.generate.models import model_loader
from motionkit.store.reader import Store
from motionkit.training.ablations import Ablation
from motionkit.training.config import leaves
from motionkit.training.run import Loader, RunFolder, recorded_settings

NERM = find_ablations("nerm")
LOWEST, HIGHEST = "lowest of the seeds", "highest of the seeds"
RECONSTRUCTION = {
    (TRAINING, MPJPE): "Reconstruction of training windows, from their μ",
    (TRAINING, MRE): "Reconstruction of training windows, from their μ",
    (HELD_OUT, MPJPE): "Reconstruction of held-out windows, encoded by optimisation",
}
MEASURES = {MPJPE: measure("mpjpe", unit="mm"), MRE: measure("mre")}

# Trained runs by the entries' labels, then by seed.
_Runs = Mapping[str, Mapping[int, RunFolder]]


def compute(ablation: Ablation, config: EvalConfig, store: Store) -> Content:
    """Build the table of an ablation from its runs.

    Raises `UsageError` without a run's name, or if none of the table's runs is trained.
    """
    encoder, model = encoder_loader(NERM.paper), model_loader(NERM.paper)
    runs = trained_runs(NERM, ablation.table, config.run, encoder.stages[-1])
    yardstick = Yardstick(store, config, config.fps or COLUMNS)
    rebuilt = _measure(runs, encoder, yardstick.reconstruction, config)
    blocks = [
        Block(
            f"{title}: {error}",
            yardstick.labels,
            tuple(_rows(ablation, runs, rebuilt, error_of(windows, error), encoder, config)),
            metrics=(MEASURES[error],),
        )
        for (windows, error), title in RECONSTRUCTION.items()
    ]
    generating = model.stages[-1]
    if generating in ablation.stages:
        generated = _measure(runs, model, yardstick.synthesis, config)
        rows = list(_rows(ablation, runs, generated, SYNTHESIS, model, config))
        if any(row.cells for row in rows):
            rows = [*yardstick.floor_rows(), *rows]
        else:
            assert config.run is not None
            command = f"motionkit ablate {ablation.table} --run {config.run.name}"
            config.missing.add(f"clip-FID: no {generating} is trained ({command})")
        blocks.append(
            Block(
                "Motion synthesis: clip-FID on the kinematic descriptor",
                yardstick.labels,
                tuple(rows),
                note=(
                    f"Mean over {config.clips.replications} replications of N = {config.clips.num_clips:,} clips a "
                    "side ± half the 95 % interval over takes: how far one run's number would move with other takes, "
                    "not with another seed."
                ),
                metrics=(measure(CLIP_FID),),
            )
        )
    folders = tuple(dict.fromkeys(run.path for of_entry in runs.values() for run in of_entry.values()))
    printed = _printed(ablation)
    return Content(
        caption=(
            "What one setting does to the first stage's reconstructions and to generated motion. All rows have the "
            "same recipe but for what they name, the same codebook and the same windows; 'global' is the paper's "
            f"layout of z, 'local' ours. Compared with {config.real}."
        ),
        blocks=(*(block for block in blocks if any(row.cells for row in block.rows)), *printed),
        definition={
            "rows": {entry.label: list(entry.variant.change) for entry in ablation.entries},
        },
        notes=(*_differences(ablation, runs, model.stages), *(() if printed else (_nothing_printed(ablation),))),
        runs=folders,
        provenance={
            "runs": {
                run.name: {
                    name: RunFolder(run).stage(name).read_summary()
                    for name in model.stages
                    if RunFolder(run).stage(name).is_complete
                }
                for run in folders
            }
        },
    )


def _measure(
    runs: _Runs, loader: Loader[Any], number: Callable[[Trained[Any]], Rows], config: EvalConfig
) -> dict[RunFolder, Rows]:
    """A measurement of the loader's object in every run that has it."""
    stage, found = loader.stages[-1], {}
    folders = dict.fromkeys(run for of_entry in runs.values() for run in of_entry.values())
    complete = [run for run in folders if run.stage(stage).is_complete]
    with task(config.on_progress, f"measuring {stage}", len(complete)) as work:
        for run in complete:
            work.note(run.path.name)
            with config.missing.skipping(run.path.name):
                found[run] = number(Trained(loader, run.path))
            work.advance()
    return found


def _rows(
    ablation: Ablation,
    runs: _Runs,
    measured: Mapping[RunFolder, Rows],
    number: str,
    loader: Loader[Any],
    config: EvalConfig,
) -> list[Row]:
    """A row for each entry: the mean of a number over its seeds, or the command that trains it."""
    assert config.run is not None
    rows, stage = [], loader.stages[-1]
    for entry in ablation.entries:
        trained = [run for run in runs[entry.name].values() if run.stage(stage).is_complete]
        cells = _mean([measured[run][number] for run in trained if run in measured and number in measured[run]])
        note = f"mean of {len(trained)} seeds" if len(trained) > 1 else ""
        if not trained:
            what = f"its {stage} is not trained" if runs[entry.name] else "not trained"
            note = f"{what}: {ablate_command(NERM, ablation.table, config.run.name, entry.variant)}"
        rows.append(Row(entry.label, "ours", cells, note))
    return rows


def _mean(of_seeds: Sequence[Mapping[str, Cell]]) -> dict[str, Cell]:
    """The mean over seeds of each column; one seed's numbers as they are."""
    if len(of_seeds) == 1:
        return dict(of_seeds[0])
    found = {}
    for column in dict.fromkeys(column for cells in of_seeds for column in cells):
        cells = [each[column] for each in of_seeds if column in each]
        values = [cell.value for cell in cells]
        shared = [name for name in cells[0].details if all(name in cell.details for cell in cells)]
        details = {name: sum(cell.details[name] for cell in cells) / len(cells) for name in shared}
        details |= {LOWEST: min(values), HIGHEST: max(values)}
        found[column] = Cell(sum(values) / len(values), None, details)
    return found


def _differences(ablation: Ablation, runs: _Runs, stages: Sequence[str]) -> tuple[str, ...]:
    """A warning if runs differ in more than what the table varies, such as training time or sequences."""
    varied = frozenset[str]().union(*(entry.variant.varied for entry in ablation.entries if runs[entry.name]))
    values: dict[str, dict[str, list[str]]] = {}
    for run in dict.fromkeys(run for of_entry in runs.values() for run in of_entry.values()):
        for stage in stages:
            if run.stage(stage).is_complete:
                for key, value in leaves(recorded_settings(run, stage)[stage], f"{stage}.").items():
                    values.setdefault(key, {}).setdefault(str(value), []).append(run.path.name)
    return tuple(
        f"These runs differ in more than the table varies: {key} is "
        + ", ".join(f"{value} in {' and '.join(names)}" for value, names in found.items())
        + "."
        for key, found in values.items()
        if len(found) > 1 and key not in varied
    )


def _printed(ablation: Ablation) -> list[Block]:
    """The paper's own figures in its own units: MRE, and clip-FID by its own evaluator."""

    def row(figure: Reported) -> str:
        return figure.setting.partition(";")[2].replace("=", " = ") or figure.method

    def column(figure: Reported) -> str:
        return label(figure.setting.partition(";")[0])

    figures = [figure for figure in reported_figures("nerm", ablation.table) if figure.value is not None]
    notes = dict.fromkeys(f"{row(each)} at {column(each)}: {each.note}." for each in figures if each.note)
    scale = f"100 sequences of another data set, trained for far longer. Source: {SOURCES['nerm']}."
    titles = {"mre": "motion reconstruction, MRE", "clip_fid": "motion synthesis, clip-FID"}
    blocks = [
        printed_block(
            f"Printed in the NeRM paper (HumanML3D): {title}",
            [figure for figure in figures if figure.metric == metric],
            column,
            name=row,
            note=" ".join((scale, *notes)),
        )
        for metric, title in titles.items()
    ]
    return [block for block in blocks if block.rows]


def _nothing_printed(ablation: Ablation) -> str:
    if ablation.table.isdigit():
        return "The paper's figures of this table are illegible in the copy that the reported figures were read from."
    return "The paper has no such table; its NeRM-fixed is a row of its Table 1."


TABLES = {
    name: Table(
        "nerm",
        name,
        ablation.title,
        "ablation/1",
        partial(compute, ablation),
        heading="" if name.isdigit() else f"Ours: {ablation.title}",
        takes_samples=False,
    )
    for name, ablation in NERM.tables.items()
}
TABLE_5, TABLE_6, TABLE_7, TABLE_8, TABLE_9 = (TABLES[number] for number in "56789")
TABLE_OURS = TABLES["ours"]
