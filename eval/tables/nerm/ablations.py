"""NeRM's Tables 5 to 9 and ours: runs of `motionkit ablate`, by reconstruction and generation.

A row is a variant; its numbers are means over the seeds it was trained with. An untrained variant is a row without
numbers, with the command that trains it.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from eval.clip_fid.score import CLIP_FID
from eval.report.results import Block, Cell, Row, measure
from eval.sets.motions import generate_fields
from eval.sets.sets import RowId
from eval.tables.nerm.table4 import HELD_OUT, TRAINING, mpjpe_cell, mre_cell, reconstructed_windows
from eval.tables.systems import COLUMNS, Trained, Yardstick, label, reconstructor
from eval.tables.table import SOURCES, Content, EvalConfig, Table, printed_block, reported_figures
from motionkit.core.progress import tracked
from motionkit.edit.encoders import encoder_loader
from motionkit.generate.models import model_loader
from motionkit.store.reader import Store
from motionkit.training.ablations import Ablation, find_ablations
from motionkit.training.run import RunFolder

NERM = find_ablations("nerm")
LOWEST, HIGHEST = "lowest of the seeds", "highest of the seeds"
SYNTHESIS = "Motion synthesis: clip-FID on the kinematic descriptor"
# Blocks of errors: the windows' kind, the title, the error's cell, its metric.
ERRORS = (
    (TRAINING, "from their μ: root-aligned MPJPE (mm)", mpjpe_cell, measure("mpjpe", unit="mm")),
    (TRAINING, "from their μ: MRE", mre_cell, measure("mre")),
    (HELD_OUT, "encoded by optimisation: root-aligned MPJPE (mm)", mpjpe_cell, measure("mpjpe", unit="mm")),
)
METRICS = {f"Reconstruction of {which}, {title}": metric for which, title, _, metric in ERRORS}
METRICS |= {SYNTHESIS: measure(CLIP_FID)}
PRINTED = {"mre": "motion reconstruction, MRE", "clip_fid": "motion synthesis, clip-FID"}

# Cells by block, then by column.
Numbers = dict[str, dict[str, Cell]]


def compute(ablation: Ablation, config: EvalConfig, store: Store) -> Content:
    """Build the table of an ablation from its runs.

    Raises `UsageError` without a run's name, or if none of the table's runs is trained.
    """
    encoder, model = encoder_loader(NERM.paper), model_loader(NERM.paper)
    runs = NERM.trained_runs(ablation.table, config.run, encoder.stages[-1])
    assert config.run is not None
    command = NERM.command(ablation.table, config.run)
    rates = config.fps or COLUMNS
    folders = list(dict.fromkeys(run for by_seed in runs.values() for run in by_seed.values()))
    generating = [run for run in folders if model.complete_in(run.path)] if model.stages[-1] in ablation.stages else []
    yardstick = Yardstick.of(store, config, rates) if generating else None
    numbers: dict[RunFolder, Numbers] = {}
    for run in tracked(config.on_progress, "measuring runs", folders, len(folders)):
        numbers[run] = {}
        with config.missing.skipping(run.path.name):
            numbers[run] |= _reconstruction(Trained(encoder, run.path), store, config)
            if yardstick is not None and run in generating:
                loaded = Trained(model, run.path).loaded
                fields = generate_fields(loaded, yardstick.windows(loaded), config.seed, config.max_motions)
                row = RowId(f"{loaded.name} of run {run.path.name!r}")
                numbers[run][SYNTHESIS] = yardstick.clip_fid(row, yardstick.sets(row, fields))
    blocks = []
    for title, metric in METRICS.items():
        rows = []
        for entry in ablation.entries:
            trained = [run for run in runs[entry.name].values() if title != SYNTHESIS or run in generating]
            cells = _mean([numbers[run][title] for run in trained if title in numbers[run]])
            steps = sorted({run.stage(encoder.stages[-1]).effort().get("steps", "?") for run in trained})
            note = f"field of {' or '.join(steps)} steps" + (f", {len(trained)} seeds" if len(trained) > 1 else "")
            if not trained:
                note = f"not trained: {command} --only {entry.variant.name}"
            rows.append(Row(entry.label, "ours", cells, note))
        if any(row.cells for row in rows):
            floors = yardstick.floor_rows() if title == SYNTHESIS and yardstick is not None else []
            labels = tuple(map(label, rates))
            blocks.append(Block(title, labels, (*floors, *rows), metrics=(metric,)))
    if model.stages[-1] in ablation.stages and not generating:
        config.missing.add(f"clip-FID: no {model.stages[-1]} is trained ({command})")
    printed = _printed(ablation.table)
    return Content(
        caption=(
            "What one setting does to the first stage's reconstructions and to generated motion. 'global' is the "
            f"paper's layout of z, 'local' ours. Compared with {config.real}; clip-FID as in Table 2."
        ),
        blocks=(*blocks, *printed),
        definition={"rows": {entry.label: list(entry.variant.change) for entry in ablation.entries}},
        notes=() if printed else ("The paper's figures of this table are illegible in our copy, or it has none.",),
        runs=tuple(run.path for run in folders),
        provenance={
            "runs": {run.path.name: {name: run.stage(name).effort() for name in model.stages} for run in folders}
        },
    )


def _reconstruction(trained: Trained[Any], store: Store, config: EvalConfig) -> Numbers:
    """Errors of an encoder's training windows, from their trained latents, and of held-out windows."""
    rates, found = config.fps or COLUMNS, Numbers()
    samples = reconstructed_windows(reconstructor(trained, store), store, config, rates)
    for which, sample in samples.items():
        for fps in rates:
            errors = list(sample.errors(fps).values())
            if not errors:
                config.missing.add(f"{which}, {label(fps)}: no take is that fast")
                continue
            for windows, title, cell, _ in ERRORS:
                if windows == which:
                    found.setdefault(f"Reconstruction of {which}, {title}", {})[label(fps)] = cell(errors)
    return found


def _mean(of_seeds: Sequence[Mapping[str, Cell]]) -> dict[str, Cell]:
    """The mean over seeds of each column; one seed's numbers as they are."""
    if len(of_seeds) == 1:
        return dict(of_seeds[0])
    found = {}
    for column in dict.fromkeys(column for cells in of_seeds for column in cells):
        values = [cells[column].value for cells in of_seeds if column in cells]
        found[column] = Cell(sum(values) / len(values), None, {LOWEST: min(values), HIGHEST: max(values)})
    return found


def _printed(table: str) -> list[Block]:
    """The paper's own figures in its own units: MRE, and clip-FID by its own evaluator."""
    figures = [figure for figure in reported_figures("nerm", table) if figure.value is not None]
    blocks = [
        printed_block(
            f"Printed in the NeRM paper (HumanML3D): {title}",
            [figure for figure in figures if figure.metric == metric],
            lambda figure: label(figure.setting.partition(";")[0]),
            name=lambda figure: figure.setting.partition(";")[2].replace("=", " = ") or figure.method,
            note=f"100 sequences of another data set, trained for far longer. Source: {SOURCES['nerm']}.",
        )
        for metric, title in PRINTED.items()
    ]
    return [block for block in blocks if block.rows]


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
