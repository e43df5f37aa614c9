"""`motionkit ingest` of an AMASS folder: body models, framerate rules, and what the store says about both."""

import json

import numpy as np
import pytest

from motionkit.store import Store


def write_motion(path, width, **changes):
    path.parent.mkdir(parents=True, exist_ok=True)
    poses = np.zeros((6, width))
    poses[:, 0] = np.pi / 2
    fields = {"poses": poses, "trans": np.tile([0.0, 0.0, 1.2], (6, 1)), "gender": "female", "betas": np.ones(16)}
    np.savez(path, **fields | changes)


@pytest.fixture
def amass(tmp_path):
    folder = tmp_path / "AMASS"
    write_motion(folder / "CMU" / "62" / "62_11_poses.npz", 156, mocap_framerate=59.9999885)
    write_motion(folder / "TotalCapture" / "s1" / "walking1_stageii.npz", 165, mocap_frame_rate=120.0)
    write_motion(folder / "DanceDB" / "x" / "dance_poses.npz", 156, mocap_framerate=np.nan)
    np.savez(folder / "CMU" / "62" / "shape.npz", betas=np.ones(16))
    return folder


@pytest.fixture
def body_models(tmp_path):
    rng = np.random.default_rng(0)
    for family, joints in (("smplh", 52), ("smplx", 55)):
        path = tmp_path / "models" / family / f"{family.upper()}_FEMALE.npz"
        path.parent.mkdir(parents=True)
        regressor = np.eye(joints, 60)
        np.savez(
            path, v_template=rng.normal(size=(60, 3)), shapedirs=rng.normal(size=(60, 3, 20)), J_regressor=regressor
        )
    return tmp_path / "models"


def test_both_generations_at_the_right_framerates(motionkit, amass, tmp_path):
    store = tmp_path / "store"
    outcome = motionkit("ingest", amass, "--store", store, "--json")
    assert outcome.code == 0
    summary = json.loads(outcome.stdout)
    assert summary["stored"] == 2 and summary["failed"] == {"framerate": 1}
    assert "dance_poses.npz: mocap_framerate: nan" in outcome.stderr
    stored = Store.open(store)
    walking = stored.read("AMASS/TotalCapture/s1/walking1_stageii")
    assert (walking.fps, walking.provenance.stated_fps, walking.skeleton.num_joints) == (60, "120.0", 22)
    assert any("by rule (shipped" in line for line in walking.provenance.operations)
    digging = stored.read("AMASS/CMU/62/62_11_poses")
    assert (digging.fps, digging.provenance.stated_fps) == (60, "59.9999885")
    assert (digging.provenance.subset, digging.provenance.subject) == ("CMU", "62")
    assert motionkit("validate", "--store", store).code == 0


def test_body_models_and_rules_of_the_users_own(motionkit, amass, body_models, tmp_path, monkeypatch):
    rules = tmp_path / "rules.toml"
    rules.write_text('[[rule]]\nfiles = "DanceDB/**/*.npz"\nfps = "30000/1001"\n')
    store = tmp_path / "store"
    outcome = motionkit("ingest", amass, "--store", store, "--body-models", body_models, "--fps-rules", rules)
    assert (outcome.code, outcome.error_lines) == (0, [])
    stored = Store.open(store)
    assert stored.read("AMASS/DanceDB/x/dance_poses").fps * 1001 == 30000
    names = {name: stored.read(name).skeleton for name in stored.sequences["sequence_id"]}
    assert sorted((each.name, each.num_joints) for each in names.values()) == [
        ("smplh-female", 52),
        ("smplh-female", 52),
        ("smplx-female", 55),
    ]
    monkeypatch.setenv("MOTIONKIT_BODY_MODELS", str(body_models))
    assert motionkit("ingest", amass, "--store", tmp_path / "other").code == 0
    assert Store.open(tmp_path / "other").read("AMASS/CMU/62/62_11_poses").skeleton.num_joints == 52


def test_a_neutral_body_in_the_place_of_a_gendered_one_is_a_warning(motionkit, amass, body_models, tmp_path):
    (body_models / "smplh" / "SMPLH_FEMALE.npz").rename(body_models / "smplh" / "SMPLH_NEUTRAL.npz")
    write_motion(amass / "CMU" / "63" / "63_01_poses.npz", 156, mocap_framerate=120.0, gender="neutral")
    write_motion(amass / "CMU" / "64" / "64_01_poses.npz", 156, mocap_framerate=120.0, gender="unknown")
    options = ("--store", tmp_path / "store", "--body-models", body_models)
    outcome = motionkit("ingest", amass, *options, "--json")
    summary = json.loads(outcome.stdout)
    assert outcome.code == 0 and summary["stored"] == 4 and summary["warnings"]["neutral-body"] == 1
    assert "62_11_poses.npz: has the neutral smplh body under a female subject's betas" in outcome.stderr
    assert "SMPLH_FEMALE.npz" in outcome.stderr and "--overwrite" in outcome.stderr
    plain = motionkit("ingest", amass, *options, "--overwrite")
    assert "1 neutral-body" in plain.stdout


def test_wrong_options_are_usage_errors(motionkit, amass, tmp_path):
    missing = motionkit("ingest", amass, "--store", tmp_path / "store", "--body-models", tmp_path / "none")
    assert missing.code == 2 and "--body-models" in missing.stderr
    (tmp_path / "rules.toml").write_text('[[rule]]\nfiles = "*"\nfps = 0\n')
    rules = motionkit("ingest", amass, "--store", tmp_path / "store", "--fps-rules", tmp_path / "rules.toml")
    assert rules.code == 2 and "rule 1: fps" in rules.stderr
    assert not (tmp_path / "store").exists()
