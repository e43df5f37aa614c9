"""The command line, assembled from the `COMMANDS` of all installed packages (`motionkit.core.plugins`).

A command is a function, or a typer app of several (`study`). Nothing heavy may be imported by the module that holds it,
so that `motionkit --help` stays light. The imports of this module are few, since every worker process loads it.
"""

import gc
import os
import signal
import sys
from typing import TYPE_CHECKING, Annotated

if TYPE_CHECKING:
    import typer

# The exit code after Ctrl-C.
INTERRUPTED = 130
SIGNALS = (signal.SIGTERM, signal.SIGINT)
_received: list[int] = []
# The panels of `motionkit --help`, in README's order; other packages' commands come after them.
PANELS = {
    "Without training": "view complete convert generate plant ingest info",
    "The whole job": "demo",
    "On your own captures": "split train eval report",
    "How to": "samples study ablate export pack push pull serve",
    "A store's life": "query validate merge remove compact",
}


def build_app(only: str = "") -> "typer.Typer":
    """A typer app with every registered command in the order of `PANELS`, or only the one of this name if it exists.

    Loading all of them takes a tenth of a second.
    """
    from inspect import getdoc

    import typer

    from motionkit.core import plugins

    app = typer.Typer(
        name="motionkit",
        help="Human motion at native framerates: a corpus, continuous-time models, one evaluator suite.",
        no_args_is_help=True,
        invoke_without_command=True,
        pretty_exceptions_enable=False,
    )

    @app.callback()
    def print_version(
        version: Annotated[bool, typer.Option("--version", help="Print motionkit's version.")] = False,
    ) -> None:
        # Options of `motionkit` itself.
        if version:
            from motionkit.core import __version__

            print(f"motionkit {__version__}")
            raise typer.Exit

    try:
        commands = {only: plugins.load("COMMANDS", only)}
    except KeyError:
        commands = plugins.load_all("COMMANDS")
    panel_of = {name: panel for panel, names in PANELS.items() for name in names.split()}
    for name in sorted(commands, key=[*panel_of, *commands].index):
        command, panel = commands[name], panel_of.get(name, "Of other packages")
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name, rich_help_panel=panel)
        else:
            # Each paragraph in one line: the terminal breaks it at its own width.
            paragraphs = (" ".join(text.split()) for text in (getdoc(command) or "").split("\n\n"))
            app.command(name=name, help="\n\n".join(paragraphs), rich_help_panel=panel)(command)
    return app


def run() -> None:
    """Run the app; motionkit's errors and the system's become one line on stderr and exit code 1 (2 for usage)."""
    from motionkit.cli.console import show_warnings, stderr
    from motionkit.core.errors import MotionkitError, UsageError, describe

    # OpenMP reads it when torch is loaded. Threads that spin while they wait take the processor from those waited for:
    # beside other processes on all processors a training step then takes ten times as long.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    show_warnings()
    try:
        build_app(*sys.argv[1:2])()
    except (MotionkitError, OSError) as error:
        if _received:
            raise  # not an interrupt that a library converted
        # Such as missing permissions or a full disk: the system names the file and the reason.
        stderr.print(f"motionkit: {describe(error)}")
        sys.exit(2 if isinstance(error, UsageError) else 1)
    except SystemExit as ended:
        # What typer raises for an interrupt.
        if ended.code == INTERRUPTED:
            stderr.print("motionkit: stopped")
        raise


def stop_by_signals() -> None:
    """Let Ctrl-C and SIGTERM raise `KeyboardInterrupt`, so that cleanup runs."""

    def stop(number: int, frame: object) -> None:
        _received.append(number)
        # Where the exception cannot be raised, Python would print it.
        sys.unraisablehook = lambda unraisable: None
        raise KeyboardInterrupt

    for number in SIGNALS:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, stop)


def main() -> None:
    """The script `motionkit`: run the command line, then exit at once."""
    try:
        stop_by_signals()
        run()
    except SystemExit:
        raise  # the reason has been printed
    except BaseException:
        if not _received:  # a library may have converted the exception
            raise
        print("motionkit: stopped", file=sys.stderr)
        sys.exit(INTERRUPTED)
    finally:
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        # What is left goes with the process: Python's last search for cycles in it takes a tenth of a second, a whole
        # one with torch. Without it duckdb's library would tell of leaks.
        if "duckdb" not in sys.modules:
            gc.freeze()
