"""One input of the fuzz part again, by the name under which its failure was reported; its error is raised unchanged.

python -m benchmarks.trust.fuzz READER:SEED:NUMBER [--keep FOLDER]
"""

import argparse
import shutil
import tempfile
from pathlib import Path

from benchmarks.trust.fuzz.targets import all_targets
from benchmarks.trust.fuzz.workers import damaged_source, prepare, try_input


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.trust.fuzz",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("input", metavar="READER:SEED:NUMBER")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="leave the damaged source here")
    parser.add_argument("--limits", action="store_true", help="set the limits, as the drill does, and say the outcome")
    arguments = parser.parse_args()
    name, seed, number = arguments.input.rsplit(":", 2)
    [target] = [each for each in all_targets() if each.name == name]
    with tempfile.TemporaryDirectory(prefix="motionkit-fuzz-") as temporary:
        prepare([target], Path(temporary))
        folder = Path(temporary) / name
        if arguments.limits:
            print(try_input(target, int(seed), int(number), folder))
            return
        with damaged_source(target, int(seed), int(number), folder) as place:
            if arguments.keep is not None:
                shutil.copytree(place, arguments.keep)
            target.use(place)
    print("read without complaint")


if __name__ == "__main__":
    main()
