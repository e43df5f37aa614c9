"""Cost of the text metrics: FID of 512 features from 10,000 samples, and a table's row of 20 replications.

    python benchmarks/eval/text_metrics.py [--motions 4640] [--protocol native] [--json]

A row is everything that a protocol reports, from embeddings that are there already: R-Precision 1-3 in both directions,
MM-Dist, FID, Diversity and MultiModality (100 texts x 30 generations), replicated with new generated embeddings each
time; FID_infinity and KID once, where the protocol has them. Embeddings are random: no figure but the time means
anything. CPU seconds of this process, with all its threads, and seconds by the clock. The peer is FID by
scipy.linalg.sqrtm, as published evaluators have it.
"""

import argparse
import json
import time
from collections.abc import Callable

import numpy as np
import scipy.linalg

from eval.metrics.gaussian import fid
from eval.report.results import provenance
from eval.text_motion.pairs import TextMotionPairs
from eval.text_motion.protocol import TextMotionProtocol, find_text_motion_protocol
from eval.text_motion.scores import score_text_motion

FEATURES = 512
FID_SAMPLES = 10_000


def fid_by_square_root(x: np.ndarray, y: np.ndarray) -> float:
    a, b = np.cov(x, rowvar=False), np.cov(y, rowvar=False)
    root = scipy.linalg.sqrtm(a @ b).real
    return float(((x.mean(0) - y.mean(0)) ** 2).sum() + np.trace(a + b - 2 * root))


def row(num_motions: int, protocol: TextMotionProtocol, rng: np.random.Generator) -> Callable[[], object]:
    """All replications of a row, on embeddings drawn beforehand."""
    texts = rng.normal(size=(num_motions, FEATURES)).astype(np.float32)

    def pairs() -> TextMotionPairs:
        return TextMotionPairs(texts, texts + rng.normal(size=texts.shape).astype(np.float32))

    real, draws = pairs(), [pairs() for _ in range(protocol.replications)]
    repeated = rng.normal(size=(100, 30, FEATURES)).astype(np.float32)
    return lambda: score_text_motion(real, draws, protocol, 0, repeated=repeated)


def seconds(work: Callable[[], object]) -> dict[str, float]:
    cpu, clock = time.process_time(), time.perf_counter()
    work()
    return {"cpu": time.process_time() - cpu, "clock": time.perf_counter() - clock}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motions", type=int, default=4640)
    parser.add_argument("--protocol", default="native")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    protocol = find_text_motion_protocol(arguments.protocol)
    rng = np.random.default_rng(0)
    mixing = rng.normal(size=(FEATURES, FEATURES)) / np.sqrt(FEATURES)
    x, y = rng.normal(size=(2, FID_SAMPLES, FEATURES)) @ mixing
    values = {"ours": fid(x, y), "scipy.linalg.sqrtm": fid_by_square_root(x, y)}
    figures = {
        f"FID, {FID_SAMPLES} x {FEATURES}": seconds(lambda: fid(x, y)),
        "the same by scipy.linalg.sqrtm": seconds(lambda: fid_by_square_root(x, y)),
        f"protocol {protocol.name}, {arguments.motions} motions, {protocol.replications} replications": seconds(
            row(arguments.motions, protocol, rng)
        ),
    }
    if arguments.json:
        print(json.dumps({"seconds": figures, "fid": values, "provenance": provenance()}, indent=2))
        return
    print(f"FID {values['ours']!r}, by scipy.linalg.sqrtm {values['scipy.linalg.sqrtm']!r}")
    for name, each in figures.items():
        print(f"{name:52} {each['cpu']:8.2f} s of CPU {each['clock']:8.2f} s by the clock")


if __name__ == "__main__":
    main()
