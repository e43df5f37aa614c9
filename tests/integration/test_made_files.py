"""What `motionkit complete` and `plant` leave beside captures, in which form, and how their faults are told."""

import numpy as np

import motionkit as mk
from tests.helpers.amass_samples import smplh_fields, write_amass


def test_what_was_made_is_no_capture(motionkit, takes, tmp_path):
    assert motionkit("complete", takes / "alpha.bvh", "--fps", "60", "--model", "slerp").code == 0
    outcome = motionkit("ingest", takes, "--store", tmp_path / "store")
    assert "stored 3 sequences" in outcome.stdout and "warnings: 1 (1 unmapped-skeleton)" in outcome.stdout
    assert "alpha.completed.bvh" in next(line for line in outcome.stdout.splitlines() if line.startswith("ignored: 1"))
    named = motionkit("ingest", takes / "alpha.completed.bvh", "--store", tmp_path / "store")
    assert "stored 1 sequence" in named.stdout


def test_the_option_of_a_remedy_is_the_command_s_own(motionkit, tmp_path):
    np.save(tmp_path / "joints.npy", np.zeros((10, 22, 3), np.float32))
    for command in ("complete", "plant"):
        outcome = motionkit(command, tmp_path / "joints.npy", *(("--fps", 60) if command == "complete" else ()))
        assert outcome.code == 1 and "use --source-fps" in outcome.stderr and "use --fps" not in outcome.stderr
    assert "use --fps" in motionkit("view", tmp_path / "joints.npy").stderr


def test_a_capture_of_amass_becomes_bvh(motionkit, tmp_path):
    source = write_amass(tmp_path / "walk_poses.npz", smplh_fields(num_frames=8))
    outcome = motionkit("complete", source, "--fps", 240, "--model", "slerp")
    assert outcome.code == 0 and outcome.stdout.split() == [str(tmp_path / "walk_poses.completed.bvh")]
    assert mk.read(tmp_path / "walk_poses.completed.bvh").num_frames == 2 * mk.read(source).num_frames - 1


def test_a_run_that_is_not_there_is_named_with_the_command_that_trains_it(motionkit, tmp_path):
    outcome = motionkit("generate", "a person walks", "--run", "bad", "--runs", tmp_path)
    assert outcome.code == 2 and "there is no run" in outcome.stderr and "--run bad trains NeRM" in outcome.stderr
