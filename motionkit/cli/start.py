"""The script `motionkit`. Its imports are few, since every worker process loads it."""

import gc
import sys

from motionkit.core import interrupts


def main() -> None:
    """Run the command line, then exit at once."""
    try:
        interrupts.stop_by_signals()
        from motionkit.cli import app

        app.main()
    except SystemExit:
        raise  # the app has printed the reason
    except BaseException:
        if not interrupts.was_stopped():
            raise
        print("motionkit: stopped", file=sys.stderr)
        sys.exit(130)
    finally:
        interrupts.stop_no_more()
        # What is left goes with the process: Python's last search for cycles in it takes a tenth of a second, a whole
        # one with torch. Without it duckdb's library would tell of leaks.
        if "duckdb" not in sys.modules:
            gc.freeze()
