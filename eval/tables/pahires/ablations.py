"""PA-HiRes' Table 4 and Figures 5 and 6: runs of `motionkit ablate --paper pahires`, by interpolation at ×4.

A variant is a cell; its entry names row and column. If it was trained from several seeds its number is their mean, and
a block shows them one by one, to separate the seeds' effect from the setting's. Variants that are not trained have no
number; a note names the command that trains them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from statistics import fmean

from eval.completion.blocks import Scope, number, shown_measure, with_pools
from eval.completion.encoders import INTERPOLATION, completer_of
from eval.completion.protocol import VERSION, InterpolationProtocol, scale_label
from eval.completion.takes import NoTakesError, data_sets_of
from eval.metrics.metric import find_metric
from eval.report.results import Block, Cell, Result, Row
from eval.tables.ablation_runs import ablate_command, find_ablations, run_name
from eval.tables.pahires.interpolation import caption, definition
from eval.tables.pahires.measured import measure_all
from eval.tables.parts import SOURCES, reported_figures
from eval.tables.registry import Table, TableRequest
from motionkit.core.errors import UsageError
from motionkit.training.ablations import Ablation, Variant
from motionkit.training.run import RunFolder
from motionkit.training.stage import recorded_settings

PAHIRES = find_ablations("pahires")
STAGE = next(iter(PAHIRES.stages))
SCALE = Fraction(4)
METRICS = {"psnr": "PSNR (dB)", "ssim": "SSIM", "acceleration_error": "acceleration error (m/s²)"}
REFERENCES = tuple(row for row in INTERPOLATION if row.name in ("SLERP", "cubic spline"))
MOST_SEEDS = 100


def build_ablation(ablation: Ablation, request: TableRequest) -> Result:
    """Scores of the runs RUN-VARIANT on every data set, at their training framerate.

    Raises `UsageError` without a run's name, or if none of the runs is trained, and as `build_interpolation`.
    """
    trained = _trained(ablation, request)
    store, protocol = request.open_store(), InterpolationProtocol()
    store.select(request.real.condition)  # raises at once for SQL that is wrong
    all_runs = list({run.path: run for runs in trained.values() for run in runs.values()}.values())
    rates = {Fraction(recorded_settings(run, STAGE)["training"]["fps"]) for run in all_runs}
    completers = [replace(completer_of(PAHIRES.paper, run.path), name=run.path.name) for run in all_runs]
    data_sets = [each for each in data_sets_of(store) if each.fps in rates]
    if not data_sets:
        named = ", ".join(f"{float(rate):g}" for rate in rates)
        raise NoTakesError(f"no data set stands at {named} fps, which the runs were trained for")
    found = measure_all(store, data_sets, (SCALE,), [*REFERENCES, *completers], request)
    measured = found.value
    scopes = with_pools([each.scope for each in measured], "clips")
    untrained = [entry.variant for entry in ablation.entries if entry.name not in trained]
    not_trained = [f"{variant.name}: {_command(ablation, request, variant)}" for variant in dict.fromkeys(untrained)]
    return Result(
        task=f"pahires-{_place(ablation).lower().replace(' ', '')}",
        version=VERSION,
        title=f"PA-HiRes, {_place(ablation)}: {ablation.title}",
        caption=(
            f"What one setting does to interpolation at {scale_label(SCALE)}; all else is the same, "
            f"{_described_training(all_runs)}. {caption(measured, protocol, request)}"
        ),
        blocks=(
            *(block for scope in scopes for block in _blocks(ablation, scope, trained)),
            *_starts(scopes, trained),
            *_printed(ablation),
        ),
        definition={
            **definition(protocol, request),
            "variants": {entry.name: list(entry.variant.change) for entry in ablation.entries},
        },
        notes=(*(remark for each in measured for remark in each.remarks), *_notes(ablation, trained)),
        missing=tuple(dict.fromkeys((*found.missing, *not_trained))),
        provenance=request.provenance(
            store,
            *(run.path for run in all_runs),
            runs={run.path.name: run.stage(STAGE).read_summary() for run in all_runs},
            trained={completer.name: completer.facts for completer in completers},
        ),
    )


TABLE_4, FIGURE_5, FIGURE_6 = (
    Table("pahires", name, PAHIRES.tables[name].title, partial(build_ablation, PAHIRES.tables[name]))
    for name in ("4", "figure5", "figure6")
)


# Trained runs by the entries' labels, then by seed.
_Trained = Mapping[str, Mapping[int, RunFolder]]


def _trained(ablation: Ablation, request: TableRequest) -> _Trained:
    if request.evaluated.run is None:
        raise UsageError("an ablation needs the name of its runs: --run NAME for runs/NAME-VARIANT")
    runs = {
        entry.name: {
            seed: RunFolder(request.evaluated.run.parent / run_name(request.evaluated.run.name, entry.variant, seed))
            for seed in range(MOST_SEEDS)
        }
        for entry in ablation.entries
    }
    found = {
        label: {seed: run for seed, run in of_label.items() if run.stage(STAGE).is_complete}
        for label, of_label in runs.items()
    }
    if not any(found.values()):
        names = ", ".join(dict.fromkeys(of_label[0].path.name for of_label in runs.values()))
        raise UsageError(
            f"no run of it is trained in {str(request.evaluated.run.parent)!r}: motionkit ablate {ablation.table} "
            f"--paper {PAHIRES.paper} --run {request.evaluated.run.name} trains {names}"
        )
    return {label: of_label for label, of_label in found.items() if of_label}


def _command(ablation: Ablation, request: TableRequest, variant: Variant) -> str:
    assert request.evaluated.run is not None
    return f"not trained ({ablate_command(PAHIRES, ablation.table, request.evaluated.run.name, variant)})"


def _described_training(runs: Sequence[RunFolder]) -> str:
    """Steps, form and batch of the runs; all values if they differ."""
    training = [recorded_settings(run, STAGE)["training"] for run in runs]
    values = {
        name: sorted({str(each[part][setting]) for each in training})
        for name, part, setting in (
            ("steps", "schedule", "steps"),
            ("batch", "schedule", "batch_size"),
            ("form", "answer", "form"),
            ("base", "answer", "base"),
        )
    }
    return ", ".join(f"{name} {' and '.join(found)}" for name, found in values.items())


def _blocks(ablation: Ablation, scope: Scope, trained: _Trained) -> list[Block]:
    places = {entry.name: (entry.label, entry.column) for entry in ablation.entries}
    columns = tuple(dict.fromkeys(column for _, column in places.values()))
    blocks = []
    for metric, title in METRICS.items():
        cells: dict[str, dict[str, Cell]] = {row: {} for row, _ in places.values()}
        for label, (row, column) in places.items():
            values = list(_by_seed(scope, trained.get(label, {}), metric).values())
            if values:
                cells[row][column] = Cell(fmean(values))
        references = tuple(
            Row(f"{each.name}, not trained", "reference", _flat(scope, each.name, metric, columns))
            for each in REFERENCES
        )
        lower = find_metric(metric).higher_is_better is False
        ours = tuple(Row(row, "ours", found) for row, found in cells.items() if found)
        blocks.append(
            Block(
                f"{scope.label}: {title}",
                columns,
                (*references, *ours),
                lower_is_better=lower,
                note=scope.note,
                metrics=(shown_measure(metric),),
            )
        )
    return blocks


def _starts(scopes: Sequence[Scope], trained: _Trained) -> list[Block]:
    """Runs that differ in their seed only, one by one."""
    several = {label: runs for label, runs in trained.items() if len(runs) > 1}
    if not several:
        return []
    seeds = sorted({seed for runs in several.values() for seed in runs})
    return [
        Block(
            f"From other starts: {title}",
            tuple(f"seed {seed}" for seed in seeds),
            tuple(
                Row(
                    f"{scope.label}: {label}",
                    "ours",
                    {f"seed {seed}": Cell(found) for seed, found in _by_seed(scope, runs, metric).items()},
                )
                for scope in scopes
                for label, runs in several.items()
            ),
            lower_is_better=find_metric(metric).higher_is_better is False,
            note="Settings that differ by less than these runs do are not told apart.",
            metrics=(shown_measure(metric),),
        )
        for metric, title in METRICS.items()
    ]


def _by_seed(scope: Scope, runs: Mapping[int, RunFolder], metric: str) -> dict[int, float]:
    return {
        seed: number(scope.rows[run.path.name], metric, scale_label(SCALE)).value
        for seed, run in runs.items()
        if run.path.name in scope.rows
    }


def _flat(scope: Scope, name: str, metric: str, columns: Sequence[str]) -> dict[str, Cell]:
    """The same number in every column, for rows that do not depend on the setting."""
    return {column: Cell(number(scope.rows[name], metric, scale_label(SCALE)).value) for column in columns}


def _place(ablation: Ablation) -> str:
    number = ablation.table.removeprefix("figure")
    return f"Table {number}" if number == ablation.table else f"Figure {number}"


def _notes(ablation: Ablation, trained: _Trained) -> tuple[str, ...]:
    notes = []
    if all(len(runs) == 1 for runs in trained.values()):
        notes.append(
            "One start each: how much a start does by itself is not known (motionkit ablate with --only full --seed 1)."
        )
    if _place(ablation).startswith("Figure"):
        notes.append("The paper draws this figure without numbers; it is of HumanML3D at ×4.")
    return tuple(notes)


def _printed(ablation: Ablation) -> list[Block]:
    """The paper's Table 4."""
    cells: dict[str, dict[str, dict[str, Cell]]] = {}
    for figure in reported_figures("pahires", ablation.table):
        setting = dict(part.partition("=")[::2] for part in figure.setting.split(";")[1:])
        row = "shared (paper)" if setting["shared"] == "yes" else "own parameters (paper)"
        if figure.value is not None:
            cells.setdefault(figure.metric, {}).setdefault(row, {})[f"ζ = {setting['terms']}"] = Cell(figure.value)
    titles = {"psnr_db": "PSNR (dB)", "ssim": "SSIM"}
    note = (
        "HumanML3D at ×4, 1,000 epochs. At ζ = 16 it does not agree with the paper's own Table 1 (31.03 dB, 0.975). "
        f"Source: {SOURCES['pahires']}."
    )
    return [
        Block(
            f"Printed in the PA-HiRes paper: {titles[metric]}",
            tuple(dict.fromkeys(column for found in rows.values() for column in found)),
            tuple(Row(name, "paper", found) for name, found in rows.items()),
            lower_is_better=False,
            note=note,
        )
        for metric, rows in cells.items()
    ]
