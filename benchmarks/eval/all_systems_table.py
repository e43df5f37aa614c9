"""The table and the figure of all systems, from the results that benchmarks.eval.all_systems has written.

    python -m benchmarks.eval.all_systems_table [--results RESULTS] [--image docs/images/all-systems.png]

A row's figures are of planted motion, means over the training seeds; clip-FID with the lowest and the highest. Results
in the folder `slower` are of another machine, and have columns of their own.
"""

import json
import math
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from benchmarks.command import arguments_parser
from benchmarks.eval.all_systems import title
from motionkit.generate.models import installed_models

FPS, PLANTED = "60 fps", ", planted"
FRAMERATES = ("20 fps", FPS, "120 fps")
TICKS = (2, 5, 10, 20, 50)
# Half an hour; six minutes and half an hour of a slower machine.
MARKS = ("o", "x", "s")
OTHERS = ("recall", "precision", "T", "12–18 Hz", "R-Precision, top 3 ↑")
REFERENCES = ("training takes, as a generator", "training takes, as long as generated motions")

Figures = Mapping[str, float]


def figures_of(folder: Path) -> dict[str, dict[str, float]]:
    """The figures of each planted row of a run's results, and of real motion, by column."""
    rows: dict[str, dict[str, float]] = {}
    for table, beginning in (("2", "clip-FID"), ("2", f"Detail profile, {FPS}"), ("1", "Table 1")):
        path = folder / f"nerm-table{table}.json"
        for block in json.loads(path.read_text())["blocks"] if path.is_file() else ():
            if not block["title"].startswith(beginning) or "differences" in block["title"]:
                continue
            for row in block["rows"]:
                if row["name"] in REFERENCES or row["name"].endswith(PLANTED):
                    found = rows.setdefault(row["name"].removesuffix(PLANTED), {})
                    found |= {column: cell["value"] for column, cell in row["cells"].items()}
                    # Precision and recall are details of a clip-FID.
                    found |= row["cells"].get(FPS, {}).get("details", {})
    return rows


def spread(values: Sequence[float]) -> str:
    """The mean of the training seeds, with the lowest and the highest if they differ."""
    mean = f"{np.mean(values):.3g}" if values else "–"
    return mean if len({f"{value:.3g}" for value in values}) < 2 else f"{mean} ({min(values):.3g} to {max(values):.3g})"


def median(found: Sequence[Figures], column: str = FPS) -> float:
    """The median of a column over seeds; infinity without any."""
    return float(np.median([each[column] for each in found if column in each] or [math.inf]))


def by_budget(results: Path) -> dict[float, list[dict[str, dict[str, float]]]]:
    """The figures of every seed by its budget in seconds, the smallest first."""

    def budget(path: Path) -> float:
        return float(path.name.partition("s-")[0])

    paths = sorted(sorted(results.glob("*s-[0-9]")), key=budget)
    return {seconds: list(map(figures_of, seeds)) for seconds, seeds in groupby(paths, budget)}


def draw(rows: Mapping[str, Sequence[Figures]], others: Sequence[Mapping[str, Sequence[float]]], path: Path) -> None:
    """clip-FID of planted motion by system: a dot for each training seed, another mark for each other training."""
    systems = sorted((name for name in rows if name not in REFERENCES), key=lambda name: -median(rows[name]))
    figure, axes = plt.subplots(figsize=(7, 0.34 * len(systems) + 1.2), layout="constrained")
    for place, name in enumerate(systems):
        values = [each[FPS] for each in rows[name] if FPS in each]
        axes.plot(values, [place] * len(values), "o", color="tab:blue", markersize=5)
        for mark, other in zip(MARKS, others, strict=False):
            axes.plot(
                other[name], [place] * len(other[name]), mark, color="tab:blue", markersize=8, markerfacecolor="none"
            )
    for name in REFERENCES:
        axes.axvline(median(rows[name]), color="0.6", linewidth=1)
    axes.set(xscale="log", xlabel=f"clip-FID of planted motion at {FPS}")
    axes.set_xticks(TICKS, map(str, TICKS))
    axes.minorticks_off()
    axes.set_yticks(range(len(systems)), systems)
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("--results", type=Path, default=Path("docs/results/all-systems"))
    parser.add_argument("--image", type=Path)
    given = parser.parse_args()
    (_, first), *trainings = [
        (f"{FPS}, {budget / 60:g} minutes{of_machine}", seeds)
        for folder, of_machine in ((given.results, ""), (given.results / "slower", ", slower machine"))
        for budget, seeds in by_budget(folder).items()
    ]
    names = (*REFERENCES, *map(title, installed_models()))
    rows = {name: [each.get(name, {}) for each in first] for name in names}
    others = [{name: [each[name][FPS] for each in seeds if name in each] for name in names} for _, seeds in trainings]
    columns = (*FRAMERATES, *OTHERS)
    print(" | ".join(("|", *columns, *(heading for heading, _ in trainings))) + " |")
    print("|---" * (len(columns) + len(trainings) + 1) + "|")
    for name, found in sorted(rows.items(), key=lambda row: (row[0] not in REFERENCES, median(row[1]))):
        values = {column: [each[column] for each in found if column in each] for column in columns}
        texts = [spread(values[column]) for column in FRAMERATES]
        texts += [f"{np.mean(values[column]):.2g}" if values[column] else "–" for column in OTHERS]
        print(" | ".join((f"| {name}", *texts, *(spread(other[name]) for other in others))) + " |")
    if given.image:
        draw(rows, others, given.image)


if __name__ == "__main__":
    main()
