"""Reliability and security tests ("the drill"): runs one part, bounded in time and reproducible by its seed.

    python -m benchmarks.trust crash|corruption|fuzz|hostile|load [--seed 0] [--seconds N] [--out FILE.json] [--json]

Each part is a module with `DEFAULT_SECONDS` and `run(seed, seconds, folder) -> Report`. A table goes to stdout (JSON
with --json); --out adds the report to a JSON file, in which the other parts stay. Exit code 1 where anything failed.
"""

import argparse
import importlib
import sys
import tempfile
from pathlib import Path

from benchmarks.trust.report import Report, print_report, store_report
from motionkit.cli.console import print_json

PARTS = ("crash", "corruption", "fuzz", "hostile", "load")


def run_part(part: str, seed: int, seconds: float | None, folder: Path) -> Report:
    """Run one part in an empty folder; `seconds` is the approximate duration, by default the part's own."""
    module = importlib.import_module(f"benchmarks.trust.{part}")
    report: Report = module.run(seed, module.DEFAULT_SECONDS if seconds is None else seconds, folder)
    return report


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.trust", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--seed", type=int, default=0, help="everything random follows from it")
    parser.add_argument("--seconds", type=float, help="about how long; each part has its own default")
    parser.add_argument("--folder", type=Path, help="where the trials are made, and kept; by default a temporary one")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="JSON file to add the report to")
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="motionkit-trust-") as temporary:
        folder = arguments.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        report = run_part(arguments.part, arguments.seed, arguments.seconds, folder)
    if arguments.out is not None:
        store_report(report, arguments.out)
    if arguments.json:
        print_json(report.plain())
    else:
        print_report(report)
    sys.exit(1 if report.failures else 0)


if __name__ == "__main__":
    main()
