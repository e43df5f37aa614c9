"""Variation of the demo's figures: `motionkit demo` with several numbers of threads and seeds, cell by cell.

    python benchmarks/eval/demo_spread.py --threads 1,2 --seeds 0        # the smallest demo; --full: the whole one

Prints the lowest and the highest clip-FID of each row and framerate over all of them, and over those of one seed, which
differ by the order of sums alone. Other processors differ as other threads do, and by their precision (`auto`).
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from eval.report.results import provenance

Cells = Mapping[str, float]


def demo(folder: Path, threads: int, seed: int, options: list[str]) -> Cells:
    """The cells of the first block of Table 2 by "row, column"."""
    command = (sys.executable, "-m", "motionkit", "demo", "--folder", folder, "--seed", seed, "--json", *options)
    done = subprocess.run(
        list(map(str, command)), env={**os.environ, "OMP_NUM_THREADS": str(threads)}, stdout=subprocess.PIPE, check=True
    )
    block = json.loads(done.stdout)["table"]["blocks"][0]
    return {f"{row['name']}, {column}": cell["value"] for row in block["rows"] for column, cell in row["cells"].items()}


def spread(tables: list[Cells]) -> dict[str, tuple[float, float]]:
    """Lowest and highest of each cell that all tables have."""
    shared = [name for name in tables[0] if all(name in table for table in tables)]
    return {name: (min(t[name] for t in tables), max(t[name] for t in tables)) for name in shared}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", default="1,2")
    parser.add_argument("--seeds", default="0")
    parser.add_argument("--full", action="store_true", help="the whole demo, minutes each")
    arguments = parser.parse_args()
    threads, seeds = (list(map(int, text.split(","))) for text in (arguments.threads, arguments.seeds))
    options = [] if arguments.full else ["--smallest"]
    with tempfile.TemporaryDirectory() as folder:
        tables = {
            seed: [demo(Path(folder) / f"{seed}-{count}", count, seed, options) for count in threads] for seed in seeds
        }
    found = {f"seed {seed}, threads {arguments.threads}": spread(each) for seed, each in tables.items()}
    found["all"] = spread([table for each in tables.values() for table in each])
    print(json.dumps({"clip_fid": found, "provenance": provenance()}, indent=2, ensure_ascii=False))


if __name__ == "__main__":
    main()
