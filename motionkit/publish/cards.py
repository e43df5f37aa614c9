"""Cards (README.md) of repositories: a store's content and licences, a run's training and results."""

from collections.abc import Sequence
from typing import Any

from motionkit.edit.export.files import render
from motionkit.edit.export.parquet import NO_LICENCE, card_head
from motionkit.store.hub.repository import Repository
from motionkit.store.reports.summary import StoreSummary
from motionkit.training.run import StageFolder


def store_card(summary: StoreSummary, repository: Repository) -> str:
    """The card of a store: sources with their framerates and licences, and how to read it."""
    licences = {name or NO_LICENCE for source in summary.sources for name in source.licences}
    return render(
        "store_card.md.j2",
        **card_head(licences, summary.num_sequences),
        summary=summary,
        repository=repository,
        no_licence=NO_LICENCE,
    )


def run_card(stages: Sequence[StageFolder], repository: Repository) -> str:
    """The card of a run: each stage's recipe, store and figures, and how to use it."""
    return render("run_card.md.j2", stages=[_stage(each) for each in stages], repository=repository)


def _stage(stage: StageFolder) -> dict[str, Any]:
    config = stage.read_config()
    figures = {name: value for name, value in stage.read_summary().items() if isinstance(value, int | float)}
    return {
        "name": stage.path.name,
        "recipe": config.get("recipe", ""),
        "seed": config.get("seed", ""),
        "store": config.get("store_fingerprint", ""),
        "torch": config.get("versions", {}).get("torch", ""),
        "motionkit": config.get("versions", {}).get("motionkit", ""),
        "figures": ", ".join(f"{name} {value:.4g}" for name, value in figures.items()),
    }
