"""Can white noise hide upsampling from clip-FID? Test takes kept at 20 fps, upsampled by SLERP, with and without it.

python -m benchmarks.eval.white_noise STORE [--fps 120] [--noise-metres 0.0003] [--json]
"""

import argparse
import json
from fractions import Fraction

import numpy as np

from eval.clip_fid.clips import Protocol
from eval.clip_fid.features import fit_on
from eval.clip_fid.kinematic import VERSION
from eval.clip_fid.score import score_disjoint_halves, score_rows
from eval.report.results import provenance
from eval.sets.corruptions import jitter, upsample_slerp
from eval.sets.real import real_motion
from motionkit.store import Store

KEPT_FPS = 20.0


def measure(store: Store, fps: Fraction, noise_metres: float) -> dict[str, float]:
    """clip-FID at `fps` of the upsampled takes, of the same with noise, and of disjoint halves of the real ones."""
    train, real = (real_motion(store, split).at(fps) for split in ("train", "test"))
    rng = np.random.default_rng(2)
    slerped = [upsample_slerp(take[None], float(fps), KEPT_FPS, rng)[0] for take in real.sequences]
    noisy = [jitter(take[None], float(fps), noise_metres, rng)[0] for take in slerped]
    motions = {"upsampled": slerped, "with_noise": noisy}
    rows = {name: real.with_positions(name, fps, takes) for name, takes in motions.items()}
    features, protocol = fit_on(train), Protocol(num_clips=2048, replications=4, detailed_replications=0)
    scores = score_rows(
        real, {name: real.with_positions(name, fps, takes) for name, takes in rows.items()}, features, protocol
    )
    halves = score_disjoint_halves(real, features, protocol)
    return {name: score.clip_fid.mean for name, score in {**scores, "disjoint_halves": halves}.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("store", help="a store with the splits train and test, captured at --fps or faster")
    parser.add_argument("--fps", type=Fraction, default=Fraction(120))
    parser.add_argument("--noise-metres", type=float, default=3e-4)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = measure(Store.open(options.store), options.fps, options.noise_metres)
    if options.json:
        print(
            json.dumps(
                {
                    "features": VERSION,
                    "fps": str(options.fps),
                    "noise_metres": options.noise_metres,
                    **found,
                    "provenance": provenance(Path(options.store)),
                }
            )
        )
        return
    for name, value in found.items():
        print(f"{name.replace('_', ' '):16} {value:8.2f}")


if __name__ == "__main__":
    main()
