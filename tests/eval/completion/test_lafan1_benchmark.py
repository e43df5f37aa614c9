"""LaFAN1's in-betweening benchmark held against its definition: windows, statistics, metrics, rows."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from eval.completion.encoders import HOLD, INTERPOLATION, Completer
from eval.completion.scores import mean_over_takes
from eval.completion.windows import BENCHMARK_WINDOWS, GAPS, lafan1_windows, measure_windows
from motionkit.core.motion import Motion, Provenance
from motionkit.core.skeleton import Skeleton
from motionkit.io.bvh_data_sets import read_lafan1
from motionkit.store.reader import Store
from motionkit.store.writer import StoreWriter
from tests.helpers.format_samples import lafan1_text
from tests.helpers.table_request import body_of

SLERP = next(row for row in INTERPOLATION if row.name == "SLERP")
LENGTHS_OF = {"aiming1_subject1": 91, "walk1_subject4": 70}  # training
LENGTHS_OF |= {"dance2_subject5": 146, "run1_subject5": 65, "walk3_subject5": 66}
LENGTHS = (5, 15, 30, 45)
Answer = Callable[[np.ndarray, np.ndarray, int], tuple[np.ndarray, np.ndarray]]


def take(name: str, num_frames: int, skeleton: Skeleton) -> Motion:
    """A body whose joints swing about random axes, whose root turns round and walks; bones differ from take to take."""
    rng = np.random.default_rng(len(name) * 1000 + num_frames)
    time = np.arange(num_frames)[:, None, None] / 30.0
    axis, phase, speed = rng.normal(size=(3, 1, 22, 3))
    turns = 0.4 * axis * np.sin(3.0 * speed * time + phase)
    turns[:, 0] = np.array([0.3, 2.5, 0.2]) * time[:, 0] + rng.normal(size=3)
    bob = 0.03 * np.sin(9.0 * time[:, 0]) * [0.0, 1.0, 0.0]
    root = np.array([0.8, 0.0, 0.3]) * time[:, 0] + bob + [1.0, 0.9, -2.0]
    skeleton = replace(skeleton, offsets=skeleton.offsets * np.float32(rng.uniform(0.9, 1.1)))
    origin: dict[str, Any] = {"source": "lafan1", "source_format": "lafan1", "source_path": f"{name}.bvh"}
    sha256 = name.encode().hex().ljust(64, "0")[:64]
    about = Provenance(**origin, subject=name.partition("_")[2], source_sha256=sha256)
    # The benchmark goes by subjects, whatever the split.
    return body_of(turns, root, 30, skeleton, sequence_id=name, split="train", provenance=about)


@pytest.fixture(scope="module")
def motions(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Motion]:
    path = tmp_path_factory.mktemp("lafan1") / "walk1_subject5.bvh"
    path.write_text(lafan1_text(2))
    skeleton = read_lafan1(path).motion.skeleton
    return {name: take(name, frames, skeleton) for name, frames in LENGTHS_OF.items()}


@pytest.fixture(scope="module")
def store(motions: dict[str, Motion], tmp_path_factory: pytest.TempPathFactory) -> Store:
    path = tmp_path_factory.mktemp("lafan1") / "store"
    with StoreWriter.create(path) as writer:
        for name in reversed(motions):
            writer.add(motions[name])
    return Store.open(path)


# The definition, by itself: quaternions (w, x, y, z), whose signs matter, of all frames at once.
def times(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    (w, x, y, z), (p, q, r, s) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    rows = (w * p - x * q - y * r - z * s, w * q + x * p + y * s - z * r)
    return np.stack((*rows, w * r - x * s + y * p + z * q, w * s + x * r - y * q + z * p), axis=-1)


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    return times(times(q, np.concatenate((0 * v[..., :1], v), axis=-1)), q * [1, -1, -1, -1])[..., 1:]


def pose(root: np.ndarray, local: np.ndarray, skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray]:
    """Global positions and quaternions of frames [frames, 22, 3 or 4]."""
    positions, turned = [root], [local[:, 0]]
    for joint, parent in enumerate(skeleton.parents[1:], start=1):
        offset = np.broadcast_to(skeleton.offsets[joint].astype(float), root.shape)
        positions.append(positions[parent] + rotate(turned[parent], offset))
        turned.append(times(turned[parent], local[:, joint]))
    return np.stack(positions, axis=1), np.stack(turned, axis=1)


def windows_of(motion: Motion, window: int, step: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Root paths and local quaternions of a take's windows."""
    assert motion.local_rotations is not None and motion.root_translation is not None
    quaternions = motion.local_rotations.astype(float)
    for before, after in pairwise(quaternions):
        after[(before * after).sum(axis=-1) < 0] *= -1
    for start in range(0, motion.num_frames - window, step):
        root = motion.root_translation[start : start + window].astype(float)
        root[:, [0, 2]] -= root[:, [0, 2]].mean(axis=0)
        local = quaternions[start : start + window].copy()
        forward = rotate(local[9, 0], np.array([0.0, 1.0, 0.0]))
        # About +y by a the direction (cos a, 0, −sin a) turns onto from +x; undone by the half angle −a.
        half = np.arctan2(forward[2], forward[0]) / 2
        back = np.array([np.cos(half), 0.0, np.sin(half), 0.0])
        local[:, 0] = times(back, local[:, 0])
        yield rotate(np.broadcast_to(back, (window, 4)), root), local


def held(root: np.ndarray, local: np.ndarray, after: int) -> tuple[np.ndarray, np.ndarray]:
    return np.repeat(root[9:10], after - 10, axis=0), np.repeat(local[9:10], after - 10, axis=0)


def between(root: np.ndarray, local: np.ndarray, after: int) -> tuple[np.ndarray, np.ndarray]:
    """Root on a line, every local rotation on its great arc, from frame 9 to the first future frame."""
    shares = np.arange(1, after - 9) / (after - 9)
    quaternions = np.empty((len(shares), 22, 4))
    for joint in range(22):
        arc = Slerp([0, 1], Rotation.from_quat(local[[9, after], joint], scalar_first=True))(shares)
        before = local[9, joint]
        for place, q in enumerate(arc.as_quat(scalar_first=True)):
            before = quaternions[place, joint] = q if q @ before > 0 else -q
    return root[9] + shares[:, None] * (root[after] - root[9]), quaternions


def benchmark(motions: dict[str, Motion], length: int, answer: Answer) -> dict[str, float]:
    """The benchmark's figures of a row that answers a window's root path and rotations with those of the gap."""
    ordered = [motions[name] for name in sorted(motions)]
    train, test = ([each for each in ordered if ("5" in each.sequence_id[-1]) == tests] for tests in (False, True))
    windows = (pose(*window, motion.skeleton)[0] for motion in train for window in windows_of(motion, 50, 20))
    std = np.concatenate(list(windows)).std(axis=0)
    l2p, l2q, signed = [], [], []
    for root, local in (window for motion in test for window in windows_of(motion, 65, 40)):
        after = 10 + length
        p, q = pose(*answer(root, local, after), train[0].skeleton)
        true_p, true_q = pose(root[10:after], local[10:after], train[0].skeleton)
        l2p.append(np.sqrt((((p - true_p) / std) ** 2).sum(axis=(1, 2))))
        apart, opposite = ((q - true_q) ** 2).sum(axis=-1), ((q + true_q) ** 2).sum(axis=-1)
        l2q.append(np.sqrt(np.minimum(apart, opposite).sum(axis=1)))
        signed.append(np.sqrt(apart.sum(axis=1)))
    return {"l2p": float(np.mean(l2p)), "l2q": float(np.mean(l2q)), "l2q_as_signed": float(np.mean(signed))}


@pytest.mark.parametrize(("completer", "answer"), [(HOLD, held), (SLERP, between)], ids=["zero velocity", "SLERP"])
def test_rows_of_the_benchmark_are_those_of_its_definition(
    store: Store, motions: dict[str, Motion], completer: Completer, answer: Answer
) -> None:
    found = measure_windows(lafan1_windows(store), GAPS, completer)
    for length in LENGTHS:
        expected = benchmark(motions, length, answer)
        for metric, value in expected.items():
            mean = mean_over_takes(found[metric, f"{length} frames"]).value
            assert mean == pytest.approx(value, rel=2e-3), (length, metric)
    # The body turns by more than half a turn in 45 frames: signs matter there.
    assert answer is between or expected["l2q_as_signed"] > 1.05 * expected["l2q"]


def test_windows_of_subject_5_are_strictly_inside_their_takes(store: Store, motions: dict[str, Motion]) -> None:
    windows = lafan1_windows(store)
    # 146 frames: starts 0, 40, 80 (80 + 65 < 146); 65: none; 66: one.
    assert len(windows.takes) == 4
    assert windows.remark.startswith(f"subject 5, 4 windows (the whole data set has {BENCHMARK_WINDOWS:,})")
    np.testing.assert_allclose(windows.skeleton.offsets, motions["aiming1_subject1"].skeleton.offsets, atol=1e-4)
