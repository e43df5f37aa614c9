"""Reading a folder of samples: 4,640 .npy files of 196 poses; its memory; upsampling one at a time and many at a time.

python -m benchmarks.eval.sample_folder [--motions 4640] [--json]
"""

import argparse
import json
import resource
import tempfile
import time
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np

from eval.report.results import provenance
from eval.sample_folder import SampleOptions, read_sample_folder
from eval.sets.upsampled import each_upsampled, upsampled_positions
from motionkit.fields.motion_field import to_motion
from tests.helpers.analytic import ACTIONS, analytic_motion

FPS, FAST = Fraction(20), Fraction(60)
NUM_POSES, NUM_UPSAMPLED = 196, 128


def motion(index: int) -> np.ndarray:
    field = analytic_motion(list(ACTIONS)[index % len(ACTIONS)], NUM_POSES / 20 + 0.5, index)
    return to_motion(field, FPS).joint_positions[:NUM_POSES]


def cpu_seconds(work: Callable[[], object]) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start


def peak_megabytes() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motions", type=int, default=4640)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    some = [motion(index) for index in range(16)]
    with tempfile.TemporaryDirectory() as folder:
        for index in range(arguments.motions):
            np.save(Path(folder) / f"{index:06d}.npy", some[index % len(some)])
        before = peak_megabytes()
        start = time.process_time()
        samples = read_sample_folder("mine", Path(folder), SampleOptions(FPS))
        reading, peak = time.process_time() - start, peak_megabytes() - before
    sequences = [samples.sequences[index] for index in range(NUM_UPSAMPLED)]
    singly = cpu_seconds(lambda: [upsampled_positions(sequence, FPS, FAST) for sequence in sequences])
    together = cpu_seconds(lambda: list(each_upsampled(sequences, FPS, FAST)))
    figures = {
        "motions": samples.num_motions,
        "reading, s of CPU": reading,
        "positions, MB": samples.sequences.values.nbytes / 2**20,
        "peak of memory above the start, MB": peak,
        "20 to 60 fps one at a time, ms of CPU a motion": 1000 * singly / len(sequences),
        "20 to 60 fps many at a time, ms of CPU a motion": 1000 * together / len(sequences),
    }
    if arguments.json:
        print(json.dumps(figures | {"provenance": provenance()}, indent=2))
        return
    for name, value in figures.items():
        print(f"{name:50} {value:10.2f}")


if __name__ == "__main__":
    main()
