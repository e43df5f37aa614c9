"""A store's summary as self-contained HTML: sources, framerates, durations, splits, licences, flags."""

from motionkit.edit.export import render
from motionkit.store.schema import Row


def corpus_card(summary: Row) -> str:
    """An `<article>` to embed in a page, with its own style."""
    sources = []
    for source in summary["sources"]:
        counts = {
            "framerate (fps)": source["framerates"],
            "duration": source["durations"],
            "split": source["splits"],
            "licence": source["licences"],
            "format": source["formats"],
            "flags": source["quality_flags"],
        }
        named = {
            title: {name or "not stated": count for name, count in values.items()} for title, values in counts.items()
        }
        sources.append((source, list(named.items())))
    return render("corpus_card.html.j2", summary=summary, sources=sources)
