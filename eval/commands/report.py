"""`motionkit report`: every result as one page."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from motionkit.cli.console import print_json, print_text, stderr
from motionkit.core.errors import UsageError
from motionkit.core.files import write_whole
from motionkit.core.settings import default_path

if TYPE_CHECKING:
    from eval.report.results import Result


def report(
    results: Annotated[Path | None, typer.Option(help="Folder with the JSON results.")] = None,
    out: Annotated[Path | None, typer.Option(help="Page to write, or folder for pictures; beside the results.")] = None,
    format: Annotated[
        str, typer.Option(help="html for one page; png draws curves; markdown, latex or csv print the tables instead.")
    ] = "html",
    store: Annotated[
        Path | None, typer.Option(help="With html: what this store holds in front of its results.", show_default="none")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print every result as JSON.")] = False,
) -> None:
    """Show every result of the results folder: one HTML page, pictures, or Markdown, LaTeX or CSV on stdout.

    Results that cannot be read are named, and the exit code is 1.

    Example: motionkit report --store store
    """
    from dataclasses import asdict

    from eval.report.render import to_csv, to_html, to_latex, to_markdown
    from eval.report.results import ResultError, find_results

    folder = results or default_path("results")
    there = find_results(folder)
    for fault in there.faults:
        stderr.print(f"left out: {fault}")
    if there.others:
        names = ", ".join(path.name for path in there.others)
        stderr.print(f"not results, and not shown: {names}")
    found = list(there.results)
    if not found and not there.faults:
        raise UsageError(f"there is no result in {str(folder)!r}: motionkit eval --table 2 makes one")
    printers = {"markdown": to_markdown, "latex": to_latex, "csv": to_csv}
    if as_json:
        print_json([asdict(result) for result in found])
    elif format in printers:
        print_text("\n".join(printers[format](result) for result in found))
    elif format == "html":
        page = out or folder / "report.html"
        write_whole(page, to_html(found, cards=[] if store is None else [_card(store)]))
        print(page)
        stderr.print(f"{len(found)} results")
    elif format == "png":
        for path in _pictures(found, out or folder):
            print(path)
    else:
        raise UsageError(f"there is no format {format!r}: html, png, {', '.join(printers)}")
    if there.faults:
        count = len(there.faults)
        raise ResultError(f"{count} of {count + len(found)} results in {str(folder)!r} could not be read (see above)")


def _card(store: Path) -> str:
    from motionkit.export.corpus_card import corpus_card
    from motionkit.store import Store
    from motionkit.store.reports.summary import summarise

    return corpus_card(summarise(Store.open(store)))


def _pictures(results: "list[Result]", folder: Path) -> list[Path]:
    """Draw the calibration and every result with columns of framerates, or of seconds and a quality; what was drawn."""
    from eval.clip_fid.calibration import TASK
    from eval.report.curves import calibration_figure, cost_curve_of, cost_figure, panels_of
    from eval.report.figures import curves_figure, save

    drawn = []
    for result in results:
        panels, cost = panels_of(result), cost_curve_of(result)
        if result.task == TASK:
            figure = calibration_figure(result)
        elif panels:
            figure = curves_figure(panels)
        elif cost:
            figure = cost_figure(cost)
        else:
            continue
        drawn.append(save(figure, folder / f"{result.task}.png"))
    return drawn
