"""What the script `motionkit` runs. It loads nothing of its own, for every process of workers loads it again."""

import gc
import sys


def main() -> None:
    """Run the command line, then leave at once."""
    try:
        from motionkit.cli import app

        app.main()
    except KeyboardInterrupt:
        # While commands were loaded; later the app says so.
        print("motionkit: stopped", file=sys.stderr)
        sys.exit(130)
    finally:
        # What is left goes with the process; to look through it once more takes a tenth of a second. duckdb's library
        # would tell of leaks.
        if "duckdb" not in sys.modules:
            gc.freeze()
