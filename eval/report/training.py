"""A run's training: the inputs of each of its stages, and the losses over the steps."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from eval.report.figures import CURVE_COLOURS
from eval.report.render import card
from motionkit.training.run import RunError, RunFolder

# Keys of metrics.jsonl that are not losses.
CLOCK = ("step", "seconds")
COLUMNS = 3


@dataclass(frozen=True)
class StageTraining:
    """One stage of a run: facts for people, in order, and its logged steps, oldest first."""

    name: str
    facts: Mapping[str, str]
    lines: Sequence[Mapping[str, float]]


def stages_of(run: Path) -> list[StageTraining]:
    """Every stage of a run, by name.

    Raises `RunError` for a folder without stages, `DamagedFileError` for damaged files.
    """
    folders = sorted(path for path in run.glob("*") if (path / "config.json").is_file())
    if not folders:
        raise RunError(f"{run} holds no trained stage (motionkit train --run {run.name})")
    weights = RunFolder(run).fingerprints()
    found = []
    for path in folders:
        stage = RunFolder(run).stage(path.name)
        config = stage.read_config()
        facts = {
            "recipe": str(config.get("recipe", "–")),
            "steps": "–" if stage.is_complete else "not finished",
            "parameters": "–",
            "processor time": "–",
            **stage.effort(),
            "commit": str(config.get("commit") or "–")[:12],
            "store": str(config.get("store_fingerprint", "–"))[:12],
            "weights (sha256)": weights.get(path.name, "–")[:12],
        }
        found.append(StageTraining(path.name, facts, stage.read_metrics()))
    return found


def training_figure(stages: Sequence[StageTraining], width_inches: float = 12.0) -> Figure | None:
    """Logged values of each stage over its steps, on logarithmic axes; None if there are none."""
    logged = [stage for stage in stages if stage.lines]
    if not logged:
        return None
    columns = min(COLUMNS, len(logged))
    rows = -(-len(logged) // columns)
    figure = Figure(figsize=(width_inches, 3.2 * rows), layout="constrained")
    places = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, stage in zip(places, logged, strict=False):
        for number, name in enumerate(dict.fromkeys(key for line in stage.lines for key in line if key not in CLOCK)):
            there = [line for line in stage.lines if line.get(name, 0.0) > 0]
            axes.plot(
                [line["step"] for line in there],
                [line[name] for line in there],
                color=CURVE_COLOURS[number % len(CURVE_COLOURS)],
                linewidth=1.8 if name == "loss" else 0.9,
                label=name,
            )
        axes.set_yscale("log")
        axes.set_title(stage.name, fontsize=10, loc="left")
        axes.set_xlabel("steps", fontsize=8.5)
        axes.tick_params(labelsize=8, which="both")
        axes.grid(axis="y", color="#E4E4E4", linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(fontsize=7.5, frameon=False)
    for unused in places[len(logged) :]:
        unused.set_visible(False)
    return figure


def run_card(run: Path, motions: Sequence[tuple[str, str]] = ()) -> str:
    """An article about a run for the report's page; `motions` are titles and pages of animated skeletons.

    Raises as `stages_of`.
    """
    stages = stages_of(run)
    figure = training_figure(stages)
    return card("run.html.j2", name=run.name, stages=stages, figure=figure, motions=motions)
