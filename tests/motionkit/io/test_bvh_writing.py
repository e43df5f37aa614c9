"""BVH files written: from motions, and again with their own text and lines; by ingest, complete and view alike."""

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymotion.io.bvh import BVH
from scipy.spatial.transform import Rotation

import motionkit as mk
from motionkit.core import kinematics
from motionkit.core.kinematics import euler_to_quaternion
from motionkit.edit.complete import CompletionRequest, completed_motion
from motionkit.edit.encoders import choose_encoder
from motionkit.edit.motions import MotionSource, OutputPaths, edit_file, find_motions
from motionkit.fields.interpolation import INTERPOLATORS
from motionkit.fields.motion_field import Observation
from motionkit.fields.resample import begin_completion
from motionkit.fields.rig import on_bones
from motionkit.io.bvh import BvhDocument, KnownFrames, angles_near, read_bvh, read_document, rewrite_bvh, write_bvh
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import parse_rules
from motionkit.store.ingest import ingest
from tests.helpers.format_samples import NUM_BVH_CHANNELS, TWO_JOINTS, bvh_hierarchy, bvh_text, lafan1_text
from tests.motionkit.io.test_bvh import TAKES, along_z


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    (tmp_path / "in.bvh").write_text(bvh_text(frame_time=".0083333"))
    motion = read_bvh(tmp_path / "in.bvh")
    write_bvh(motion, tmp_path / "out.bvh")
    again = read_bvh(tmp_path / "out.bvh")
    assert again.fps == motion.fps == 120
    assert again.skeleton.joint_names == motion.skeleton.joint_names
    for (joint, tip), (joint_again, tip_again) in zip(motion.skeleton.end_sites, again.skeleton.end_sites, strict=True):
        assert joint == joint_again and tip == pytest.approx(tip_again)
    assert np.allclose(again.joint_positions, motion.joint_positions, atol=1e-5)
    assert again.local_rotations is not None and motion.local_rotations is not None
    assert np.allclose(np.abs(np.sum(again.local_rotations * motion.local_rotations, axis=-1)), 1.0, atol=1e-6)


@pytest.mark.parametrize(
    ("change_metres", "placed", "misses_metres", "fps"),
    [(0.0, 1, 1e-4, Fraction(20)), (3e-4, 1, 2e-3, Fraction(30000, 1001)), (0.02, 22, 1.5e-4, Fraction(25, 2))],
)
def test_bones_that_keep_their_length_need_no_position_channels(tmp_path, change_metres, placed, misses_metres, fps):
    """Whatever shape the body's own hips and shoulders have; bones that change a little are written as one skeleton."""
    rng = np.random.default_rng(3)
    offsets = mk.SMPL22.offsets + rng.normal(0, 0.03, mk.SMPL22.offsets.shape).astype(np.float32)
    turns = Rotation.random(50 * 22, rng).as_quat(scalar_first=True).reshape(50, 22, 4).astype(np.float32)
    root = rng.normal(size=(50, 3)).astype(np.float32)
    positions = kinematics.forward_kinematics(turns, root, replace(mk.SMPL22, offsets=offsets))
    positions = (positions + rng.uniform(-change_metres, change_metres, positions.shape)).astype(np.float32)
    write_bvh(mk.Motion(positions, mk.SMPL22, mk.TimeGrid(fps, 50)), tmp_path / "own.bvh")
    text = (tmp_path / "own.bvh").read_text()
    assert (text.count("CHANNELS 6"), text.count("CHANNELS 3")) == (placed, 22 - placed)
    again = read_bvh(tmp_path / "own.bvh")
    order = [again.skeleton.index(joint) for joint in mk.SMPL22.joint_names]
    assert again.fps == fps and (again.local_rotations is None) == (placed == 22)
    assert np.abs(again.joint_positions[:, order] - positions).max() < misses_metres


def test_rotations_in_gimbal_lock_come_back(tmp_path: Path) -> None:
    """A root that pitches by exactly 90 degrees in many headings, as float32 holds it."""
    turns = np.zeros((60, 22, 4))
    turns[..., 0] = 1.0
    turns[:, 0] = Rotation.from_euler("ZXY", [[0, 90, 6 * k] for k in range(60)], degrees=True).as_quat(
        scalar_first=True
    )
    turns = turns.astype(np.float32)
    root = np.zeros((60, 3), np.float32)
    motion = mk.Motion(
        kinematics.forward_kinematics(turns, root, mk.SMPL22), mk.SMPL22, mk.TimeGrid(Fraction(60), 60), turns, root
    )
    write_bvh(motion, tmp_path / "out.bvh")
    again = read_bvh(tmp_path / "out.bvh", ReadOptions(up="y"))
    order = [again.skeleton.index(joint) for joint in mk.SMPL22.joint_names]
    np.testing.assert_allclose(again.joint_positions[:, order], motion.joint_positions, atol=1e-4)


CUBIC = INTERPOLATORS["rotation-cubic"]


def rows(num_frames: int = 12, seed: int = 0) -> list[list[float]]:
    """Angles that swing and wind up, in the file's six digits; the left foot and the root's x rest."""
    rng = np.random.default_rng(seed)
    seconds = np.arange(num_frames) / 30
    table = 25 * np.sin(rng.uniform(3, 6, NUM_BVH_CHANNELS) * seconds[:, None] + rng.uniform(0, 6, NUM_BVH_CHANNELS))
    table[:, 0], table[:, 1] = 12.3456, 95 + 2 * np.sin(9 * seconds)
    table[:, 3] += 170 + 160 * seconds
    foot = 6 + 3 * 11
    table[:, foot : foot + 3] = (1.25, -33.3, 90.0)
    return np.round(table, 6).tolist()


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def completed(document: BvhDocument, path: Path, **options: Any) -> BvhDocument:
    """The document completed, written with its own lines and channels, and read again."""
    seconds, frames = document.motion.timegrid.seconds(), np.arange(document.motion.num_frames)
    observation = Observation(seconds[frames], document.poses.rows(frames), document.motion.skeleton)
    fps = options.pop("fps", document.motion.timegrid.fps)
    made = begin_completion(observation, (seconds[0], seconds[-1]), CUBIC, fps, **options)
    made = replace(made, field=on_bones(made.field, observation))
    known = KnownFrames(frames, seconds[frames], made.given_rows, frames[made.given_poses])
    rewrite_bvh(document, path, made.motion(), known)
    return read_document(path)


def test_given_frames_are_the_lines_that_they_were(tmp_path: Path) -> None:
    document = read_document(written(tmp_path / "in.bvh", bvh_text(rows())))
    made = completed(document, tmp_path / "out.bvh", fps=Fraction(120))
    assert made.lines[::4] == document.lines and len(made.lines) == 4 * 11 + 1
    assert made.head.text == document.head.text and made.motion.timegrid.fps == 120
    np.testing.assert_array_equal(made.table[::4], document.table)
    # What rests stays as it is to the last digit; what winds up continues.
    foot = 6 + 3 * 11
    assert set(made.table[:, 0]) == {12.3456} and set(made.table[:, foot + 2]) == {90.0}
    assert np.abs(np.diff(made.table, axis=0)).max() < 10
    assert made.table[-1, 3] > 200


def test_another_reader_sees_the_same_motion(tmp_path: Path) -> None:
    document = read_document(written(tmp_path / "in.bvh", bvh_text(rows())))
    made = completed(document, tmp_path / "out.bvh", fps=Fraction(90), after_seconds=0.1)
    bvh = BVH()
    bvh.load(str(tmp_path / "out.bvh"))
    rotations, positions, _, offsets, _, _ = bvh.get_data()
    assert list(bvh.data["names"]) == list(made.motion.skeleton.joint_names)
    assert bvh.data["frame_time"] == pytest.approx(1 / 90, abs=1e-12)
    assert len(rotations) == made.motion.timegrid.num_frames
    mine = made.poses.local_rotations
    assert mine is not None
    assert np.abs(np.sum(rotations * mine, axis=-1)).min() > 1 - 1e-6
    np.testing.assert_allclose(positions[:, 0] * document.unit_metres, made.poses.joint_positions[:, 0], atol=1e-5)
    np.testing.assert_allclose(offsets[1:] * document.unit_metres, made.motion.skeleton.offsets[1:], atol=1e-6)


def test_a_t_pose_in_front_stays_in_front(tmp_path: Path) -> None:
    table = rows()
    t_pose = [0.0] * NUM_BVH_CHANNELS
    t_pose[:3] = table[0][:3]
    document = read_document(written(tmp_path / "in.bvh", bvh_text([t_pose, *table])))
    assert document.has_reference and document.motion.timegrid.num_frames == 12
    made = completed(document, tmp_path / "out.bvh", fps=Fraction(60))
    assert made.has_reference and made.lines[::2] == document.lines
    assert b"Frames: 24" in (tmp_path / "out.bvh").read_bytes()


@pytest.mark.parametrize("rests_along_z", [True, False])
def test_a_body_along_z_is_written_along_z(tmp_path: Path, rests_along_z: bool) -> None:
    """Where the rest pose is along z too, and where the root's rotation takes it there."""

    table = rows()
    for row in table:
        row[1], row[2] = -row[2], row[1]
        row[3:6] = [0.0, 0.0 if rests_along_z else 90.0, 0.0]
    text = along_z(bvh_text(table)) if rests_along_z else bvh_text(table)
    document = read_document(written(tmp_path / "in.bvh", text))
    assert (document.up, document.rest_has_same_up) == ("z", rests_along_z)
    made = completed(document, tmp_path / "out.bvh", fps=Fraction(60))
    assert made.up == "z" and made.lines[::2] == document.lines
    between = 0.5 * (made.table[:-2:2] + made.table[2::2])
    assert np.abs(made.table[1::2] - between).max() < 1.0


def test_quadrupeds_and_props_are_written_too(tmp_path: Path) -> None:
    text = bvh_text(["0 0 0 0 0 0 0", "1 0 0 30 0 0 10", "2 0 0 60 0 0 20"], "0.01", bvh_hierarchy(TWO_JOINTS))
    text = text.replace("CHANNELS 3 Zrotation Xrotation Yrotation", "CHANNELS 1 Xrotation")
    made = completed(read_document(written(tmp_path / "in.bvh", text)), tmp_path / "out.bvh", fps=Fraction(200))
    np.testing.assert_allclose(made.table[1], [0.5, 0, 0, 15, 0, 0, 5], atol=1e-5)


OPTIONS = ReadOptions(fps_rules=parse_rules('[[rule]]\nfiles = "**/slow.bvh"\nfps = 24\n', "mine.toml"))


def source(name: str, text: str) -> Callable[[Path], Path]:
    """A source of one file."""

    def write(folder: Path) -> Path:
        (folder / name).write_bytes(text.encode())
        return folder / name

    return write


def of_100style(folder: Path) -> Path:
    (folder / "Frame_Cuts.csv").write_text("STYLE_NAME,FW_START,FW_STOP\nOld,10,40\n")
    return source("Old_FW.bvh", TAKES["plain"])(folder)


KINDS: dict[str, Callable[[Path], Path]] = {
    **{name: source("take.bvh", text) for name, text in TAKES.items() if name != "one frame"},
    "lafan1": source("walk1_subject5.bvh", lafan1_text(20)),
    "100style": of_100style,
    "a rule for its clock": source("slow.bvh", TAKES["plain"]),
}


def source_of(path: Path) -> MotionSource:
    (source,), problems = find_motions([str(path)], OPTIONS, path.parent / "none")
    assert not problems
    return source


@pytest.mark.parametrize("kind", KINDS)
def test_ingest_and_complete_see_one_motion_and_a_completed_one_is_read_again(tmp_path: Path, kind: str) -> None:
    (tmp_path / "in").mkdir()
    path, out = KINDS[kind](tmp_path / "in"), tmp_path / "out.bvh"
    assert not ingest([path], tmp_path / "store", options=OPTIONS, num_workers=1).problems
    stored, loaded = mk.Store.open(tmp_path / "store").read(0), source_of(path).load()
    motion = loaded.motion
    assert loaded.valid.all() and loaded.uneven_seconds is None
    assert stored.timegrid == motion.timegrid
    assert stored.skeleton.fingerprint == motion.skeleton.fingerprint
    # A store rounds rotations in the last digit and makes positions of them again.
    np.testing.assert_allclose(stored.joint_positions, motion.joint_positions, atol=1e-6)
    assert (stored.local_rotations is None) == (motion.local_rotations is None)
    for name in ("provenance", "action", "style", "split", "captions"):
        assert getattr(stored, name) == getattr(motion, name)
    # Completed: given frames stay where they are, new ones lie between them.
    request, slerp = CompletionRequest(fps=2 * motion.fps), choose_encoder("slerp", None, tmp_path)
    complete = partial(completed_motion, request=request, chosen=slerp)
    edit_file(source_of(path), complete, OutputPaths("completed", [str(path)], 1, out=out), request.fps)
    old, new = motion.joint_positions, source_of(out).load().motion.joint_positions
    assert len(new) == 2 * len(old) - 1
    np.testing.assert_allclose(new[::2], old, atol=1e-5)
    # Slerp between its neighbours turns each bone by no more than they are apart.
    apart = np.linalg.norm(np.diff(old, axis=0), axis=-1).max()
    assert np.linalg.norm(new[1::2] - old[:-1], axis=-1).max() <= 1.01 * apart + 1e-5


ORDERS = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX", "ZXZ", "XYX", "YZY")


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), order=st.sampled_from(ORDERS), turns=st.integers(-2, 2), other=st.booleans())
def test_angles_give_the_rotations_and_stay_near_the_expected(seed: int, order: str, turns: int, other: bool) -> None:
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=3) + np.cumsum(0.02 * rng.normal(size=3) + 0.006 * rng.normal(size=(40, 3)), axis=0)
    rotations = Rotation.from_rotvec(vectors).as_quat(scalar_first=True)
    angles = Rotation.from_quat(rotations, scalar_first=True).as_euler(order)
    if other:
        second = -angles[:, 1] if order[0] == order[2] else np.pi - angles[:, 1]
        angles = np.stack((angles[:, 0] + np.pi, second, angles[:, 2] + np.pi), axis=1)
    expected = np.degrees(angles + 2 * np.pi * turns)
    found = angles_near(rotations, order, expected + rng.uniform(-1, 1, expected.shape))
    again = euler_to_quaternion(np.radians(found), order)
    assert np.abs(np.sum(again * rotations, axis=-1)).min() > 1 - 1e-9
    assert (np.abs(found - expected).sum(axis=1) < 1e-6).mean() > 0.9  # near gimbal lock another triple may be nearer
