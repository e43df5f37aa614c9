"""Signals that come in the middle of something are delivered after it."""

import signal
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from motionkit.core.interrupts import defer_signals

NUMBERS = [signal.SIGINT, signal.SIGTERM]


@pytest.fixture(autouse=True)
def both_interrupt() -> Iterator[None]:
    """SIGTERM raises `KeyboardInterrupt` too, and afterwards both do what they did."""
    previous = [signal.signal(number, signal.default_int_handler) for number in NUMBERS]
    yield
    for number, handler in zip(NUMBERS, previous, strict=True):
        signal.signal(number, handler)


@pytest.mark.parametrize("number", NUMBERS)
def test_a_signal_waits_for_the_end_of_all_blocks(number: signal.Signals) -> None:
    done = []
    with pytest.raises(KeyboardInterrupt), defer_signals():
        with defer_signals():
            signal.raise_signal(number)
            done.append("inner")
        done.append("outer")
    assert done == ["inner", "outer"]
    assert signal.getsignal(number) is signal.default_int_handler


def test_it_is_delivered_where_the_block_fails_too() -> None:
    with pytest.raises(KeyboardInterrupt) as caught, defer_signals():
        signal.raise_signal(signal.SIGINT)
        raise ValueError("a fault")
    assert isinstance(caught.value.__context__, ValueError)


def test_without_a_signal_nothing_happens() -> None:
    with defer_signals():
        pass
    with pytest.raises(ValueError, match="a fault"), defer_signals():
        raise ValueError("a fault")
    assert [signal.getsignal(number) for number in NUMBERS] == [signal.default_int_handler] * 2


def test_in_another_thread_the_handlers_stay() -> None:
    seen = []

    def work() -> None:
        with defer_signals():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [signal.default_int_handler]


def test_a_signal_that_ends_the_process_does_so_after_the_block() -> None:
    code = (
        "import signal; from motionkit.core.interrupts import defer_signals\n"
        "with defer_signals():\n    signal.raise_signal(signal.SIGTERM); print('done', flush=True)\nprint('never')"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stdout) == (-signal.SIGTERM, "done\n")
