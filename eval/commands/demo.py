"""`motionkit demo`: the whole job on the embedded corpus."""

from contextlib import nullcontext, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from motionkit.cli.console import print_json, stderr, stdout

if TYPE_CHECKING:
    from eval.commands.demo_steps import DemoOutcome


def demo(
    folder: Annotated[Path, typer.Option(help="Folder for corpus, store, run, motions, table and picture.")] = (
        Path("demo")
    ),
    smallest: Annotated[
        bool, typer.Option("--smallest", help="Only to see that everything works: its numbers mean nothing.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Everything random follows from it.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print Table 2 and where everything lies as JSON.")] = False,
) -> None:
    """Do the whole job on an embedded corpus: ingest, train NeRM, generate, evaluate Table 2, draw it.

    Example: motionkit demo --smallest
    """
    import sys

    from eval.commands.demo_steps import FULL, SMALLEST, DemoFolder, run_demo

    # With --json, what the steps print is progress: stdout holds one document.
    with redirect_stdout(sys.stderr) if as_json else nullcontext():
        outcome = run_demo(DemoFolder(folder), SMALLEST if smallest else FULL, seed)
    if as_json:
        _print_json(outcome)
    else:
        _print_places(outcome)


def _places(outcome: "DemoOutcome") -> dict[str, str]:
    folder = outcome.folder
    return {
        "corpus": str(folder.corpus),
        "store": str(folder.store),
        "run": str(folder.runs),
        "motions": str(folder.generated),
        "table": str(folder.results),
        "picture": str(folder.picture),
    }


def _print_places(outcome: "DemoOutcome") -> None:
    steps = ", ".join(f"{name} {seconds:.0f} s" for name, seconds in outcome.seconds.items())
    stderr.print(f"demo: {steps}")
    for name, place in _places(outcome).items():
        stdout.print(f"{name + ':':9} {place}")


def _print_json(outcome: "DemoOutcome") -> None:
    from dataclasses import asdict

    from eval.report.results import read_result

    table = asdict(read_result(outcome.folder.results / "nerm-table2.json"))
    print_json({"places": _places(outcome), "seconds": outcome.seconds, "table": table})
