"""Cost of a column of Table 2: features of 4,096 clips, FID, KID, PRDC, and a whole replication.

    python benchmarks/eval/clip_fid.py [--clips 4096] [--fps 60] [--json]
    python benchmarks/eval/clip_fid.py --row    a model's whole row: 5 framerates × 20 replications, fits and details

Clips are cut from random smooth motion; times are CPU seconds of this process, medians of `--repeats`; `--row` is run
once, on as many threads as there are processors, and its wall time is given too. The peers are formulas that published
evaluators use: FID by scipy.linalg.sqrtm, PRDC by a full distance matrix.
"""

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import scipy.linalg

from eval.clip_fid.clips import Protocol, describe_clips, draw_clips, place_clips
from eval.clip_fid.features import fit_on, kinematic_source
from eval.clip_fid.score import score_rows
from eval.metrics.gaussian import fid, fid_infinity, kid
from eval.metrics.neighbours import prdc
from eval.report.results import provenance
from eval.sets.sets import SampleSet, sample_set


def smooth_motion(fps: Fraction, num_sequences: int = 60, seconds: float = 10.0) -> SampleSet:
    """Joints on sums of slow sines."""
    rng = np.random.default_rng(0)
    time_seconds = np.arange(int(seconds * float(fps)))[:, None, None] / float(fps)
    sequences = []
    for _ in range(num_sequences):
        phase, rate = rng.uniform(0, 6, (22, 3)), rng.uniform(1, 9, (22, 3))
        sequences.append((0.2 * np.sin(rate * time_seconds + phase)).astype(np.float32))
    return sample_set("smooth", fps, sequences, [str(index) for index in range(num_sequences)])


def fid_by_square_root(x: np.ndarray, y: np.ndarray) -> float:
    a, b = np.cov(x, rowvar=False), np.cov(y, rowvar=False)
    root = scipy.linalg.sqrtm(a @ b).real
    return float(((x.mean(0) - y.mean(0)) ** 2).sum() + np.trace(a + b - 2 * root))


def cpu_seconds(work: Callable[[], object], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        started = time.process_time()
        work()
        times.append(time.process_time() - started)
    return statistics.median(times)


def whole_row(clips: int) -> dict[str, float]:
    """CPU and wall seconds of one model's row of Table 2 once its motions exist, framerate by framerate."""
    figures: dict[str, float] = {"all, CPU": 0.0, "all, wall": 0.0}
    for rate in (20, 40, 60, 100, 120):
        samples, source = smooth_motion(Fraction(rate)), kinematic_source()
        wall, cpu = time.perf_counter(), time.process_time()
        score_rows(samples, {"model": samples}, source.fit(samples), Protocol(num_clips=clips), source.parts)
        figures[f"{rate} fps, CPU"] = time.process_time() - cpu
        figures[f"{rate} fps, wall"] = time.perf_counter() - wall
        for clock in ("CPU", "wall"):
            figures[f"all, {clock}"] += figures[f"{rate} fps, {clock}"]
        print(f"{rate} fps: {figures[f'{rate} fps, wall']:.1f} s", file=sys.stderr, flush=True)
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=4096)
    parser.add_argument("--fps", type=int, default=60)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--row", action="store_true")
    arguments = parser.parse_args()
    if arguments.row:
        show(whole_row(arguments.clips), f"5 framerates × 20 replications of {arguments.clips} clips", arguments.json)
        return
    fps = Fraction(arguments.fps)
    samples = smooth_motion(fps)
    descriptor = fit_on(samples)
    protocol = Protocol(num_clips=arguments.clips)
    real, other = (place_clips(draw_clips(protocol, fps, 0, side), samples) for side in (0, 1))
    x, y = (describe_clips(samples, places, descriptor) for places in (real, other))
    work: dict[str, Callable[[], object]] = {
        "describe the clips": lambda: describe_clips(samples, real, descriptor),
        "FID": lambda: fid(x, y),
        "FID by scipy.linalg.sqrtm": lambda: fid_by_square_root(x, y),
        "FID_infinity": lambda: fid_infinity(x, y, np.random.default_rng(0)),
        "KID": lambda: kid(x, y),
        "PRDC": lambda: prdc(x, y),
    }
    figures = {name: cpu_seconds(each, arguments.repeats) for name, each in work.items()}
    show(figures, f"{arguments.clips} clips at {arguments.fps} fps, CPU", arguments.json)


def show(figures: dict[str, float], title: str, as_json: bool) -> None:
    if as_json:
        print(json.dumps({"title": title, "seconds": figures, "provenance": provenance()}, indent=2))
        return
    print(f"{title}, seconds")
    for name, seconds in figures.items():
        print(f"{name:28} {seconds:8.4f}")


if __name__ == "__main__":
    main()
