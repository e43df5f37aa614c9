"""P14: what clip-FID costs: a column of Table 2 at each framerate, and its distances beside scipy's matrix root.

    python -m benchmarks.eval.clip_fid [--clips 4096] [--replications 20] [--json]

A column is `eval.clip_fid` of two sets of sixty smooth motions of 10 s. The peer computes FID as published evaluators
do, with scipy.linalg.sqrtm, of as many samples of as many features. CPU seconds of this process.
"""

import time
from collections.abc import Callable

import numpy as np
import scipy.linalg

from benchmarks.command import arguments_parser, best_cpu_seconds, print_json
from eval import clip_fid
from eval.metrics.distributions import fid, kid, prdc

RATES = (20, 40, 60, 100, 120)
NUM_FEATURES = 49


def smooth_motions(
    fps: int, generator: np.random.Generator, count: int = 60, seconds: float = 10.0
) -> list[np.ndarray]:
    """Joints on sums of slow sines."""
    instants = np.arange(int(seconds * fps))[:, None, None] / fps
    motions = []
    for _ in range(count):
        phase, rate = generator.uniform(0, 6, (22, 3)), generator.uniform(1, 9, (22, 3))
        motions.append((0.2 * np.sin(rate * instants + phase)).astype(np.float32))
    return motions


def fid_by_square_root(x: np.ndarray, y: np.ndarray) -> float:
    """FID as published evaluators compute it."""
    a, b = np.cov(x, rowvar=False), np.cov(y, rowvar=False)
    root = scipy.linalg.sqrtm(a @ b).real
    return float(((x.mean(0) - y.mean(0)) ** 2).sum() + np.trace(a + b - 2 * root))


def columns(clips: int, replications: int) -> dict[str, float]:
    """CPU seconds of a column at each framerate."""
    figures = {}
    for fps in RATES:
        real, generated = (smooth_motions(fps, np.random.default_rng(seed)) for seed in (0, 1))
        begun = time.process_time()
        clip_fid(real, generated, fps=fps, clips=clips, replications=replications)
        figures[f"column, {fps} fps"] = time.process_time() - begun
    return figures


def distances(clips: int) -> dict[str, float]:
    """CPU seconds of distances between two sets of features."""
    generator = np.random.default_rng(0)
    x, y = generator.standard_normal((2, clips, NUM_FEATURES))
    np.testing.assert_allclose(fid(x, y), fid_by_square_root(x, y), rtol=1e-6)
    work: dict[str, Callable[[], object]] = {
        "FID": lambda: fid(x, y),
        "peer: FID by scipy.linalg.sqrtm": lambda: fid_by_square_root(x, y),
        "KID": lambda: kid(x, y),
        "precision, recall, density, coverage": lambda: prdc(x, y),
    }
    return {name: best_cpu_seconds(each, 5) for name, each in work.items()}


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("--clips", type=int, default=4096)
    parser.add_argument("--replications", type=int, default=20)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    figures = columns(arguments.clips, arguments.replications) | distances(arguments.clips)
    if arguments.json:
        print_json({"clips": arguments.clips, "cpu_seconds": figures})
        return
    for name, seconds in figures.items():
        print(f"{name:38} {seconds:8.4f} CPU s")


if __name__ == "__main__":
    main()
