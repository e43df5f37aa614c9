"""A store's summary as self-contained HTML: sources, framerates, durations, splits, licences, flags."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from motionkit.edit.export.files import render

if TYPE_CHECKING:
    from motionkit.store.reports import SourceSummary, StoreSummary


def corpus_card(summary: "StoreSummary") -> str:
    """An `<article>` to embed in a page, with its own style."""
    return _rendered(summary, whole=False)


def corpus_page(summary: "StoreSummary") -> str:
    """A self-contained page."""
    return _rendered(summary, whole=True)


def _rendered(summary: "StoreSummary", *, whole: bool) -> str:
    drawn = [(source, list(_counted(source))) for source in summary.sources]
    return render("corpus_card.html.j2", summary=summary, sources=drawn, whole=whole)


def _counted(source: "SourceSummary") -> Iterator[tuple[str, dict[str, int]]]:
    """What is counted of a source: a title, and how many of its sequences each value has."""
    counts = {
        "framerate (fps)": source.framerates,
        "duration": source.durations,
        "split": source.splits,
        "licence": source.licences,
        "format": source.formats,
        "flags": source.quality_flags,
    }
    for title, found in counts.items():
        yield title, {name or "not stated": count for name, count in found.items()}
