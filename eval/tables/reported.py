"""The figures that the papers report (eval/data/reported.csv): theirs, never ours."""

import csv
from dataclasses import dataclass
from importlib.resources import files

SOURCES = {
    "nerm": "Wei et al., NeRM: Learning Neural Representations for High-Framerate Human Motion Synthesis, ICLR 2024",
    "pahires": "Xu et al., Towards Arbitrary Motion Completing via Hierarchical Continuous Representation",
    "lafan1": "Harvey et al., Robust Motion In-betweening, ACM TOG 2020 (its benchmark's code)",
    "delta-interp": "Oreshkin et al., Motion In-betweening via Deep Δ-Interpolator, IEEE TVCG 2023",
    "ts-former": "Qin et al., Motion In-betweening via Two-stage Transformers, ACM TOG 2022",
}


@dataclass(frozen=True)
class Reported:
    """One printed figure; `value` or `ci95` is None where the paper prints none or it is illegible."""

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
    text = (files("eval") / "data" / "reported.csv").read_text(encoding="utf-8")
    return [
        Reported(
            paper=row["paper"],
            table=row["table"],
            dataset=row["dataset"],
            method=row["method"],
            metric=row["metric"],
            setting=row["setting"],
            value=_number(row["value"]),
            ci95=_number(row["ci95"]),
            note=row["note"],
        )
        for row in csv.DictReader(text.splitlines())
        if (row["paper"], row["table"]) == (paper, table)
    ]


def _number(text: str) -> float | None:
    return float(text) if text else None
