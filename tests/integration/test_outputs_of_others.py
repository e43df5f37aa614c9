"""What other systems write, through the command line: as captures, and as samples of a model."""

import numpy as np
import pytest

import motionkit as mk
from motionkit.formats.kimodo import SKELETONS
from motionkit.synthetic import make_body, perform

FRAMES = 40


@pytest.fixture
def outputs(tmp_path):
    """A walk as Kimodo's joints and as SMPL-H's 52; a body at rest as SMPL's parameters and as Motion-X's rows."""
    folder = tmp_path / "outputs"
    folder.mkdir()
    walk = perform(np.random.default_rng(0), make_body("test"), ["walk"], 2.0).query(np.arange(FRAMES) / 30)
    joints = walk.joint_positions.astype(np.float32)
    np.savez(folder / "kimodo.npz", posed_joints=joints)
    np.save(folder / "joints52.npy", np.concatenate((joints, np.repeat(joints[:, -1:], 30, axis=1)), axis=1))
    (folder / "motions.json").write_text('{"fps": 30}')
    rest = np.zeros((FRAMES, 3), np.float32)
    np.savez(folder / "gvhmr.npz", global_orient=rest, body_pose=np.zeros((FRAMES, 63)), transl=rest + 0.9, fps=30)
    np.save(folder / "motionx.npy", np.zeros((FRAMES, 322), np.float32))
    return folder


def test_they_are_ingested(motionkit, outputs, tmp_path):
    outcome = motionkit("ingest", outputs, "--store", tmp_path / "store")
    assert outcome.code == 0 and "stored 4 sequences" in outcome.stdout
    store = mk.Store.open(tmp_path / "store")
    kinds = dict(zip(store.sequences["source_format"], store.sequences["has_rotations"], strict=True))
    assert kinds == {"kimodo": False, "joints-npy": False, "smpl": True, "motion-x": True}
    np.testing.assert_array_equal(
        store.read("outputs/kimodo").joint_positions, store.read("outputs/joints52").joint_positions
    )


def test_they_are_samples(motionkit, outputs):
    outcome = motionkit("samples", outputs)
    assert outcome.code == 0 and " 4, " in outcome.stdout.splitlines()[0]
    assert "30 fps (4)" in outcome.stdout


def test_a_robot_s_joints_are_told(motionkit, tmp_path):
    np.savez(tmp_path / "g1.npz", posed_joints=np.zeros((4, 34, 3), np.float32))
    (line,) = motionkit("view", tmp_path / "g1.npz").error_lines
    assert f"34 joints, expected {', '.join(str(count) for count in SKELETONS)}"[:20] in line
