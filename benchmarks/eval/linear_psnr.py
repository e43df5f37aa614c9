"""PSNR of linear interpolation, by the rotations it is computed on.

    python -m benchmarks.eval.linear_psnr --store ./store [--split test] [--json]

Each data set's clips go through the protocol of PA-HiRes' Table 1 twice: in the 22-joint layout (rotations by inverse
kinematics, as the table has them) and in the source's own joints and local rotations. What is printed is the mean of
the clips' decibels and, in brackets, the decibels of their mean error: a few clips make most of the error.
"""

import argparse
import json
from fractions import Fraction
from pathlib import Path

import numpy as np

from eval.completion.protocol import INTEGER_SCALES, InterpolationProtocol, scale_label
from eval.completion.scores import ClipFrames, measure_scale
from eval.completion.takes import DataSet, NoTakesError, TrueClips, data_sets_of, open_clips
from eval.report.results import provenance
from motionkit.features.rotations import two_columns
from motionkit.store.reader import Store

PROTOCOL = InterpolationProtocol()
FLOOR_SHARE = 0.25
MOST_TRAINING_TAKES = 500


def own_rotations(store: Store, clips: TrueClips, most: int | None = None) -> np.ndarray:
    """Root and two columns of each of a source's own local rotations: clips of the skeleton that most takes have."""
    found: dict[int, list[np.ndarray]] = {}
    for index in np.unique(clips.sequence_index)[:most]:
        motion = store.read(int(index))
        if motion.local_rotations is None:
            continue
        step = int(motion.fps / clips.fps)
        root = motion.joint_positions[::step, 0]
        vectors = np.concatenate((root, two_columns(motion.local_rotations[::step])), axis=1).astype(np.float64)
        for first in range(0, len(vectors) - clips.num_frames + 1, clips.num_frames):
            clip = vectors[first : first + clips.num_frames].copy()
            clip[:, :3:2] -= clip[0, :3:2]
            found.setdefault(clip.shape[1], []).append(clip)
    return np.stack(max(found.values(), key=len)) if found else np.zeros((0, clips.num_frames, 3))


def decibels(clips: np.ndarray, std: np.ndarray) -> dict[str, tuple[float, float]]:
    """Of linear interpolation, over the frames that a scale leaves out: mean of decibels, decibels of the mean."""
    result = {}
    for scale in INTEGER_SCALES:
        kept, asked = PROTOCOL.kept_frames(scale), PROTOCOL.synthesised(scale)
        frames = np.arange(len(asked))
        before = np.clip(np.searchsorted(kept, frames, side="right") - 1, 0, len(kept) - 2)
        share = ((frames - kept[before]) / np.diff(kept)[before])[:, None]
        made = (1 - share) * clips[:, kept[before]] + share * clips[:, kept[before + 1]]
        error = (((made - clips[:, : len(asked)]) / (4 * std))[:, asked] ** 2).mean(axis=(1, 2))
        each = -10 * np.log10(np.maximum(error, 1e-10))
        result[scale_label(scale)] = (round(float(each.mean()), 1), round(float(-10 * np.log10(error.mean())), 1))
    return result


def floored(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Deviations, a quarter of their group's at least, and which numbers vary at all."""
    std = rows.std(axis=0)
    varies = std > 1e-5
    for group in (slice(0, 3), slice(3, None)):
        std[group] = np.maximum(std[group], FLOOR_SHARE * np.sqrt((std[group][varies[group]] ** 2).mean()))
    return std[varies], varies


def measured(store: Store, data_set: DataSet, split: str) -> dict[str, dict[str, tuple[float, float]]]:
    length = PROTOCOL.clip_frames
    test, train = (open_clips(store, data_set, name, None, length, length) for name in (split, "train"))
    scale = measure_scale(train)
    vectors = test.vectors(slice(None))
    canonical = ClipFrames.of(vectors).to_window(vectors).astype(np.float64)[..., scale.varies]
    found = {"22 joints, by inverse kinematics": decibels(canonical, scale.std)}
    training = own_rotations(store, train, MOST_TRAINING_TAKES)
    if len(training):
        std, varies = floored(training.reshape(-1, training.shape[-1]))
        clips = own_rotations(store, test)
        found[f"its own rotations, {clips.shape[-1]} numbers"] = decibels(clips[..., varies], std)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, default=Path("store"))
    parser.add_argument("--split", default="test")
    parser.add_argument("--fps", default=None, help="At this framerate instead of each data set's own.")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    store = Store.open(options.store)
    report = {}
    for data_set in data_sets_of(store, None if options.fps is None else (Fraction(options.fps),)):
        try:
            report[data_set.label] = measured(store, data_set, options.split)
        except NoTakesError:
            continue
    if options.json:
        print(json.dumps(report | {"provenance": provenance(options.store)}, indent=2, ensure_ascii=False))
        return
    for label, rows in report.items():
        print(label)
        for name, values in rows.items():
            print(f"  {name:36}" + "  ".join(f"{scale} {mean} ({whole})" for scale, (mean, whole) in values.items()))


if __name__ == "__main__":
    main()
