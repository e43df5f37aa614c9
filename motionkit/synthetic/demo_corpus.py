"""The embedded demo corpus: synthetic motions at eight framerates, on disk in the formats of real corpora.

Most are BVH files with a CSV of captions, actions and splits beside them; those at 20 fps also form a HumanML3D
folder. It is therefore read by the same readers as a real corpus.
"""

import csv
import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.features import humanml3d
from motionkit.fields.motion_field import to_motion
from motionkit.io.bvh.writing import write_bvh
from motionkit.io.humanml3d import HUMANML3D, Entry, write_humanml3d
from motionkit.synthetic import ACTIONS, Body, SyntheticMotion, draw_body, perform
from motionkit.synthetic.curves import band_noise
from motionkit.synthetic.script import SIDES, Layer

# Shares of the corpus: half of it at 60 fps and above, so that every framerate of Table 2 has reference motions.
BVH_SHARES = {20: 20, 24: 20, 30: 40, 50: 32, 60: 52, 100: 32, 120: 62, 250: 22}
HUMANML3D_SHARE = 40
NUM_PERFORMERS = 12
SHORTEST_SECONDS, LONGEST_SECONDS = 2.0, 9.8
COMBINED = 0.3
SOLE_METRES = 0.0008
SPLIT_SHARES = {"test": 0.20, "val": 0.05}
LICENCE = "CC0 1.0 (public domain): synthetic motions made by motionkit, no captured data"


@dataclass(frozen=True, eq=False)
class DemoSequence:
    """A performance of the corpus before it is written; `name` is its file name."""

    name: str
    fps: Fraction
    subject: str
    split: str
    field: SyntheticMotion


@dataclass(frozen=True)
class DemoCorpus:
    """The written corpus: the folder to ingest, and its size."""

    folder: Path
    num_bvh: int
    num_humanml3d: int
    duration_seconds: float


def write_demo_corpus(folder: Path, num_sequences: int = 320, seed: int = 0) -> DemoCorpus:
    """Write `folder/bvh` (files and clips.csv) and `folder/humanml3d`; the same arguments write the same bytes.

    Sequences last 2 to 9.8 s and are split into train, val and test by a hash of their names. Raises `ValueError` for
    fewer than 16 sequences, of which not every framerate could have one.
    """
    (folder / "bvh").mkdir(parents=True, exist_ok=True)
    (folder / "LICENSE").write_text(f"{LICENCE}\n", encoding="utf-8")
    sequences = draw_sequences(num_sequences, seed)
    num_humanml3d = round(num_sequences * HUMANML3D_SHARE / (HUMANML3D_SHARE + sum(BVH_SHARES.values())))
    of_humanml3d, of_bvh = sequences[:num_humanml3d], sequences[num_humanml3d:]
    for sequence in of_bvh:
        write_bvh(to_motion(sequence.field, sequence.fps), folder / "bvh" / f"{sequence.name}.bvh")
    _write_csv(folder / "bvh" / "clips.csv", of_bvh)
    write_humanml3d(folder / "humanml3d", humanml3d_entries(of_humanml3d))
    _write_actions(folder / "humanml3d" / "actions.csv", of_humanml3d)
    seconds = sum(sequence.field.end_seconds for sequence in sequences)
    return DemoCorpus(folder, len(of_bvh), len(of_humanml3d), seconds)


def draw_sequences(num_sequences: int, seed: int) -> list[DemoSequence]:
    """The corpus's performances, those for the HumanML3D folder first; raises `ValueError` for fewer than 16."""
    if num_sequences < 16:
        raise ValueError(f"the demo corpus needs at least 16 sequences, not {num_sequences}")
    performers = [draw_body(np.random.default_rng((seed, 0, k)), f"p{k + 1:02d}") for k in range(NUM_PERFORMERS)]
    framerates = _framerates(num_sequences)
    return [_draw(index, fps, seed, performers) for index, fps in enumerate(framerates)]


def split_of(name: str) -> str:
    """train, val or test, by the sha256 of a sequence's name."""
    share = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big") / 2**64
    for split, part in SPLIT_SHARES.items():
        if share < part:
            return split
        share -= part
    return "train"


def _framerates(num_sequences: int) -> list[Fraction]:
    """HumanML3D's 20 fps first, then the BVH files', each framerate by its share and at least once."""
    shares = np.array([HUMANML3D_SHARE, *BVH_SHARES.values()], dtype=np.float64)
    counts = np.maximum(np.floor(num_sequences * shares / shares.sum()).astype(int), 1)
    counts[0] = round(num_sequences * shares[0] / shares.sum())
    # The commonest framerate absorbs the rounding error.
    counts[1 + int(np.argmax(shares[1:]))] += num_sequences - int(counts.sum())
    rates = np.repeat([20, *BVH_SHARES], counts)
    return [Fraction(int(rate)) for rate in rates]


def _draw(index: int, fps: Fraction, seed: int, performers: Sequence[Body]) -> DemoSequence:
    rng = np.random.default_rng((seed, 1, index))
    names = tuple(ACTIONS)
    # 7 is coprime to the number of actions: every framerate gets every action.
    actions = [names[(7 * index) % len(names)]]
    if rng.random() < COMBINED:
        others = [name for name in names if name != actions[0]]
        actions.append(others[int(rng.integers(len(others)))])
    body = performers[int(rng.integers(len(performers)))]
    shortest = SHORTEST_SECONDS if len(actions) == 1 else 4.8
    seconds = shortest + (LONGEST_SECONDS - shortest) * float(rng.beta(1.3, 2.0))
    # An integer number of frames, so that the last frame is the motion's end.
    seconds = float(round(seconds * fps) / fps)
    name = f"{index:06d}_{'_then_'.join(actions)}"
    field = perform(rng, body, actions, seconds)
    field = replace(field, layers=(*field.layers, *_soft_soles(rng)))
    return DemoSequence(name, fps, body.name, split_of(name), field)


def _soft_soles(rng: np.random.Generator) -> tuple[Layer, ...]:
    """Small movements of planted feet, about a millimetre, as caused by skin, shoes and capture noise.

    If planted feet did not move at all, every model's foot sliding would be infinitely worse than the corpus's.
    """
    directions = ("foot_forward", "foot_out")
    return tuple(Layer(f"{side}_{way}", band_noise(rng, SOLE_METRES, 0.3, 6.0)) for side in SIDES for way in directions)


def humanml3d_entries(sequences: Sequence[DemoSequence]) -> Iterator[Entry]:
    """Performances as entries of a HumanML3D folder: at 20 fps, processed joints and pose vectors."""
    for sequence in sequences:
        joints = to_motion(sequence.field, HUMANML3D.fps).joint_positions
        processed = humanml3d.process(joints, "smpl22")
        yield Entry(
            name=sequence.name,
            joint_positions=processed,
            vectors=humanml3d.vectors(processed, "smpl22"),
            captions=sequence.field.captions,
            split=sequence.split,
        )


def _write_csv(path: Path, sequences: Sequence[DemoSequence]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(("file", "fps", "action", "subject", "caption", "split"))
        for sequence in sequences:
            caption = sequence.field.captions[0].text
            table.writerow(
                (f"{sequence.name}.bvh", sequence.fps, sequence.field.action, sequence.subject, caption, sequence.split)
            )


def _write_actions(path: Path, sequences: Sequence[DemoSequence]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(("file", "action", "subject"))
        for sequence in sequences:
            table.writerow((f"new_joints/{sequence.name}.npy", sequence.field.action, sequence.subject))
