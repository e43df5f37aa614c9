"""What the script `motionkit` runs. It loads nothing of its own, for every process of workers loads it again."""

import gc
import sys


def main() -> None:
    """Run the command line, then leave at once."""
    from motionkit.cli import app

    try:
        app.main()
    finally:
        # What is left goes with the process; to look through it once more takes a tenth of a second. duckdb's library
        # would tell of leaks.
        if "duckdb" not in sys.modules:
            gc.freeze()
