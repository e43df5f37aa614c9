"""R-Precision and MM-Dist of a trained native-rate evaluator on a store's real captioned motion.

    python benchmarks/eval/r_precision.py --store STORE --run RUN [--split test] [--fps 20,60] [--poses 64] [--json]

One random clip of every captioned motion that is long enough, paired with the motion's first caption; pools of 32, 20
replications, 95 % intervals. Motions that share a caption may meet in a pool, where only the own one counts: with
templated captions the ceiling is therefore below 1, and is printed (an oracle that places every motion on its caption).
"""

import argparse
import json
from fractions import Fraction
from pathlib import Path

import numpy as np

from eval.metrics.checks import estimate
from eval.metrics.r_precision import REFERENCE_POOL, r_precision
from eval.native_evaluator.evaluator import NativeEvaluator, load_native
from eval.report.results import provenance
from motionkit.core.timegrid import parse_fps
from motionkit.fields.resample import resample_positions
from motionkit.store import Store
from motionkit.store.cache import open_cache

REPLICATIONS = 20


def captioned_clips(
    store: Store, split: str, fps: Fraction, num_poses: int, rng: np.random.Generator
) -> tuple[np.ndarray, list[str]]:
    """One random clip per captioned sequence of at least `fps`, and its caption."""
    cache = open_cache(store, layout="smpl22", where=f"split = '{split}'")
    captions = store.sequences_table["captions"].take(store.rows_of(cache.sequence_index)).to_pylist()
    clips, texts = [], []
    for index in range(cache.num_sequences):
        native = Fraction(int(cache.fps_numerator[index]), int(cache.fps_denominator[index]))
        if native < fps or not captions[index]:
            continue
        positions = resample_positions(np.asarray(cache.sequence_positions(index)), native, fps)
        if len(positions) < num_poses:
            continue
        start = int(rng.integers(len(positions) - num_poses + 1))
        clips.append(positions[start : start + num_poses])
        texts.append(captions[index][0]["text"])
    return np.stack(clips), texts


def measure(evaluator: NativeEvaluator, clips: np.ndarray, texts: list[str], fps: Fraction) -> dict[str, object]:
    """Top-1, 2, 3 in the reference's direction (a text asks for its motion) and the paper's, MM-Dist, the ceiling."""
    distinct = sorted(set(texts))
    row = np.array([distinct.index(text) for text in texts])
    sentences = evaluator.embed_texts(distinct)[row]
    motions = evaluator.embed_motions(clips, fps)
    pairs = {"text asks": (sentences, motions), "motion asks": (motions, sentences), "oracle": (sentences, sentences)}
    figures: dict[str, object] = {"fps": str(fps), "motions": len(texts), "distinct_captions": len(distinct)}
    for name, (queries, candidates) in pairs.items():
        found = [
            r_precision(queries, candidates, rng=np.random.default_rng(replication), pool=REFERENCE_POOL)
            for replication in range(REPLICATIONS)
        ]
        for rank in range(3):
            each = estimate([float(result.top[rank]) for result in found])
            figures[f"{name}, top {rank + 1}"] = [round(each.mean, 4), round(each.ci95, 4)]
        if name == "text asks":
            distance = estimate([result.matching_distance for result in found])
            figures["MM-Dist"] = [round(distance.mean, 4), round(distance.ci95, 4)]
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, required=True)
    parser.add_argument("--run", type=Path, required=True)
    parser.add_argument("--split", default="test")
    parser.add_argument("--fps", default="20")
    parser.add_argument("--poses", type=int, default=64)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    store, evaluator = Store.open(arguments.store), load_native(arguments.run)
    results = []
    for text in arguments.fps.split(","):
        fps = parse_fps(text)
        clips, captions = captioned_clips(store, arguments.split, fps, arguments.poses, np.random.default_rng(0))
        results.append(measure(evaluator, clips, captions, fps))
    if arguments.json:
        print(
            json.dumps(
                {
                    "evaluator": evaluator.fingerprint,
                    "results": results,
                    "provenance": provenance(arguments.store, [arguments.run]),
                },
                indent=2,
            )
        )
        return
    print(f"evaluator {evaluator.fingerprint}, {arguments.poses} poses, pools of {REFERENCE_POOL}")
    for name in results[0]:
        print(f"{name:22}", *(f"{result[name]!s:>20}" for result in results))


if __name__ == "__main__":
    main()
