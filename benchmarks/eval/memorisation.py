"""Detection rate of transformed copies of training takes, and false positives on held-out takes.

    python -m benchmarks.eval.memorisation STORE [STORE …] [--held-out STORE …] [--takes 30] [--json FILE]

Each store's limits are found as tables find them. Stretches of 2.5 to 6 s of random training takes are transformed
("disguised") and searched for among all training takes; nearly all must be accused. Whole held-out takes must not be:
those of the splits val (if there are enough, the limits come from these) and test, and, for the first store, the test
takes of others. The search of 60 test takes of each store is timed against its matrix products alone.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from eval.report.results import provenance
from eval.sets import copies as search
from eval.sets.copies import Nearest, TrainingMotion, nearest_training
from eval.sets.corruptions import jitter, low_pass, upsample_slerp
from eval.sets.memorisation import (
    ACCUSED_HELD_OUT,
    ACCUSED_SHARE,
    SHARES,
    STILL_BONES,
    Limits,
    copied,
    limits_of,
    moving,
    verdicts,
)
from eval.sets.real import RealMotion, real_motion
from eval.sets.sets import sample_set
from eval.sets.stretches import FPS
from eval.sets.upsampled import upsampled_positions
from motionkit.core.kinematics import forward_kinematics
from motionkit.core.mirror import mirror_positions
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import map_joints
from motionkit.fields.resample import resample_positions
from motionkit.store import Store

SHORTEST_SECONDS, LONGEST_SECONDS = 2.5, 6.0
TEMPI = ("0.8", "0.87", "0.9", "1.05", "1.1", "1.18", "1.25")
FRAMERATES = ("12.5", "24", "25", "30000/1001", "50", "60", "144")
PARTS = 4
TIMED = 60
NOISE_MILLIMETRES = (0.3, 1.0, 3.0, 5.0)

# Joint positions [frames, 22, 3] and their framerate.
Piece = tuple[np.ndarray, Fraction]
Disguise = Callable[[Piece, np.random.Generator], Piece]


def taller(factor: float) -> Disguise:
    return lambda piece, rng: (piece[0] * np.float32(factor), piece[1])


def other_proportions(piece: Piece, rng: np.random.Generator) -> Piece:
    """Every bone by a factor of its own from 0.85 to 1.15, left and right alike."""
    factors = rng.uniform(0.85, 1.15, SMPL22.num_joints)
    for left, right in SMPL22.left_right_pairs:
        factors[right] = factors[left]
    made = piece[0].copy()
    for joint, parent in enumerate(SMPL22.parents[1:], start=1):
        made[:, joint] = made[:, parent] + factors[joint] * (piece[0][:, joint] - piece[0][:, parent])
    return made, piece[1]


def played(tempo: str) -> Disguise:
    return lambda piece, rng: (piece[0], piece[1] * Fraction(tempo))


def mirrored(piece: Piece, rng: np.random.Generator) -> Piece:
    return mirror_positions(piece[0], SMPL22.left_right_pairs), piece[1]


def backwards(piece: Piece, rng: np.random.Generator) -> Piece:
    return piece[0][::-1], piece[1]


def at_framerate(fps: str) -> Disguise:
    return lambda piece, rng: (resample_positions(piece[0], piece[1], Fraction(fps)), Fraction(fps))


def noisy(millimetres: float) -> Disguise:
    return lambda piece, rng: (jitter(piece[0][None], float(piece[1]), millimetres / 1000, rng)[0], piece[1])


def smoothed(hertz: float) -> Disguise:
    return lambda piece, rng: (low_pass(piece[0], float(piece[1]), hertz), piece[1])


def kept_at_20(piece: Piece, rng: np.random.Generator) -> Piece:
    return upsample_slerp(piece[0][None], float(piece[1]), 20.0, rng)[0], piece[1]


def wobbling(millimetres: float) -> Disguise:
    """An error of each joint below 2 Hz, like that of a model that reconstructs its copy badly."""

    def disguise(piece: Piece, rng: np.random.Generator) -> Piece:
        error = low_pass(rng.standard_normal(piece[0].shape), float(piece[1]), 2.0)
        error *= millimetres / 1000 / np.sqrt(3) / error.std()
        return (piece[0] + error).astype(np.float32), piece[1]

    return disguise


def both(*disguises: Disguise) -> Disguise:
    def disguise(piece: Piece, rng: np.random.Generator) -> Piece:
        for each in disguises:
            piece = each(piece, rng)
        return piece

    return disguise


def disguises() -> dict[str, Disguise]:
    """By the name that the table has."""
    return {
        "as it is": both(),
        "1.05 × taller": taller(1.05),
        "1.1 × taller": taller(1.1),
        "every bone by 0.85 … 1.15": other_proportions,
        **{f"{tempo} × the tempo": played(tempo) for tempo in TEMPI},
        "mirrored": mirrored,
        "backwards": backwards,
        **{f"at {float(Fraction(fps)):.5g} fps": at_framerate(fps) for fps in FRAMERATES},
        **{f"+ {noise:g} mm of white noise": noisy(noise) for noise in NOISE_MILLIMETRES},
        "low-passed at 8 Hz": smoothed(8.0),
        "kept at 20 fps, SLERP": kept_at_20,
        "1.1 × taller, 1.18 × the tempo, mirrored": both(taller(1.1), played("1.18"), mirrored),
        "backwards, low-passed at 8 Hz, + 3 mm": both(backwards, smoothed(8.0), noisy(3.0)),
        "kept at 20 fps, 0.87 × the tempo, mirrored, backwards": both(kept_at_20, played("0.87"), mirrored, backwards),
        **{f"off by {size} mm below 2 Hz (a bad copy)": wobbling(size) for size in (10, 20, 40)},
    }


def pieces(real: RealMotion, number: int, rng: np.random.Generator, seconds: float | None = None) -> Iterator[Piece]:
    """Random stretches of random takes, at their own framerates."""
    for index in rng.choice(len(real.fps), size=number, replace=number > len(real.fps)):
        fps, take = real.fps[index], real.sequences[index]
        length = round((seconds or rng.uniform(SHORTEST_SECONDS, LONGEST_SECONDS)) * float(fps))
        start = int(rng.integers(0, max(1, len(take) - length)))
        yield np.asarray(take[start : start + length]), fps


def spliced(real: RealMotion, parts: int, rng: np.random.Generator) -> Piece:
    """Pieces of different takes one after another, 4 s in all."""
    chosen = list(pieces(real, parts, rng, 4.0 / parts))
    fps = min(each for _, each in chosen)
    return np.concatenate([resample_positions(each, own, fps) for each, own in chosen]), fps


def retargeted(store: Store, number: int, rng: np.random.Generator) -> Iterator[Piece]:
    """Training takes retargeted to another performer's skeleton of the same joints."""
    chosen = store.select("split = 'train' AND has_rotations")
    bodies = [store.read(int(index)).skeleton for index in chosen]
    for index in rng.permutation(len(chosen))[:number]:
        motion = store.read(int(chosen[index]))
        others = [
            body
            for body in bodies
            if body.joint_names == motion.skeleton.joint_names and (body.offsets != motion.skeleton.offsets).any()
        ]
        if not others or motion.local_rotations is None or motion.root_translation is None:
            continue
        body = others[int(rng.integers(len(others)))]
        positions = forward_kinematics(motion.local_rotations, motion.root_translation, body)
        length = round(rng.uniform(SHORTEST_SECONDS, LONGEST_SECONDS) * float(motion.fps))
        joints = map_joints(Motion.from_joints(positions, motion.fps, body), SMPL22.name)
        start = int(rng.integers(0, max(1, len(joints) - length)))
        yield joints[start : start + length], motion.fps


def names() -> list[str]:
    """Of all disguises, in the order of the table."""
    return [*disguises(), "another performer's skeleton", *(f"spliced from {parts} takes" for parts in (2, 3))]


def at_20_fps(piece: Piece) -> np.ndarray:
    """As tables bring samples to 20 fps: anti-aliased from above, by SLERP from below."""
    positions, fps = np.ascontiguousarray(piece[0], dtype=np.float32), piece[1]
    return upsampled_positions(positions, fps, FPS) if fps < FPS else resample_positions(positions, fps, FPS)


def copies(store: Store, real: RealMotion, number: int) -> dict[str, list[np.ndarray]]:
    """Disguised pieces of training takes at 20 fps, by disguise."""
    rng = np.random.default_rng(0)
    chosen = list(pieces(real, number, rng))
    made = {name: [at_20_fps(disguise(piece, rng)) for piece in chosen] for name, disguise in disguises().items()}
    made["another performer's skeleton"] = [at_20_fps(piece) for piece in retargeted(store, number, rng)]
    for parts in (2, 3):
        made[f"spliced from {parts} takes"] = [at_20_fps(spliced(real, parts, rng)) for _ in range(number)]
    return {name: motions for name, motions in made.items() if motions}


def judged(found: Sequence[Nearest], first: int, number: int, limits: Limits) -> dict[str, Any]:
    """The table's figures of motions `first` to `first + number`."""
    result = verdicts(found, int(max(each.motion.max() for each in found)) + 1, limits)
    some = slice(first, first + number)
    stretches = {}
    for nearest in found:
        chosen = moving(nearest) & (nearest.motion >= first) & (nearest.motion < first + number)
        if chosen.any():
            metres = np.quantile(nearest.distance[chosen], (0, 0.05, 0.5, 0.95))
            share = np.quantile(nearest.distance[chosen] / nearest.movement[chosen], (0, 0.05, 0.5, 0.95))
            stretches[f"{nearest.seconds:g} s"] = {
                "number": int(chosen.sum()),
                "copied": float(copied(nearest, limits)[chosen].mean()),
                "millimetres": [round(1000 * float(each), 2) for each in metres],
                "share_of_movement": [round(float(each), 4) for each in share],
            }
    return {
        "motions": len(result.decidable[some]),
        "still": int((~result.decidable[some]).sum()),
        "accused": int(result.accused[some].sum()),
        "stretches": stretches,
    }


# Results for concatenated motions: their number by name, and the search.
Found = tuple[dict[str, int], tuple[Nearest, ...]]


def find_copies(path: str, number: int, part: int) -> Found:
    """Every PARTS-th disguise from the `part`-th on, in one search."""
    store = Store.open(path)
    real = real_motion(store, "train")
    every = copies(store, real, number)
    made = {name: every[name] for name in list(every)[part::PARTS]}
    motions = [motion for each in made.values() for motion in each]
    samples = sample_set("copies", FPS, motions, [str(index) for index in range(len(motions))])
    numbers = {name: len(each) for name, each in made.items()}
    return numbers, nearest_training(samples, TrainingMotion.of(real.at(FPS)))


def find_held_out(path: str, other: str, split: str, name: str) -> Found:
    """Whole takes of a split of a store against the training takes of the first."""
    training = TrainingMotion.of(real_motion(Store.open(path), "train").at(FPS))
    samples = real_motion(Store.open(other), split).at(FPS)
    return {f"{name}, {split}": samples.num_sequences}, nearest_training(samples, training)


def find_limits(path: str) -> Limits:
    """A store's own, as tables find them."""
    store = Store.open(path)
    training = real_motion(store, "train").at(FPS)
    return limits_of(training, TrainingMotion.of(training), real_motion(store, "val").at(FPS))


def timed(path: str) -> dict[str, float]:
    """Processor seconds of a search of TIMED random test takes, and of its matrix products alone."""
    store = Store.open(path)
    training, test = (real_motion(store, split).at(FPS) for split in ("train", "test"))
    samples = test.select(np.random.default_rng(0).permutation(test.num_sequences)[:TIMED])
    start = time.process_time()
    indexed = TrainingMotion.of(training)
    laid = time.process_time()
    found = nearest_training(samples, indexed)
    searched = time.process_time()
    for each in found:
        queries = np.ones((len(each.motion), search.NUM_COMPONENTS), dtype=np.float32)
        rows = np.ones((search.NUM_COMPONENTS, search.BLOCK_ROWS), dtype=np.float32)
        for _ in range(
            len(search.TEMPI) * len(search.WAYS) * (int(training.duration_seconds * 10) // search.BLOCK_ROWS)
        ):
            queries @ rows
    return {
        "motions": samples.num_sequences,
        "training_minutes": round(training.duration_seconds / 60, 1),
        "laying_out_seconds": round(laid - start, 2),
        "search_seconds": round(searched - laid, 2),
        "matrix_product_seconds": round(time.process_time() - searched, 2),
    }


def judge(found: Sequence[Found], limits: Limits) -> dict[str, Any]:
    """The table's figures by name."""
    result = {}
    for numbers, nearest in found:
        first = 0
        for name, number in numbers.items():
            result[name] = judged(nearest, first, number, limits)
            first += number
    return result


HEAD = "| {} | motions | too still to tell | accused | copied stretches of 0.5, 1, 2 s | median distance, 1 s |"


def page(stores: Mapping[str, Any]) -> str:
    """The tables of docs/results/memorisation.md."""
    lines = []
    for name, result in stores.items():
        limits = Limits(**result["limits"])
        lines += [f"## {name}", "", f"Limits: {limits}.", ""]
        for kind, head in {"held_out": "held-out takes", "copies": "disguise"}.items():
            lines += [*rows(head, result[kind]), ""]
        lines += [
            "Processor seconds, one thread: {}.".format(
                ", ".join(f"{key.replace('_', ' ')} {value:g}" for key, value in result["time"].items())
            ),
            "",
        ]
    return "\n".join(lines)


def rows(head: str, judged_by_name: Mapping[str, Any]) -> Iterator[str]:
    """Lines of one table."""
    yield HEAD.format(head)
    yield "|---|---|---|---|---|---|"
    for name, row in judged_by_name.items():
        decided = max(row["motions"] - row["still"], 1)
        stretches = row["stretches"]
        copied_shares = ", ".join(f"{100 * each['copied']:.0f} %" for each in stretches.values())
        accused = f"{row['accused']} ({100 * row['accused'] / decided:.1f} %)"
        median = f"{stretches['1 s']['millimetres'][2]:.1f} mm"
        yield f"| {name} | {row['motions']} | {row['still']} | {accused} | {copied_shares} | {median} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stores", nargs="+", metavar="[NAME=]STORE", help="stores with the splits train, val and test")
    parser.add_argument("--held-out", nargs="*", default=[], help="stores whose test takes are beside the first too")
    parser.add_argument("--takes", type=int, default=30, help="pieces of training takes for each disguise")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path, help="where all figures are written")
    options = parser.parse_args()
    stores = {each.rpartition("=")[0] or Path(each).name: each.rpartition("=")[2] for each in options.stores}
    first = next(iter(stores))
    with ProcessPoolExecutor(options.workers) as pool:
        limits = {name: pool.submit(find_limits, path) for name, path in stores.items()}
        caught = {
            name: [pool.submit(find_copies, path, options.takes, part) for part in range(PARTS)]
            for name, path in stores.items()
        }
        takes = {name: [(path, "val", name), (path, "test", name)] for name, path in stores.items()}
        takes[first] += [(other, "test", Path(other).name) for other in options.held_out]
        held_out = {
            name: [pool.submit(find_held_out, stores[name], *each) for each in every] for name, every in takes.items()
        }
        spent = {name: pool.submit(timed, path) for name, path in stores.items()}
        result: dict[str, Any] = {name: {"limits": asdict(each.result())} for name, each in limits.items()}
        for name in stores:
            own = limits[name].result()
            judged_copies = judge([each.result() for each in caught[name]], own)
            result[name]["held_out"] = judge([each.result() for each in held_out[name]], own)
            result[name]["copies"] = {each: judged_copies[each] for each in names() if each in judged_copies}
            result[name]["time"] = spent[name].result()
    everything = {
        "shares_of_movement": {f"{seconds:g} s": share for seconds, share in SHARES.items()},
        "still_bones_metres": STILL_BONES,
        "accused_share": ACCUSED_SHARE,
        "accused_held_out": ACCUSED_HELD_OUT,
        "takes": options.takes,
        "provenance": {
            **provenance(Path(stores[first])),
            "stores": {
                **{name: Store.open(path).fingerprint for name, path in stores.items()},
                **{Path(each).name: Store.open(each).fingerprint for each in options.held_out},
            },
        },
        "stores": result,
    }
    if options.json:
        options.json.write_text(json.dumps(everything, indent=1) + "\n", encoding="utf-8")
    print(page(result), end="")


if __name__ == "__main__":
    main()
