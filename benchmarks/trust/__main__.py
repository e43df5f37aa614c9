"""Reliability and security tests ("the drill"): runs one part, bounded in time and reproducible by its seed.

    python -m benchmarks.trust crash|corruption|fuzz [--seed 0] [--seconds N] [--out FILE.json]

A table goes to stdout; --out adds the report to a JSON file, in which the other parts stay. Exit code 1 where anything
failed.
"""

import json
import sys
import tempfile
from pathlib import Path

from benchmarks.command import arguments_parser
from benchmarks.trust import crash, fuzz

# Each with its own time in seconds.
PARTS = {"crash": (crash.run, 300.0), "corruption": (fuzz.run_corruption, 1800.0), "fuzz": (fuzz.run, 1200.0)}


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--seed", type=int, default=0, help="everything random follows from it")
    parser.add_argument("--seconds", type=float, help="about how long; each part has its own default")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="JSON file to add the report to")
    arguments = parser.parse_args()
    run, seconds = PARTS[arguments.part]
    with tempfile.TemporaryDirectory(prefix="motionkit-trust-") as folder:
        report = run(arguments.seed, seconds if arguments.seconds is None else arguments.seconds, Path(folder))
    if arguments.out is not None:
        path: Path = arguments.out
        reports = json.loads(path.read_text("utf-8")) if path.exists() else {}
        reports[report.part] = report.plain()
        path.write_text(json.dumps(dict(sorted(reports.items())), indent=2, ensure_ascii=False) + "\n", "utf-8")
    for case in report.cases:
        figures = ", ".join(f"{name} {value:.4g}" for name, value in case.figures.items())
        print(f"{case.name:36} {case.tried:7,} tried {len(case.failures):5,} failed  {figures}")
    print(*report.failures, sep="\n")
    sys.exit(1 if report.failures else 0)


if __name__ == "__main__":
    main()
