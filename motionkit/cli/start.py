"""The script `motionkit`. Its imports are few, since every worker process loads it."""

import gc
import signal
import sys

SIGNALS = (signal.SIGTERM, signal.SIGINT)
_received: list[int] = []


def stop_by_signals() -> None:
    """Let Ctrl-C and SIGTERM raise `KeyboardInterrupt`, so that cleanup runs."""
    for number in SIGNALS:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, _stop)


def _stop(number: int, frame: object) -> None:
    _received.append(number)
    # Where the exception cannot be raised, Python would print it.
    sys.unraisablehook = lambda unraisable: None
    raise KeyboardInterrupt


def was_stopped() -> bool:
    """Whether one of the signals was received; a library may have converted the exception."""
    return bool(_received)


def main() -> None:
    """Run the command line, then exit at once."""
    try:
        stop_by_signals()
        from motionkit.cli import app

        app.main()
    except SystemExit:
        raise  # the app has printed the reason
    except BaseException:
        if not was_stopped():
            raise
        print("motionkit: stopped", file=sys.stderr)
        sys.exit(130)
    finally:
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        # What is left goes with the process: Python's last search for cycles in it takes a tenth of a second, a whole
        # one with torch. Without it duckdb's library would tell of leaks.
        if "duckdb" not in sys.modules:
            gc.freeze()
