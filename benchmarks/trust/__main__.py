"""Reliability and security tests ("the drill"): runs one part, bounded in time and reproducible by its seed.

    python -m benchmarks.trust crash|corruption|fuzz [--seed 0] [--seconds N] [--out FILE.json] [--json]

A table goes to stdout (JSON with --json); --out adds the report to a JSON file, in which the other parts stay. Exit
code 1 where anything failed.
"""

import importlib
import json
import sys
import tempfile
from pathlib import Path

from benchmarks.command import arguments_parser
from benchmarks.trust.report import Report


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("part", choices=("crash", "corruption", "fuzz"))
    parser.add_argument("--seed", type=int, default=0, help="everything random follows from it")
    parser.add_argument("--seconds", type=float, help="about how long; each part has its own default")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="JSON file to add the report to")
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    arguments = parser.parse_args()
    module = importlib.import_module(f"benchmarks.trust.{arguments.part}")
    with tempfile.TemporaryDirectory(prefix="motionkit-trust-") as folder:
        seconds = module.DEFAULT_SECONDS if arguments.seconds is None else arguments.seconds
        report: Report = module.run(arguments.seed, seconds, Path(folder))
    if arguments.out is not None:
        path: Path = arguments.out
        reports = json.loads(path.read_text("utf-8")) if path.exists() else {}
        reports[report.part] = report.plain()
        path.write_text(json.dumps(dict(sorted(reports.items())), indent=2, ensure_ascii=False) + "\n", "utf-8")
    if arguments.json:
        print(json.dumps(report.plain(), indent=2, ensure_ascii=False))
    else:
        for case in report.cases:
            figures = ", ".join(f"{name} {value:.4g}" for name, value in case.figures.items())
            print(f"{case.name:36} {case.tried:7,} tried {len(case.failures):5,} failed  {case.skipped or figures}")
        print(*report.failures, sep="\n")
    sys.exit(1 if report.failures else 0)


if __name__ == "__main__":
    main()
