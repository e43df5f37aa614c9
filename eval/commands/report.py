"""`motionkit report`: every result as one page."""

from collections.abc import Iterator
from dataclasses import asdict, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from motionkit.cli.console import AsJson, Overwrite, RunsFolder, print_json, print_text, progress, stderr
from motionkit.core.errors import UsageError, counted
from motionkit.core.files import default_path, require_new, write_whole
from motionkit.core.progress import task

if TYPE_CHECKING:
    from motionkit.core.progress import OnProgress

NUM_CAPTIONS, FPS, SHORTEST_SHOWN_SECONDS, LONGEST_SHOWN_SECONDS = 2, Fraction(60), 2.0, 6.0


def report(
    results: Annotated[Path | None, typer.Option(help="Folder with the JSON results.")] = None,
    out: Annotated[Path | None, typer.Option(help="Page to write, or folder for pictures; beside the results.")] = None,
    format: Annotated[str, typer.Option(help="html: a page; png: curves; markdown, latex, csv: on stdout.")] = "html",
    store: Annotated[Path | None, typer.Option(help="With html: begin with what this store holds.")] = None,
    run: Annotated[list[str] | None, typer.Option(help="With html: this run's training; with --store motions.")] = None,
    runs: RunsFolder = None,
    only_samples: Annotated[
        bool, typer.Option("--samples-only", help="Rows of --samples, real motion and papers; none of a run's models.")
    ] = False,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Show every result of the results folder: one HTML page, pictures, or Markdown, LaTeX or CSV on stdout.

    With --store the page begins with what the store holds, with --run it says how runs were trained, and with both it
    shows what their models answer to held-out captions. Unreadable results are listed, and the exit code is 1.

    Example: motionkit report --store store --run nano
    """
    from eval.report.results import ResultError, find_results, samples_only, to_csv, to_latex, to_markdown

    folder = results or default_path("results")
    shown, faults = find_results(folder)
    for fault in faults:
        stderr.print(f"left out: {fault}")
    if not shown and not faults and not run:
        raise UsageError(f"there is no result in {str(folder)!r}: motionkit eval --table 2 makes one")
    if only_samples:
        shown = [samples_only(result) for result in shown if result.provenance.get("samples")]
        if not shown or run:
            raise UsageError("--samples-only shows results of 'motionkit eval --samples', without --run")
    printers = {"markdown": to_markdown, "latex": to_latex, "csv": to_csv}
    if out is not None and (as_json or format in printers):
        raise UsageError("--out is for html and png: JSON, Markdown, LaTeX and CSV go to stdout")
    if (store or run) and (as_json or format != "html"):
        raise UsageError("--store and --run are for the page, --format html")
    # What lies in the folder of results is renewed, as eval does.
    for path in () if out is None else [out] if format == "html" else [out / f"{each.task}.png" for each in shown]:
        require_new(path, overwrite=overwrite, instead="--out writes elsewhere")
    if as_json:
        print_json([asdict(result) for result in shown])
    elif format in printers:
        print_text("\n".join(printers[format](result) for result in shown))
    elif format == "html":
        from eval.report.curves import figure_of, run_card
        from eval.report.results import to_html
        from motionkit.edit.export import render
        from motionkit.store import Store
        from motionkit.store.reports import summarise

        with progress() as show:
            cards = [] if store is None else [render("corpus_card.html.j2", summary=summarise(Store.open(store)))]
            places = [(runs or default_path("runs")) / name for name in run or ()]
            cards += [run_card(each, [] if store is None else list(_motions(each, store, show))) for each in places]
        figures = {number: figure for number, each in enumerate(shown) if (figure := figure_of(each)) is not None}
        page = out or folder / "report.html"
        write_whole(page, to_html(shown, cards=cards, figures=figures))
        print(page)
        stderr.print(counted(len(shown), "result"))
    elif format == "png":
        from eval.report.curves import figure_of, save

        for result in shown:
            if (figure := figure_of(result)) is not None:
                print(save(figure, (out or folder) / f"{result.task}.png"))
    else:
        raise UsageError(f"there is no format {format!r}: html, png, {', '.join(printers)}")
    if faults:
        raise ResultError(
            f"cannot be read: {len(faults)} of {counted(len(faults) + len(shown), 'result')} in {str(folder)!r}"
        )


def _motions(run: Path, store: Path, show: "OnProgress") -> Iterator[tuple[str, str]]:
    """For some held-out captions, a page of the real motion beside each model's planted one."""
    import numpy as np

    from eval.sets.motions import real_motion
    from eval.sets.sets import Missing
    from eval.study.trials import of_model, of_motions
    from eval.tables.systems import trained_models
    from motionkit.core.skeleton import SMPL22
    from motionkit.store import Store
    from motionkit.viz.player import Panel, page_of

    held_out = real_motion(Store.open(store), "test")
    real, rates = of_motions(held_out), held_out.fps
    shuffled = np.random.default_rng(0).permutation(len(real.captions)).tolist()
    order = [index for index in shuffled if real.seconds[index] >= SHORTEST_SHOWN_SECONDS]
    captioned = {real.captions[index]: index for index in order if real.captions[index]}
    chosen = list(captioned.values() or order)[:NUM_CAPTIONS]
    captions, seconds = (tuple(values[index] for index in chosen) for values in (real.captions, real.seconds))
    models = trained_models(run, Missing()).values()
    with task(show, "motions", len(chosen) * (len(models) + 1)) as work:
        prompts = replace(real, captions=captions, seconds=seconds)
        generated = [of_model(each.loaded, [prompts], 0, LONGEST_SHOWN_SECONDS) for each in models]
        for number, index in enumerate(chosen):
            panels = []
            for system, place in [(real, index), *((each, number) for each in generated)]:
                fps = FPS if system is not real or system.has(index, FPS) else rates[index]
                positions = system.positions(place, fps)[: int(LONGEST_SHOWN_SECONDS * fps)]
                panels.append(Panel(system.name, positions, SMPL22, fps))
                work.advance()
            yield real.captions[index] or f"Motion {number + 1}", page_of("", panels)
