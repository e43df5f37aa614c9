"""The app, assembled from entry points: each `motionkit.commands` entry is one typer command.

An entry point names a command (`ingest`, `train` …) and a function, or a typer app of several (`study`). Nothing heavy
may be imported by the module that holds it, so that `motionkit --help` stays light. Anybody's package can add a command
the same way.
"""

import os
import sys
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from inspect import getdoc
from typing import Annotated, Any

import typer

from motionkit.cli.console import show_warnings, stderr, stdout
from motionkit.cli.start import was_stopped
from motionkit.core.errors import MotionkitError, UsageError, describe

# The exit code after Ctrl-C.
INTERRUPTED = 130


def build_app(only: str = "") -> typer.Typer:
    """A typer app with every registered command in alphabetical order, or only the one of this name if it exists.

    Loading all of them takes a tenth of a second.
    """
    app = typer.Typer(
        name="motionkit",
        help="Human motion at native framerates: a corpus, continuous-time models, one evaluator suite.",
        no_args_is_help=True,
        invoke_without_command=True,
        pretty_exceptions_enable=False,
    )
    app.callback()(_options)
    entries = entry_points(group="motionkit.commands")
    for entry in sorted(entries.select(name=only) or entries, key=lambda entry: entry.name):
        loaded = _loaded(entry)
        if isinstance(loaded, typer.Typer):
            app.add_typer(loaded, name=entry.name)
        else:
            app.command(name=entry.name, help=_paragraphs(loaded))(loaded)
    return app


def _paragraphs(command: Any) -> str:
    """A command's docstring, each paragraph in one line: the terminal breaks it at its own width."""
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in (getdoc(command) or "").split("\n\n"))


def _loaded(entry: EntryPoint) -> Any:
    """Load an entry point; raises `MotionkitError`, since a repository's own package may shadow the installed one."""
    try:
        return entry.load()
    except Exception as error:
        package = entry.module.partition(".")[0]
        found = find_spec(package)
        raise MotionkitError(
            f"the command {entry.name!r} cannot be loaded ({describe(error)}): Python finds {package!r} in "
            f"{found.origin if found else 'no folder'}; another project's? Leave its folder out of PYTHONPATH"
        ) from error


def _options(
    version: Annotated[bool, typer.Option("--version", help="Print motionkit's version.")] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", help="With --version: packages, device, threads and extras too.")
    ] = False,
) -> None:
    # Options of `motionkit` itself.
    if version or verbose:
        from motionkit.cli.versions import version_lines

        for line in version_lines(verbose):
            stdout.print(line)
        raise typer.Exit


def _resumes(app: typer.Typer, names: list[str]) -> bool:
    """Whether the command of this name has --resume."""
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    return any("--resume" in each.opts for name in names if name in commands for each in commands[name].params)


def main() -> None:
    """Run the app; motionkit's errors and the system's become one line on stderr and exit code 1 (2 for usage)."""
    # OpenMP reads it when torch is loaded. Threads that spin while they wait take the processor from those waited for:
    # beside other processes on all processors a training step then takes ten times as long.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    show_warnings()
    try:
        names = sys.argv[1:2]
        app = build_app(*names)
        app()
    except (MotionkitError, OSError) as error:
        if was_stopped():
            raise  # not an interrupt that a library converted
        if isinstance(error, UsageError):
            stderr.print(f"motionkit: {error}")
            sys.exit(2)
        # Such as missing permissions or a full disk: the system names the file and the reason.
        stderr.print(f"motionkit: {describe(error)}")
        sys.exit(1)
    except SystemExit as ended:
        # What typer raises for an interrupt.
        if ended.code == INTERRUPTED:
            stderr.print("motionkit: stopped: --resume goes on" if _resumes(app, names) else "motionkit: stopped")
        raise
