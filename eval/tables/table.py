"""A table: its inputs, its spec, `build`, which makes a result, and `plan`, the stages that its systems need.

A package lists its own in `TABLES` (`motionkit.core.plugins`) as `PAPER-NUMBER`.
"""

import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eval.clip_fid.score import Protocol
from eval.report.results import Block, Cell, Result, Row, provenance
from eval.sample_folder import SampleFolder, SampleOptions, read_sample_folder
from eval.sets.motions import of_split_and
from eval.sets.sets import Missing
from motionkit.core import plugins
from motionkit.core.errors import UsageError
from motionkit.core.progress import OnProgress, ignore
from motionkit.core.timegrid import parse_fps
from motionkit.store.reader import Store
from motionkit.training.run import Loader, Stage, StageContext, StagePlan

if TYPE_CHECKING:
    from eval.text_motion.guo import GuoFiles

SOURCES = {
    "nerm": "Wei et al., NeRM: Learning Neural Representations for High-Framerate Human Motion Synthesis, ICLR 2024",
    "pahires": "Xu et al., Towards Arbitrary Motion Completing via Hierarchical Continuous Representation",
    "lafan1": "Harvey et al., Robust Motion In-betweening, ACM TOG 2020 (its benchmark's code)",
    "delta-interp": "Oreshkin et al., Motion In-betweening via Deep Δ-Interpolator, IEEE TVCG 2023",
    "ts-former": "Qin et al., Motion In-betweening via Two-stage Transformers, ACM TOG 2022",
}


@dataclass(frozen=True)
class EvalConfig:
    """Inputs of a table, the folder of its results, and a collector of what it lacks.

    Real motion: the sequences of `split` of the store ("all": any) for which `where` (SQL) holds. Evaluated: the models
    and encoders of `run`, folders of samples by the systems' names, `encoders` (pairs of an encoder's name and a run);
    a model generates at most `max_motions` motions, `draws` times. `evaluators` are feature sets or recognisers, None
    for all; `guo` and `motion_clip` are files of published ones. `clips` is clip-FID's protocol, `protocol` is of
    tables of whole motions. `fps` None means the table's own columns. `on_progress` is called during long steps.
    """

    store: Path
    results: Path
    split: str = "test"
    where: str | None = None
    run: Path | None = None
    samples: Mapping[str, Path] = field(default_factory=dict)
    sample_options: SampleOptions = field(default_factory=SampleOptions)
    encoders: tuple[tuple[str, Path], ...] = ()
    max_motions: int = 1024
    draws: int = 1
    evaluators: tuple[str, ...] | None = None
    guo: "GuoFiles | None" = None
    motion_clip: Path | None = None
    clips: Protocol = field(default_factory=Protocol)
    protocol: str = "native"
    fps: tuple[Fraction, ...] | None = None
    seed: int = 0
    on_progress: OnProgress = field(default=ignore, compare=False, repr=False)
    missing: Missing = field(default_factory=Missing, compare=False, repr=False)

    @property
    def condition(self) -> str | None:
        """The SQL condition of the real motion; None for the whole store."""
        return of_split_and(self.split, self.where)

    @property
    def real(self) -> str:
        """The real motion's name in captions: the split, and the condition if there is one."""
        return f"split {self.split!r}" + (f" where {self.where}" if self.where else "")

    @cached_property
    def sample_folders(self) -> tuple[SampleFolder, ...]:
        """The motions of every folder of samples, read when first accessed; raises `SampleFolderError`."""
        # Only published evaluators read pose vectors and KIT-ML's joints.
        keep = self.guo is not None or self.motion_clip is not None
        options = replace(self.sample_options, keep_published=keep)
        return tuple(read_sample_folder(*named, options, self.on_progress) for named in self.samples.items())


@dataclass(frozen=True)
class Content:
    """What a table computes: its blocks (those without rows are left out), the caption and notes.

    `definition` are further settings, `runs` further runs whose weights count, `provenance` is what else the numbers
    come from.
    """

    caption: str
    blocks: Iterable[Block]
    definition: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    runs: tuple[Path, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Table:
    """A table of a paper; without `takes_samples` it has no rows of other systems' motions.

    `compute` gets the configuration and its store. `version` is incremented when the meaning of numbers changes.
    `shown` gives the loaders of its rows, `reads` names the evaluators among a run's stages that it reads, and
    `settings` are its systems' training settings, as for `--set`: `plan` uses these to find what is missing.
    """

    paper: str
    number: str
    title: str
    version: str
    compute: Callable[[EvalConfig, Store], Content]
    heading: str = ""
    takes_samples: bool = True
    shown: Callable[[], Mapping[str, Loader[Any]]] = dict
    reads: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()
    task: str = ""

    @property
    def is_default(self) -> bool:
        """Whether it is of the default paper."""
        return self.paper == "nerm"

    @property
    def target(self) -> str:
        """table:2, figure:5, as `motionkit train --for` has it."""
        figure = self.number.removeprefix("figure")
        return f"table:{self.number}" if figure == self.number else f"figure:{figure}"

    def build(self, config: EvalConfig) -> Result:
        """The result; what it lacks is in `config.missing` too. Raises what `compute` and opening the store raise."""
        config.missing.clear()
        store = Store.open(config.store, on_progress=config.on_progress)
        store.select(config.condition)  # raises at once for SQL that is wrong
        content = self.compute(config, store)
        run = config.run if config.run is not None and config.run.is_dir() else None
        runs = [run, *content.runs, *(run for _, run in config.encoders)]
        origin = provenance(store.path, [each for each in runs if each is not None and each.is_dir()])
        origin |= {"run": run and run.name, **content.provenance, "seed": config.seed}
        if config.samples:
            origin["samples"] = {each.name: each.fingerprint for each in config.sample_folders}
        settings = {"split": config.split, "where": config.where, "motions": config.max_motions, "draws": config.draws}
        place = self.target.replace(":", " ").capitalize() if self.number[-1].isdigit() else self.number.capitalize()
        return Result(
            task=self.task or f"{self.paper}-{self.target.replace(':', '')}",
            version=self.version,
            title=self.heading or f"{'' if self.is_default else 'PA-HiRes, '}{place}: {self.title}",
            caption=content.caption,
            blocks=tuple(block for block in content.blocks if block.rows),
            definition={**settings, **content.definition},
            notes=content.notes,
            missing=config.missing.lines,
            provenance=origin,
        )


def name_and_fps(name: str) -> tuple[str, Fraction | None]:
    """A system's name and the one framerate that a folder of its samples is for: `mine@60`; None for all."""
    system, _, fps = name.rpartition("@")
    try:
        return (system, parse_fps(fps)) if system else (name, None)
    except ValueError:
        return name, None


def find_table(paper: str, number: str) -> Table:
    """Load one table. Raises `UsageError` that lists the tables."""
    if f"{paper}-{number}" not in (known := plugins.names("TABLES")):
        raise UsageError(f"there is no table {number} of {paper!r}; installed tables: {', '.join(known) or 'none'}")
    table: Table = plugins.load("TABLES", f"{paper}-{number}")
    return table


@dataclass(frozen=True)
class Reported:
    """One printed figure; `value` or `ci95` is None if the paper prints none or it is illegible."""

    paper: str
    table: str
    dataset: str
    method: str
    metric: str
    setting: str
    value: float | None
    ci95: float | None
    note: str


def reported_figures(paper: str, table: str) -> list[Reported]:
    """Every figure of one paper's table, in the order of the file."""

    def number(text: str) -> float | None:
        return float(text) if text else None

    text = (files("eval") / "data" / "reported.csv").read_text(encoding="utf-8")
    return [
        Reported(**{**dict[str, Any](row), "value": number(row["value"]), "ci95": number(row["ci95"])})
        for row in csv.DictReader(text.splitlines())
        if (row["paper"], row["table"]) == (paper, table)
    ]


def printed_block(
    title: str,
    figures: Iterable[Reported],
    column: Callable[[Reported], str],
    *,
    name: Callable[[Reported], str] = lambda figure: f"{figure.method} (paper)",
    columns: tuple[str, ...] = (),
    factor: float = 1.0,
    lower_is_better: bool = True,
    note: str = "",
) -> Block:
    """A paper's figures, times a factor; missing or illegible ones are left out. `columns` are theirs by default."""
    known = list(figures)
    cells: dict[str, dict[str, Cell]] = {}
    for figure in known:
        if figure.value is not None:
            cells.setdefault(name(figure), {})[column(figure)] = Cell(factor * figure.value, figure.ci95)
    rows = tuple(Row(row, "paper", by_column) for row, by_column in cells.items())
    return Block(title, columns or tuple(dict.fromkeys(map(column, known))), rows, lower_is_better, note)


def mean_cells(of_seeds: Sequence[Mapping[str, Cell]]) -> dict[str, Cell]:
    """The mean over a variant's seeds of each column, with their range as details; one seed's numbers as they are."""
    if len(of_seeds) == 1:
        return dict(of_seeds[0])
    means = {}
    for column in dict.fromkeys(column for cells in of_seeds for column in cells):
        values = [cells[column].value for cells in of_seeds if column in cells]
        details = {"lowest of the seeds": min(values), "highest of the seeds": max(values)}
        means[column] = Cell(sum(values) / len(values), None, details)
    return means


def plan(target: str, paper: str | None, context: StageContext, overrides: Sequence[str]) -> StagePlan:
    """The stages that a table's systems need ("table:2", "figure:8"), as `PLANS` of `motionkit.core.plugins` has it.

    A complete stage of the run is kept, unless the context overwrites: it needs no earlier ones, and its system's
    shares are unchanged. Raises `UsageError` for an unknown table.
    """
    table = table_that_shows(paper, target)
    stages: dict[str, Stage[Any]] = plugins.load_all("STAGES")

    def with_earlier(names: Iterable[str], *, of_kept: bool) -> set[str]:
        """The stages and all that they build on; with `of_kept` also what complete ones were built on."""
        needed: set[str] = set()
        waiting = list(names)
        while waiting:
            name = waiting.pop()
            stage, folder = stages[name], context.run.stage(name)
            if name not in needed and (context.overwrite or not folder.is_complete):
                waiting += stage.builds_on(stage.configured(context.recipe, (*table.settings, *overrides)))
            elif name not in needed and of_kept:
                waiting += folder.read_config().get("builds_on", {})
            needed.add(name)
        return needed

    shares: dict[str, float] = {}
    needed = with_earlier([name for name in table.reads if name in stages], of_kept=False)
    for system in table.shown().values():
        needed |= with_earlier(system.stages, of_kept=False)
        own = with_earlier(system.stages, of_kept=True)
        total = sum(stages[name].share for name in own)
        # A stage of two systems gets the larger share.
        shares |= {name: max(shares.get(name, 0.0), stages[name].share / total) for name in own}
    return StagePlan(
        tuple(stage for name, stage in stages.items() if name in needed),
        shares,
        settings=table.settings,
        next_command=f"motionkit eval --{target.replace(':', ' ')}{'' if paper is None else f' --paper {paper}'}",
    )


def table_that_shows(paper: str | None, target: str) -> Table:
    """The table of a paper named by "table:2" or "figure:8", without a paper of the default one if it has it.

    Raises `UsageError` for a table without rows of systems.
    """
    known: dict[str, Table] = plugins.load_all("TABLES")
    named = [each for each in known.values() if each.target == target and paper in (None, each.paper)]
    if not named:
        raise UsageError(f"--for {target}: table:NUMBER or figure:NUMBER of the installed tables: {', '.join(known)}")
    table = max(named, key=lambda table: table.is_default)
    if not table.shown():
        raise UsageError(f"--for {target}: that table has no rows of systems (of ablations: motionkit ablate)")
    return table
