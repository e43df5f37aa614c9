"""HumanML3D's folders, and pose vectors of ten conventions in files of their own, against encoders written apart."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import motionkit as mk
from motionkit.core import kinematics
from motionkit.core.motion import Caption, mirror
from motionkit.core.skeletons.mapping import map_joints
from motionkit.features import humanml3d
from motionkit.io.humanml3d import KIT, Entry, recover_positions
from motionkit.io.kimodo import BODIES, g1
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import read, scan
from motionkit.io.smpl_body import mean_shape_skeleton
from motionkit.io.texts import read_texts
from tests.helpers.bones import check_rotations
from tests.helpers.every_format import write_pose_folder
from tests.helpers.refusal import refusal
from tests.helpers.vector_samples import (
    ardy_rows,
    dart_rows,
    flowmdm_rows,
    hymotion_rows,
    interhuman_rows,
    motionstreamer_rows,
    walk,
)


def test_recovery_reproduces_the_published_joints(golden_humanml3d: Path) -> None:
    vectors = np.load(next((golden_humanml3d / "new_joint_vecs").glob("*.npy")))
    joints = np.load(next((golden_humanml3d / "new_joints").glob("*.npy")))
    assert np.abs(recover_positions(vectors, 22) - joints).max() < 1e-6


def test_the_published_folder_is_recognised(golden_humanml3d: Path) -> None:
    (item,) = scan([golden_humanml3d]).items
    motion = read(item)
    assert (item.format, motion.fps, motion.skeleton.name) == ("humanml3d", 20, "smpl22")
    assert 1.3 < np.median(motion.joint_positions[:, 15, 1]) < 1.8


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    captions = (
        Caption("a person walks."),
        Caption("they stop", 1.25, 2.5),
        Caption("then # wait", 0.5, None, "then/ADV"),
    )
    entries = [
        Entry(f"{index:06d}", rng.normal(size=(60, 22, 3)).astype(np.float32), _vectors(rng), captions, split)
        for index, split in enumerate(("train", "train", "val", "test"))
    ]
    assert write_pose_folder(tmp_path / "out", [*entries, Entry("M000000", entries[0].joint_positions)]) == 5
    result = scan([tmp_path / "out"])
    assert [item.split for item in result.items] == ["train", "train", "val", "test", ""]
    assert not result.problems and not result.warnings
    first = read(result.items[0])
    assert np.array_equal(first.joint_positions, entries[0].joint_positions)
    assert [(c.text, c.start_seconds, c.end_seconds) for c in first.captions] == [
        ("a person walks.", 0.0, None),
        ("they stop", 1.25, 2.5),
        ("then wait", 0.5, 3.0),
    ]
    assert first.captions[0].tokens == "a/X person/X walks/X"
    mean, std = np.load(tmp_path / "out" / "Mean.npy"), np.load(tmp_path / "out" / "Std.npy")
    training = np.concatenate([entry.vectors for entry in entries[:2] if entry.vectors is not None]).astype(np.float64)
    assert np.allclose(mean, training.mean(0), atol=1e-6)
    assert np.allclose(std[4:67], training.std(0)[4:67].mean(), atol=1e-6)


def _vectors(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(59, 263)).astype(np.float32)


def test_vectors_alone_are_enough(tmp_path: Path, golden_humanml3d: Path) -> None:
    source = next((golden_humanml3d / "new_joint_vecs").glob("*.npy"))
    (tmp_path / "new_joint_vecs").mkdir()
    (tmp_path / "new_joint_vecs" / source.name).write_bytes(source.read_bytes())
    motion = read(scan([tmp_path]).items[0])
    assert motion.joint_positions.shape[1:] == (22, 3)


def test_kit_is_distinguished_and_becomes_metres(tmp_path: Path) -> None:
    body = np.full((25, 21, 3), 560.0, np.float32)
    entry = Entry("00001", body, captions=(Caption("a person walks"),), split="test")
    write_pose_folder(tmp_path / "kit", [entry], KIT)
    (item,) = scan([tmp_path / "kit"]).items
    motion = read(item)
    assert (item.format, motion.fps, motion.skeleton.name) == ("kit", Fraction(25, 2), "kit21")
    assert motion.joint_positions[0, 0, 1] == pytest.approx(0.952)
    assert read(item, ReadOptions(unit_metres=0.001)).joint_positions[0, 0, 1] == pytest.approx(0.56)


def test_captions_and_motions_that_miss_each_other(tmp_path: Path) -> None:
    write_pose_folder(tmp_path / "h", [Entry("000001", np.zeros((5, 22, 3), np.float32))])
    (tmp_path / "h" / "texts" / "000009.txt").write_text("a ghost#a/DET ghost/NOUN#0.0#0.0\n")
    (tmp_path / "h" / "val.txt").write_text("000001\n000007\n")
    result = scan([tmp_path / "h"])
    assert [problem.reason for problem in result.problems] == ["caption-without-motion"]
    assert [warning.reason for warning in result.warnings] == ["split-without-motion"]


@pytest.mark.parametrize(
    ("line", "expected"),
    [("walk#walk/VERB#nan#nan", (0.0, None)), ("walk#walk/VERB#6.0#2.5", (2.5, 6.0)), ("walk", (0.0, None))],
)
def test_segments(tmp_path: Path, line: str, expected: tuple[float, float | None]) -> None:
    (tmp_path / "a.txt").write_text(line + "\n\n", newline="")
    (caption,) = read_texts(tmp_path / "a.txt")
    assert (caption.text, caption.start_seconds, caption.end_seconds) == ("walk", *expected)


@pytest.mark.parametrize("line", ["a#b#c", "a#b#one#two"])
def test_a_bad_text_line_is_named(tmp_path: Path, line: str) -> None:
    (tmp_path / "a.txt").write_text(f"fine#fine/ADJ#0.0#0.0\n{line}\n")
    error = refusal(read_texts, tmp_path / "a.txt")
    assert (error.reason, error.line) == ("text", 2)


@pytest.fixture(scope="module")
def motion() -> mk.Motion:
    return walk()


def _read(path: Path, rows: np.ndarray, **options: object) -> mk.Motion:
    np.save(path, rows)
    return mk.read(path, **options)


@pytest.mark.parametrize(("layout", "fps"), [("smpl22", 20), ("kit21", Fraction(25, 2))])
def test_humanml3d_and_kit(tmp_path: Path, motion: mk.Motion, layout: str, fps: Fraction) -> None:
    unit = KIT.unit_metres if layout == "kit21" else 1.0
    own = humanml3d.facing_forward(humanml3d.at_origin(map_joints(motion, layout) / np.float32(unit)), layout)
    rows = humanml3d.vectors(own, layout)
    found = _read(tmp_path / "walk.npy", rows)
    assert found.fps == fps and found.provenance.source_format in ("humanml3d", "kit")
    np.testing.assert_allclose(found.joint_positions, own[:-1] * unit, atol=2e-3)
    np.testing.assert_array_equal(_read(tmp_path / "one.npy", rows[None]).joint_positions, found.joint_positions)
    (tmp_path / "motions.json").write_text('{"fps": 60}')
    assert mk.read(tmp_path / "walk.npy").fps == 60
    assert mk.read(tmp_path / "walk.npy", fps=24).fps == 24


def test_interhuman(tmp_path: Path, motion: mk.Motion) -> None:
    other = mirror(motion)
    rows, others = interhuman_rows(motion), interhuman_rows(other)
    assert rows.shape[1] == 262
    alone = _read(tmp_path / "alone.npy", rows)
    assert alone.fps == 30
    np.testing.assert_array_equal(alone.joint_positions, motion.joint_positions[:-1])
    for name, both in (("stacked", np.stack((rows, others), axis=1)), ("flat", np.hstack((rows, others)))):
        np.save(tmp_path / f"{name}.npy", both)
        first, second = mk.read_all(tmp_path / f"{name}.npy")
        assert first.sequence_id.endswith(f"{name}/person1") and second.sequence_id.endswith(f"{name}/person2")
        np.testing.assert_array_equal(first.joint_positions, motion.joint_positions[:-1])
        np.testing.assert_array_equal(second.joint_positions, other.joint_positions[:-1])
    own = np.zeros((len(rows), 492), np.float32)
    own[:, :66] = motion.joint_positions[:-1][..., [0, 2, 1]].reshape(-1, 66)
    own[:, 1:66:3] *= -1
    np.testing.assert_array_equal(_read(tmp_path / "1.npy", own).joint_positions, alone.joint_positions)


def test_motionstreamer(tmp_path: Path, motion: mk.Motion) -> None:
    found = _read(tmp_path / "walk.npy", motionstreamer_rows(motion))
    assert found.fps == 30
    # Neither where it starts nor which way is in the numbers.
    x, _, z = kinematics.quaternion_to_matrix(motion.local_rotations[0, 0])[:, 2]
    half = -np.arctan2(x, z) / 2
    turn = np.array([np.cos(half), 0, np.sin(half), 0])
    start = motion.joint_positions[0, 0] * [1, 0, 1]
    np.testing.assert_allclose(
        found.joint_positions, kinematics.quaternion_rotate(turn, motion.joint_positions - start), atol=1e-5
    )
    np.testing.assert_allclose(
        abs(np.sum(found.local_rotations[:, 1:] * motion.local_rotations[:, 1:], -1)), 1, atol=1e-5
    )
    check_rotations(found)


@pytest.mark.parametrize(
    ("width", "change", "reason"),
    [
        *((width, lambda rows: np.random.default_rng(0).normal(size=rows.shape), "unit") for width in (263, 262, 272)),
        *((width, lambda rows: np.where(rows == rows[3], np.nan, rows), "nan") for width in (263, 262)),
        (272, lambda rows: np.where(np.arange(272) >= 140, 0.0, rows), "unit"),
        (272, lambda rows: rows[:0], "no-frames"),
        (263, lambda rows: np.full(rows.shape, 1e7), "range"),
        (263, lambda rows: rows.astype("U8"), "not-a-number"),
    ],
)
def test_what_is_wrong_with_vectors_is_reported(tmp_path, motion, width, change, reason):
    rows = {
        263: lambda: humanml3d.vectors(motion.joint_positions, "smpl22"),
        262: lambda: interhuman_rows(motion),
        272: lambda: motionstreamer_rows(motion),
    }[width]()
    assert rows.shape[1] == width
    assert refusal(_read, tmp_path / "bad.npy", change(rows)).reason == reason


def test_hymotion_and_motion135(tmp_path: Path) -> None:
    rest = mean_shape_skeleton()
    source = walk()
    joints = kinematics.forward_kinematics(source.local_rotations, source.root_translation, rest)
    motion = mk.Motion(joints, rest, source.timegrid, local_rotations=source.local_rotations)
    rows = hymotion_rows(motion, rest.offsets[0])
    for width, options in ((201, {}), (135, {"format": "motion-135"})):
        np.save(tmp_path / f"{width}.npy", rows[:, :width])
        (item,) = scan([tmp_path / f"{width}.npy"], ReadOptions(**options)).items
        found = read(item)
        assert found.fps == 30
        np.testing.assert_allclose(found.joint_positions, joints, atol=1e-5)
        check_rotations(found, 1e-4)


@pytest.mark.parametrize("vimogen", [False, True])
def test_dart_and_vimogen_share_a_width(tmp_path: Path, motion: mk.Motion, vimogen: bool) -> None:
    np.save(tmp_path / "a.npy", dart_rows(motion, vimogen=vimogen))
    assert not scan([tmp_path]).items, "276 numbers may be either"
    name = "vimogen-276" if vimogen else "dart-276"
    (item,) = scan([tmp_path], ReadOptions(format=name)).items
    assert refusal(read, item).reason == "no-framerate"
    found = read(item, ReadOptions(fps=Fraction(30)))
    np.testing.assert_allclose(found.joint_positions, motion.joint_positions[:-1], atol=1e-5)
    if not vimogen:
        same = np.sum(found.local_rotations * motion.local_rotations[:-1], axis=-1)
        np.testing.assert_allclose(abs(same), 1, atol=1e-5)


def test_ardy(tmp_path: Path, motion: mk.Motion) -> None:
    offsets = np.tile([0.0, -0.4, 0.0], (27, 1))
    offsets[1:7, 1] = 0.12
    body = replace(BODIES["ardy-core27"], offsets=offsets.astype(np.float32))
    turns = Rotation.from_rotvec(np.random.default_rng(0).uniform(-0.3, 0.3, (540, 3)))
    local = turns.as_quat(scalar_first=True).reshape(20, 27, 4)
    places = kinematics.forward_kinematics(local, motion.joint_positions[:20, 0], body)
    world = kinematics.quaternion_to_matrix(kinematics.global_rotations(local, body))
    found = _read(tmp_path / "a.npy", ardy_rows(places, world))
    assert found.fps == 20 and found.skeleton.joint_names == BODIES["ardy-core27"].joint_names
    np.testing.assert_allclose(found.joint_positions, places, atol=1e-5)
    np.testing.assert_allclose(abs(np.sum(found.local_rotations * local, axis=-1)), 1, atol=1e-5)


def test_flowmdm_shares_a_width_with_motion135(tmp_path: Path) -> None:
    rest, source = mean_shape_skeleton(), walk()
    assert source.local_rotations is not None and source.root_translation is not None
    up = Rotation.from_matrix([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    turns = source.local_rotations.astype(np.float64)
    turns[:, 0] = (up * Rotation.from_quat(turns[:, 0], scalar_first=True)).as_quat(scalar_first=True)
    places = up.apply(source.root_translation)
    expected = kinematics.forward_kinematics(turns, places, rest)
    rows = flowmdm_rows(places - rest.offsets[0], turns)
    np.save(tmp_path / "a.npy", rows)
    assert not scan([tmp_path]).items, "135 numbers may be Motius' or FlowMDM's"
    (item,) = scan([tmp_path], ReadOptions(format="flowmdm-135")).items
    found = read(item)
    assert found.fps == 30
    # Paths begin at 0.
    world = Rotation.apply(up, found.joint_positions.reshape(-1, 3)).reshape(expected.shape)
    np.testing.assert_allclose(world, expected - (places[0] - rest.offsets[0]) * [1, 1, 0], atol=1e-4)
    assert found.local_rotations is not None
    np.save(tmp_path / "a.npy", (rows - rows.mean(axis=0)) / 0.1)
    assert refusal(read, item).reason == "unit"


def test_motius_npz(tmp_path: Path) -> None:
    rows = hymotion_rows(walk(), mean_shape_skeleton().offsets[0])[:, :135]
    np.savez(tmp_path / "a.npz", motion_135=rows)
    np.save(tmp_path / "b.npy", rows)
    expected = mk.read(tmp_path / "b.npy", format="motion-135")
    found = mk.read(tmp_path / "a.npz")
    assert found.fps == 30
    np.testing.assert_array_equal(found.joint_positions, expected.joint_positions)
    np.savez(tmp_path / "a.npz", motion_135=rows[:, :134])
    assert refusal(mk.read, tmp_path / "a.npz").reason == "channel-count"


def g1_walk() -> tuple[np.ndarray, Rotation, np.ndarray, np.ndarray]:
    """Root [6, 3], its rotations, angles [6, 29] and joints [6, 34, 3], z up, link by link with scipy."""
    rng, (skeleton, turns, axes) = np.random.default_rng(0), g1()
    hinges = np.flatnonzero(axes.any(axis=1)).tolist()
    assert len(hinges) == 29
    root = np.stack([0.02 * np.arange(6), 0.02 * np.arange(6), np.full(6, 0.76)], axis=1)
    heading = Rotation.from_rotvec([[0.1, 0.0, 0.7 + 0.1 * frame] for frame in range(6)])
    angles, joints = rng.uniform(-0.4, 0.4, (6, 29)), np.zeros((6, 34, 3))
    for frame in range(6):
        frames = [heading[frame]]
        joints[frame, 0] = root[frame]
        for joint in range(1, 34):
            above = skeleton.parents[joint]
            joints[frame, joint] = joints[frame, above] + frames[above].apply(skeleton.offsets[joint])
            angle = angles[frame, hinges.index(joint)] if joint in hinges else 0.0
            own = Rotation.from_quat(turns[joint], scalar_first=True) * Rotation.from_rotvec(angle * axes[joint])
            frames.append(frames[above] * own)
    return root, heading, angles, joints


def test_unitree_g1_stands_as_its_model_does(tmp_path: Path) -> None:
    root, heading, angles, expected = g1_walk()
    sixes = heading.as_matrix()[:, :, :2].reshape(6, 6)
    rows = np.concatenate([np.diff(root[:, :2], axis=0, prepend=0), root[:, 2:], sixes, angles], axis=1)
    found = _read(tmp_path / "a.npy", np.float32(rows))
    np.testing.assert_allclose(found.joint_positions[..., [0, 2, 1]] * [1, -1, 1], expected, atol=1e-5)
    check_rotations(found)
    # The published model stands with its pelvis 0.793 m above the floor.
    zero = _read(tmp_path / "zero.npy", np.eye(1, 38, 3, dtype=np.float32) + np.eye(1, 38, 6, dtype=np.float32))
    assert zero.joint_positions[0, found.skeleton.index("right_toe_base"), 1] == pytest.approx(-0.793, abs=2e-3)
    assert map_joints(zero, "smpl22").shape == (1, 22, 3)
    np.savez(tmp_path / "kimodo.npz", posed_joints=found.joint_positions)
    assert mk.read(tmp_path / "kimodo.npz").skeleton.joint_names == found.skeleton.joint_names


def _rows(table: np.ndarray) -> str:
    return "".join(",".join(f"{value:.8f}" for value in row) + "\n" for row in table)


LEG, WAIST = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll"), ("yaw", "roll", "pitch")
ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw")
LIMBS = (("left", LEG), ("right", LEG), ("waist", WAIST), ("left", ARM), ("right", ARM))


@pytest.mark.parametrize("kind", ["seed", "w first", "w last"])
def test_unitree_g1_in_csv(tmp_path: Path, kind: str) -> None:
    root, heading, angles, expected = g1_walk()
    path = tmp_path / "walk.csv"
    if kind == "seed":
        names = [f"root_{what}{axis}" for what in ("translate", "rotate") for axis in "XYZ"]
        header = ",".join(
            ["Frame", *names, *(f"{limb}_{hinge}_joint_dof" for limb, hinges in LIMBS for hinge in hinges)]
        )
        table = [np.arange(6)[:, None], 100 * root, heading.as_euler("xyz", degrees=True), np.degrees(angles)]
        path.write_text(f"{header}\n{_rows(np.concatenate(table, axis=1))}")
    else:
        quaternions = heading.as_quat(scalar_first=kind == "w first")
        path.write_text(_rows(np.concatenate([root, quaternions, angles], axis=1)))
    found = mk.read(path)
    assert found.fps == (120 if kind == "seed" else 30)
    np.testing.assert_allclose(found.joint_positions[..., [0, 2, 1]] * [1, -1, 1], expected, atol=1e-5)
    check_rotations(found)
    if kind != "seed":
        other = mk.read(path, format="g1-csv-xyzw" if kind == "w first" else "g1-csv-wxyz")
        assert np.abs(other.joint_positions - found.joint_positions).max() > 0.5
    text = path.read_text()
    path.write_text(text.replace(",root_rotateX", ",rotateX") if kind == "seed" else text.rpartition(",")[0])
    assert refusal(mk.read, path, format="g1-csv").reason == "channel-count"
