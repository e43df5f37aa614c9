"""LaFAN1's in-betweening benchmark held against its definition in plain loops: windows, statistics, metrics, rows."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from eval.completion.data_sets import NoTakesError
from eval.completion.encoders import HOLD, INTERPOLATION
from eval.completion.scores import mean_over_takes
from eval.completion.windows import BENCHMARK_WINDOWS, PoseWindows, gaps, lafan1_windows, measure_windows
from motionkit.core import kinematics
from motionkit.core.motion import Motion, Provenance
from motionkit.core.skeleton import Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.io.lafan1 import read_lafan1
from motionkit.store.reader import Store
from motionkit.store.writer import StoreWriter
from tests.helpers.format_samples import lafan1_text

SLERP = next(row for row in INTERPOLATION if row.name == "SLERP")
TAKES = {
    "aiming1_subject1": 91,
    "walk1_subject4": 70,
    "dance2_subject5": 146,
    "run1_subject5": 65,
    "walk3_subject5": 66,
}
LENGTHS = (5, 15, 30, 45)


def take(name: str, num_frames: int, skeleton: Skeleton) -> Motion:
    """A body whose joints swing about random axes, whose root turns round and walks; bones differ from take to take."""
    rng = np.random.default_rng(len(name) * 1000 + num_frames)
    time = np.arange(num_frames)[:, None, None] / 30.0
    axis, phase, speed = rng.normal(size=(3, 1, 22, 3))
    turns = 0.4 * axis * np.sin(3.0 * speed * time + phase)
    turns[:, 0] = np.array([0.3, 2.5, 0.2]) * time[:, 0] + rng.normal(size=3)
    local = Rotation.from_rotvec(turns.reshape(-1, 3)).as_quat(scalar_first=True).reshape(num_frames, 22, 4)
    local = (local * rng.choice([-1, 1], (num_frames, 22, 1))).astype(np.float32)
    bob = 0.03 * np.sin(9.0 * time[:, 0]) * [0.0, 1.0, 0.0]
    root = (np.array([0.8, 0.0, 0.3]) * time[:, 0] + bob + [1.0, 0.9, -2.0]).astype(np.float32)
    bones = skeleton.offsets * np.float32(rng.uniform(0.9, 1.1))
    skeleton = replace(skeleton, offsets=bones)
    return Motion(
        joint_positions=kinematics.forward_kinematics(local, root, skeleton),
        skeleton=skeleton,
        timegrid=TimeGrid(Fraction(30), num_frames),
        local_rotations=local,
        root_translation=root,
        sequence_id=name,
        split="train",  # the benchmark goes by subjects, whatever the split
        provenance=Provenance(
            source="lafan1",
            source_format="lafan1",
            subject=name.partition("_")[2],
            source_path=f"{name}.bvh",
            source_sha256=name.encode().hex().ljust(64, "0")[:64],
        ),
    )


@pytest.fixture(scope="module")
def motions(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Motion]:
    path = tmp_path_factory.mktemp("lafan1") / "walk1_subject5.bvh"
    path.write_text(lafan1_text(2))
    skeleton = read_lafan1(path).skeleton
    return {name: take(name, frames, skeleton) for name, frames in TAKES.items()}


@pytest.fixture(scope="module")
def store(motions: dict[str, Motion], tmp_path_factory: pytest.TempPathFactory) -> Store:
    path = tmp_path_factory.mktemp("lafan1") / "store"
    with StoreWriter.create(path) as writer:
        for name in reversed(motions):
            writer.add(motions[name])
    return Store.open(path)


# The definition, by itself: quaternions are lists (w, x, y, z), one joint of one frame at a time.
def times(a: list[float], b: list[float]) -> list[float]:
    w, x, y, z = a
    p, q, r, s = b
    return [
        w * p - x * q - y * r - z * s,
        w * q + x * p + y * s - z * r,
        w * r - x * s + y * p + z * q,
        w * s + x * r - y * q + z * p,
    ]


def rotate(q: list[float], v: list[float]) -> list[float]:
    return times(times(q, [0.0, *v]), [q[0], -q[1], -q[2], -q[3]])[1:]


def pose(
    local: list[list[float]], root: list[float], offsets: np.ndarray, parents: tuple[int, ...]
) -> tuple[list[list[float]], list[list[float]]]:
    """Global positions and quaternions of one frame."""
    positions, turned = [root], [local[0]]
    for joint in range(1, 22):
        parent = parents[joint]
        step = rotate(turned[parent], offsets[joint].tolist())
        positions.append([positions[parent][k] + step[k] for k in range(3)])
        turned.append(times(turned[parent], local[joint]))
    return positions, turned


def windows_by_loops(motion: Motion, window: int, step: int) -> list[tuple[list[list[float]], list[list[list[float]]]]]:
    """Roots and local quaternions of a take's windows."""
    assert motion.local_rotations is not None and motion.root_translation is not None
    quats = motion.local_rotations.astype(float).tolist()
    for frame in range(1, len(quats)):
        for joint in range(22):
            if sum(a * b for a, b in zip(quats[frame][joint], quats[frame - 1][joint], strict=True)) < 0:
                quats[frame][joint] = [-number for number in quats[frame][joint]]
    found, start = [], 0
    while start + window < motion.num_frames:
        root = motion.root_translation[start : start + window].astype(float)
        root[:, [0, 2]] -= root[:, [0, 2]].mean(axis=0)
        local = [[list(joint) for joint in frame] for frame in quats[start : start + window]]
        forward = rotate(local[9][0], [0.0, 1.0, 0.0])
        # About +y by a the direction (cos a, 0, −sin a) turns onto from +x; undone by the half angle −a.
        half = np.arctan2(forward[2], forward[0]) / 2
        back = [float(np.cos(half)), 0.0, float(np.sin(half)), 0.0]
        for frame in local:
            frame[0] = times(back, frame[0])
        found.append(([rotate(back, place) for place in root.tolist()], local))
        start += step
    return found


def benchmark_by_loops(motions: dict[str, Motion]) -> dict[str, dict[str, dict[str, float]]]:
    names = sorted(motions)
    train = [motions[name] for name in names if not name.endswith("subject5")]
    parents, offsets = train[0].skeleton.parents, train[0].skeleton.offsets.astype(float)
    places = [
        pose(local[frame], root[frame], motion.skeleton.offsets.astype(float), parents)[0]
        for motion in train
        for root, local in windows_by_loops(motion, 50, 20)
        for frame in range(50)
    ]
    std = np.std(np.array(places), axis=0)
    test = [each for name in names if name.endswith("subject5") for each in windows_by_loops(motions[name], 65, 40)]
    result: dict[str, dict[str, dict[str, float]]] = {"zero": {}, "interpolation": {}}
    for length in LENGTHS:
        spectra: dict[str, list[tuple[float, float]]] = {"zero": [], "interpolation": []}
        norms: dict[str, list[tuple[float, float, float]]] = {"zero": [], "interpolation": []}
        for root, local in test:
            after = 10 + length
            answers = {"zero": ([root[9]] * length, [local[9]] * length), "interpolation": between(root, local, after)}
            true = [pose(local[frame], root[frame], offsets, parents) for frame in range(10, after)]
            for row, (roots, quats) in answers.items():
                made = [pose(q, r, offsets, parents) for r, q in zip(roots, quats, strict=True)]
                for (p, q), (tp, tq) in zip(made, true, strict=True):
                    l2p = np.sqrt((((np.array(p) - tp) / std) ** 2).sum())
                    near = sum(
                        min(
                            sum((a - b) ** 2 for a, b in zip(m, t, strict=True)),
                            sum((a + b) ** 2 for a, b in zip(m, t, strict=True)),
                        )
                        for m, t in zip(q, tq, strict=True)
                    )
                    signed = np.sqrt(((np.array(q) - tq) ** 2).sum())
                    norms[row].append((float(l2p), float(np.sqrt(near)), float(signed)))
                spectra[row] += spectrum_distances(np.array([q for _, q in made]), np.array([q for _, q in true]))
        for row in result:
            weights = np.array([weight for _, weight in spectra[row]])
            distances = np.array([distance for distance, _ in spectra[row]])
            l2p, l2q, signed = np.mean(norms[row], axis=0)
            result[row][f"{length} frames"] = {
                "l2p": l2p, "l2q": l2q, "l2q_as_signed": signed, "npss": (distances * weights).sum() / weights.sum(),
            }  # fmt: skip
    return result


def between(
    root: list[list[float]], local: list[list[list[float]]], after: int
) -> tuple[list[list[float]], list[list[list[float]]]]:
    """Root on a line, every local rotation on its great arc, from frame 9 to the first future frame."""
    shares = np.arange(1, after - 9) / (after - 9)
    roots = [[a + share * (b - a) for a, b in zip(root[9], root[after], strict=True)] for share in shares]
    quats = np.empty((len(shares), 22, 4))
    for joint in range(22):
        ends = Rotation.from_quat([local[9][joint], local[after][joint]], scalar_first=True)
        before = np.array(local[9][joint])
        for place, q in enumerate(Slerp([0, 1], ends)(shares).as_quat(scalar_first=True)):
            before = quats[place, joint] = q if q @ before > 0 else -q
    return roots, quats.tolist()


def spectrum_distances(made: np.ndarray, true: np.ndarray) -> list[tuple[float, float]]:
    """For each of the 88 numbers of a clip the L1 distance of its cumulative spectra and its true power."""
    found = []
    steps = np.arange(len(true))
    for joint in range(22):
        for number in range(4):
            powers = [
                [
                    float((signal[:, joint, number] * np.cos(2 * np.pi * k * steps / len(steps))).sum()) ** 2
                    for k in steps
                ]
                for signal in (made, true)
            ]
            one, other = (np.cumsum(power) / sum(power) for power in powers)
            found.append((float(np.abs(one - other).sum()), sum(powers[1])))
    return found


def test_rows_of_the_benchmark_are_those_of_its_definition(store: Store, motions: dict[str, Motion]) -> None:
    windows = lafan1_windows(store)
    expected = benchmark_by_loops(motions)
    for completer, row in ((HOLD, "zero"), (SLERP, "interpolation")):
        found = measure_windows(windows, gaps(LENGTHS), completer)
        for label, figures in expected[row].items():
            for metric, value in figures.items():
                mean = mean_over_takes(found[metric][label]).value
                assert mean == pytest.approx(value, rel=2e-3), (row, label, metric)
    # The body turns by more than half a turn in 45 frames: signs matter there.
    assert expected["zero"]["45 frames"]["l2q_as_signed"] > 1.05 * expected["zero"]["45 frames"]["l2q"]


def test_windows_of_subject_5_are_strictly_inside_their_takes(store: Store, motions: dict[str, Motion]) -> None:
    windows = lafan1_windows(store)
    # 146 frames: starts 0, 40, 80 (80 + 65 < 146); 65: none; 66: one. Training: 91 gives 0, 20, 40; 70 gives 0.
    assert windows.num_windows == 4 and windows.num_training_windows == 4
    assert windows.remark.startswith(f"subject 5, 4 windows (the whole data set has {BENCHMARK_WINDOWS:,})")
    np.testing.assert_allclose(windows.skeleton.offsets, motions["aiming1_subject1"].skeleton.offsets, atol=1e-4)


def test_an_encoder_that_knows_the_answer_scores_zero(store: Store) -> None:
    windows = lafan1_windows(store)
    truthful = replace(HOLD, name="truth", encoder=Truth(windows))
    found = measure_windows(windows, gaps((15,)), truthful)
    for metric, expected in (("l2p", 1e-3), ("l2q", 1e-3), ("npss", 1e-3), ("mpjpe_global", 1e-4)):
        assert mean_over_takes(found[metric]["15 frames"]).value < expected


def test_a_store_without_lafan1_says_what_is_looked_for(tmp_path: Path, motions: dict[str, Motion]) -> None:
    with StoreWriter.create(tmp_path / "store") as writer:
        writer.add(motions["walk3_subject5"])
    with pytest.raises(
        NoTakesError, match="no take of LaFAN1's subject1 or subject2 or subject3 or subject4 at 30 fps"
    ):
        lafan1_windows(Store.open(tmp_path / "store"))


class Truth:
    """Answers with the windows that it was made of, signs drawn at random."""

    name = "truth"

    def __init__(self, windows: PoseWindows) -> None:
        self.windows, self.rng, self.asked = windows, np.random.default_rng(0), 0

    def query_many(self, observations: list, times_seconds: np.ndarray) -> list:  # type: ignore[type-arg]
        frames = np.rint(times_seconds * 30).astype(int)
        made = []
        for observation in observations:
            local = self.windows.local_rotations[self.asked, frames]
            local = local * self.rng.choice([-1, 1], (len(frames), 22, 1)).astype(np.float32)
            root = self.windows.root_translation[self.asked, frames]
            positions = kinematics.forward_kinematics(local, root, observation.skeleton)
            made.append(type(observation.poses)(positions, local, root))
            self.asked += 1
        return made
