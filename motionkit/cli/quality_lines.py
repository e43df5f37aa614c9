"""How `motionkit info --quality` is printed."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from motionkit.store.quality_report import Offender, QualityReport, SourceQuality

SHOWN_UPSAMPLED = 20


def quality_lines(report: "QualityReport") -> Iterator[str]:
    """The lines of a report: flags per source, the worst sequences of each flag, what seems upsampled."""
    chosen = f" where {report.where}" if report.where else ""
    yield f"{report.store}: {report.num_sequences:,} sequences{chosen}"
    for source in report.sources:
        yield ""
        yield from _source_lines(source)
    for worst in report.worst:
        yield ""
        yield f"worst {worst.flag} ({worst.column})"
        for offender in worst.offenders:
            yield f"  {_figure(offender.value)} {worst.unit}  {offender.sequence_id}{_place(offender)}"
    if report.upsampled:
        yield ""
        yield "upsampled: captured at a lower framerate than is stated"
        for take in report.upsampled[:SHOWN_UPSAMPLED]:
            stated = f" (stated as {take.stated_fps})" if take.stated_fps else ""
            yield f"  {take.fps:g}{stated} → {take.effective_fps:g} fps  {take.sequence_id}"
        if len(report.upsampled) > SHOWN_UPSAMPLED:
            yield f"  and {len(report.upsampled) - SHOWN_UPSAMPLED:,} more: --json, or motionkit query"


def _source_lines(source: "SourceQuality") -> Iterator[str]:
    yield f"source {source.source or '(unnamed)'}: {source.num_sequences:,} sequences, {source.hours:.2f} h"
    yield f"  {'no flag':14}{source.clean.num_sequences:>8,}  {source.clean.hours:8.2f} h"
    for flag, count in source.flags.items():
        yield f"  {flag:14}{count.num_sequences:>8,}  {count.hours:8.2f} h"
    if source.num_unmeasured:
        yield f"  {source.num_unmeasured:,} not measured yet: motionkit migrate does"


def _figure(value: float) -> str:
    return f"{value:10.0f}" if value == int(value) else f"{value:10.4g}"


def _place(offender: "Offender") -> str:
    return "" if offender.seconds is None else f", at {offender.seconds:.3f} s (frame {offender.frame})"
