"""Defers Ctrl-C and SIGTERM during critical sections."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

STOPPING = (signal.SIGTERM, signal.SIGINT)


@contextmanager
def defer_signals() -> Iterator[None]:
    """Deliver Ctrl-C and SIGTERM only after the block, however it ends; for short blocks.

    Blocks may be nested. Does nothing outside the main thread, where no signals are handled.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    # None: a handler that was not set from Python and cannot be restored.
    previous = {number: handler for number in STOPPING if (handler := signal.getsignal(number)) is not None}
    try:
        for number in previous:
            signal.signal(number, lambda arrived, frame: came.append(arrived))
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
        for arrived in came:
            signal.raise_signal(arrived)


_stopped: list[int] = []


def stop_by_signals() -> None:
    """Let Ctrl-C and SIGTERM raise `KeyboardInterrupt`, so that cleanup runs; see `was_stopped`.

    A library may convert the exception, or print it where it cannot be raised.
    """
    for number in STOPPING:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, _stop)


def was_stopped() -> bool:
    """Whether one of the signals was received since `stop_by_signals`."""
    return bool(_stopped)


def _stop(number: int, frame: object) -> None:
    _stopped.append(number)
    sys.unraisablehook = lambda unraisable: None
    raise KeyboardInterrupt


def stop_no_more() -> None:
    """Ignore Ctrl-C and SIGTERM from here on, for a process that is about to exit."""
    for number in STOPPING:
        signal.signal(number, signal.SIG_IGN)
