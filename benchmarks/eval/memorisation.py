"""Are copies of training takes found under every disguise, and held-out takes let go?

    python -m benchmarks.eval.memorisation STORE [--held-out STORE …] [--takes 30] [--json FILE]

Stretches of 2.5 to 6 s of random training takes are disguised and looked for among all training takes; accused must be
nearly all. Held-out takes, whole, must be let go: training takes each against the others (the limits were chosen on
these), those of the splits val and test, and the test takes of other stores.
"""

import argparse
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from eval.report.results import provenance
from eval.sets.copies import FPS, Nearest, nearest_training
from eval.sets.corruptions import jitter, low_pass, upsample_slerp
from eval.sets.memorisation import ACCUSED_SHARE, LIMITS, STILL_BONES, copied, moving, verdicts
from eval.sets.real import RealMotion, real_motion
from eval.sets.sets import sample_set
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
    """An error of each joint below 2 Hz: what a model that reconstructs badly leaves of its copy."""

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
    """Training takes whose rotations another performer's skeleton of the same joints has."""
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


def judged(found: Sequence[Nearest], first: int, number: int) -> dict[str, Any]:
    """What the table says of motions `first` to `first + number`."""
    told = verdicts(found, int(max(each.motion.max() for each in found)) + 1)
    some = slice(first, first + number)
    stretches = {}
    for nearest in found:
        chosen = moving(nearest) & (nearest.motion >= first) & (nearest.motion < first + number)
        if chosen.any():
            metres = np.quantile(nearest.distance[chosen], (0, 0.05, 0.5, 0.95))
            share = np.quantile(nearest.distance[chosen] / nearest.movement[chosen], (0, 0.05, 0.5, 0.95))
            stretches[f"{nearest.seconds:g} s"] = {
                "number": int(chosen.sum()),
                "copied": float(copied(nearest)[chosen].mean()),
                "millimetres": [round(1000 * float(each), 2) for each in metres],
                "share_of_movement": [round(float(each), 4) for each in share],
            }
    return {
        "motions": len(told.told[some]),
        "still": int((~told.told[some]).sum()),
        "accused": int(told.accused[some].sum()),
        "stretches": stretches,
    }


def judge_copies(path: str, number: int, part: int) -> dict[str, Any]:
    """Every PARTS-th disguise from the `part`-th on, in one search."""
    store = Store.open(path)
    real = real_motion(store, "train")
    every = copies(store, real, number)
    made = {name: every[name] for name in list(every)[part::PARTS]}
    motions = [motion for each in made.values() for motion in each]
    samples = sample_set("copies", FPS, motions, [str(index) for index in range(len(motions))])
    found = nearest_training(samples, real.at(FPS))
    result, first = {}, 0
    for name, each in made.items():
        result[name] = judged(found, first, len(each))
        first += len(each)
    return result


def judge_held_out(path: str, other: str, split: str) -> dict[str, Any]:
    """Whole takes of a split of a store against the training takes of the first, never against themselves."""
    training = real_motion(Store.open(path), "train").at(FPS)
    samples = real_motion(Store.open(other), split).at(FPS)
    own = split == "train"
    apart = np.eye(training.num_sequences, dtype=bool) if own else None
    name = f"{Path(other).name}, {split}" + (", each against the others" if own else "")
    return {name: judged(nearest_training(samples, training, apart), 0, samples.num_sequences)}


HEAD = "| {} | motions | too still to tell | accused | copied stretches of 0.5, 1, 2 s | median distance, 1 s |"


def page(result: Mapping[str, Any]) -> str:
    """The tables of docs/results/memorisation.md."""
    parts = {"copies": "disguise", "held_out": "held-out takes"}
    return "\n".join("\n".join(rows(head, result[kind])) + "\n" for kind, head in parts.items())


def rows(head: str, judged_by_name: Mapping[str, Any]) -> Iterator[str]:
    """Lines of one table."""
    yield HEAD.format(head)
    yield "|---|---|---|---|---|---|"
    for name, row in judged_by_name.items():
        told = max(row["motions"] - row["still"], 1)
        stretches = row["stretches"]
        copied_shares = ", ".join(f"{100 * each['copied']:.0f} %" for each in stretches.values())
        accused = f"{row['accused']} ({100 * row['accused'] / told:.1f} %)"
        median = f"{stretches['1 s']['millimetres'][2]:.1f} mm"
        yield f"| {name} | {row['motions']} | {row['still']} | {accused} | {copied_shares} | {median} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("store", help="a store with the splits train, val and test")
    parser.add_argument("--held-out", nargs="*", default=[], help="stores whose test takes are compared too")
    parser.add_argument("--takes", type=int, default=30, help="pieces of training takes for each disguise")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path, help="where all figures are written")
    options = parser.parse_args()
    path = options.store
    held_out = [(path, "train"), (path, "val"), (path, "test"), *((other, "test") for other in options.held_out)]
    with ProcessPoolExecutor(options.workers) as pool:
        caught = [pool.submit(judge_copies, path, options.takes, part) for part in range(PARTS)]
        let_go = [pool.submit(judge_held_out, path, *each) for each in held_out]
        found = {
            "copies": {name: row for each in caught for name, row in each.result().items()},
            "held_out": {name: row for each in let_go for name, row in each.result().items()},
        }
    result = {
        "limits": {f"{seconds:g} s": asdict(limit) for seconds, limit in LIMITS.items()},
        "still_bones_metres": STILL_BONES,
        "accused_share": ACCUSED_SHARE,
        "takes": options.takes,
        "provenance": {
            **provenance(Path(path)),
            "stores": {Path(each).name: Store.open(each).fingerprint for each in (path, *options.held_out)},
        },
        "copies": {name: found["copies"][name] for name in names() if name in found["copies"]},
        "held_out": found["held_out"],
    }
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(page(result), end="")


if __name__ == "__main__":
    main()
