"""`motionkit generate`: what it refuses, what it writes, what it says."""

import json
from fractions import Fraction

import numpy as np
import pytest
from typer.testing import CliRunner

from motionkit.cli.app import build_app
from motionkit.core.errors import FormatError, UsageError
from motionkit.core.motion import Caption
from motionkit.core.skeleton import SMPL22
from motionkit.features.humanml3d import positions
from motionkit.generate.models import GenerationRequest
from motionkit.generate.output import motion_name
from motionkit.io.bvh import read_bvh
from motionkit.io.npz import read_npz
from motionkit.store import Store
from tests.helpers.drift_model import GoesOn, rows_of


def test_texts_become_a_batch_of_files(run_command, tmp_path):
    arguments = ("a person walks", "A jump!", "--fps", "144", "--seconds", "6", "-n", "2", "--out", "made", "--json")
    result = run_command(*arguments)
    report = json.loads(result.stdout)
    assert [motion["num_frames"] for motion in report["motions"]] == [864] * 4
    names = sorted(path.name for path in (tmp_path / "made").iterdir())
    motions = ["0000-a-person-walks.npz", "0001-a-person-walks.npz", "0002-a-jump.npz", "0003-a-jump.npz"]
    assert names == [*motions, "generation.json", "motions.csv"]
    manifest = json.loads((tmp_path / "made" / "generation.json").read_text())
    assert (manifest["seed"], manifest["fps"], manifest["count"]) == (0, "144", 2)
    assert [each["text"] for each in manifest["conditions"]] == ["a person walks", "A jump!"]
    with np.load(tmp_path / "made" / names[2], allow_pickle=False) as arrays:
        assert arrays["joint_positions"].shape == (864, 22, 3)
        assert arrays["joint_positions"].dtype == np.float32
        np.testing.assert_allclose(arrays["time_seconds"], np.arange(864) / 144)
        assert (float(arrays["fps"]), str(arrays["captions"][0])) == (144.0, "A jump!")
        assert tuple(arrays["joint_names"]) == SMPL22.joint_names
    motion = read_npz(tmp_path / "made" / names[2])
    assert (motion.fps, motion.captions) == (Fraction(144), (Caption("A jump!"),))


def test_arbitrary_instants(run_command, tmp_path):
    result = run_command("--unconditional", "--times", "0.5,1.25,0", "--seconds", "2", "--out", "made", "--seed", "4")
    assert result.stdout.strip() == "made/0000-unconditional.npz"
    with np.load(tmp_path / "made" / "0000-unconditional.npz", allow_pickle=False) as arrays:
        np.testing.assert_allclose(arrays["time_seconds"], [0.5, 1.25, 0.0])
        np.testing.assert_allclose(arrays["joint_positions"][:, 0, 2], [4.5, 5.25, 4.0])
        assert "fps" not in arrays
    with pytest.raises(FormatError, match="do not ascend"):
        read_npz(tmp_path / "made" / "0000-unconditional.npz")


def test_bvh_reads_back(run_command, tmp_path):
    run_command("--action", "walk", "--fps", "90", "--seconds", "1", "--format", "bvh", "--out", "made")
    motion = read_bvh(tmp_path / "made" / "0000-walk.bvh")
    assert (motion.fps, motion.num_frames) == (Fraction(90), 90)
    travelled = motion.joint_positions[-1, 0] - motion.joint_positions[0, 0]
    np.testing.assert_allclose(travelled, [0.0, 0.0, 89 / 90], atol=1e-3)


def test_defaults_are_the_models(run_command):
    [motion] = json.loads(run_command("a walk", "--json").stdout)["motions"]
    assert (motion["fps"], motion["num_frames"], motion["duration_seconds"]) == ("120", 360, 3.0)


def test_framerates_above_the_training_data_warn(run_command, recwarn):
    run_command("a walk", "--fps", "120", "--seconds", "1")
    assert not recwarn.list
    run_command("a walk", "--fps", "240", "--seconds", "1", "--out", "fast")
    (warning,) = recwarn
    assert "240 fps is above the 120 fps" in str(warning.message)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "exactly one of them"),
        (("a walk", "--unconditional"), "exactly one of them"),
        (("a walk", "--prompts", "p.txt"), "takes the place of texts"),
        (("--prompts", "absent.txt"), "absent.txt: No such file"),
        (("a walk", "--resume", "--overwrite"), "exclude each other"),
        (("--action", "fly"), "no action 'fly'"),
        ((" ",), "empty"),
        (("a walk", "--fps", "fast"), "--fps fast"),
        (("a walk", "--fps", "24000/0"), "--fps 24000/0"),
        (("a walk", "--times", "0.5"), "needs --seconds"),
        (("a walk", "--times", "x", "--seconds", "1"), "separated by commas"),
        (("a walk", "--times", "0.5,1.5", "--seconds", "1"), "1.5 s lies outside"),
        (("a walk", "--times", "0.5", "--seconds", "1", "--fps", "30"), "exclude each other"),
        (("a walk", "--join"), "needs to know how long each text lasts"),
        (("a walk", "--seconds", "30", "--overlap", "6"), "overlap by more than 0 s and up to 5 s, not by 6 s"),
        (("a walk", "--seconds", "4000"), "a motion lasts up to 3600 s"),
        (("a walk", "a jump", "--seconds", "0.5", "--join"), "part 1 of 2 of a joined motion lasts 0.5 s"),
        (("a walk", "a jump", "--seconds", "4", "--join", "--times", "8.5"), "outside the motion's 0 … 8 s"),
        (("a walk", "--format", "fbx"), "one of bvh, amass, joints-npy, npz, csv, robot-csv, gltf, humanml3d"),
        (("a walk", "--times", "0.5", "--seconds", "1", "--format", "bvh"), "one framerate"),
    ],
)
def test_what_makes_no_sense_is_refused(run_command, tmp_path, arguments, message):
    with pytest.raises(UsageError, match=message):
        run_command(*arguments)
    assert not (tmp_path / "generated").exists()


POINTS = "seconds,x,z\n0,0,5\n2,0,7\n"


def test_a_path_is_followed_and_its_error_reported(run_command, tmp_path):
    (tmp_path / "points.csv").write_text(POINTS)
    result = run_command("a walk", "--path", "points.csv", "--json", model=GoesOn())
    [motion] = json.loads(result.stdout)["motions"]
    assert motion["duration_seconds"] == 2.0
    [met] = motion["constraints"]
    assert (met["kind"], met["name"]) == ("path", "points.csv") and met["max_metres"] < 0.02
    manifest = json.loads((tmp_path / "generated" / "generation.json").read_text())
    assert [each["name"] for each in manifest["constraints"]] == ["points.csv"]
    (tmp_path / "points.csv").write_text(POINTS.replace("7", "8"))
    with pytest.raises(UsageError, match="begun with another constraints"):
        run_command("a walk", "--path", "points.csv", "--resume", model=GoesOn())


def test_a_path_of_a_long_motion_is_given_to_each_piece_by_its_clock(run_command, tmp_path):
    (tmp_path / "points.csv").write_text("x,z\n0,5\n0,30\n")
    model = GoesOn()
    result = run_command("a walk", "--path", "points.csv", "--seconds", "25", "--json", model=model)
    assert "1 of 1 motions are joined from several of up to 10 s" in result.stderr
    assert [number for number, _ in model.asked] == [0, 1, 2]
    assert [[each.kind for each in request.constraints] for _, request in model.asked] == [["path"]] + [
        ["path", "pose"]
    ] * 2
    assert all(each.seconds.min() < 0.13 for _, request in model.asked for each in request.constraints)
    [met] = json.loads(result.stdout)["motions"][0]["constraints"]
    assert met["max_metres"] < 0.02


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("--path", "points.csv"),
            r"points\.csv: the model 'Drift' follows no constraints: it cannot follow a path",
        ),
        (("--path", "points.csv", "--seconds", "1"), r"points\.csv: 2 s lies outside the motion's 0 … 1 s"),
        (("--path", "bad.csv"), r"bad\.csv, line 2: x is a number, not 'a'"),
        (("--joint", "elbow@1=0,0,0", "--seconds", "2"), "no joint is called 'elbow'"),
        (("--joint", "head@3=0,0,0", "--seconds", "2"), "'Drift' follows no constraints"),
        (("--pose", "1=many.npz", "--seconds", "2"), r"many\.npz holds 3 frames: say which by its second"),
    ],
)
def test_what_a_motion_cannot_be_held_to_is_refused(run_command, tmp_path, arguments, message):
    (tmp_path / "points.csv").write_text(POINTS)
    (tmp_path / "bad.csv").write_text("x,z\na,1\n")
    poses = np.zeros((3, 22, 3), np.float32)
    np.savez(tmp_path / "many.npz", joint_positions=poses, fps=10.0)
    with pytest.raises(UsageError, match=message):
        run_command("a walk", *arguments)
    assert not (tmp_path / "generated").exists()


def test_kinds_that_a_model_does_not_follow_and_instants_outside(run_command, tmp_path):
    with pytest.raises(UsageError, match="follows path and pose alone: it cannot follow a joint"):
        run_command("a walk", "--joint", "head@1=0,0,0", "--seconds", "2", model=GoesOn())
    np.savez(tmp_path / "pose.npz", joint_positions=np.zeros((1, 22, 3), np.float32), fps=10.0)
    with pytest.raises(UsageError, match=r"pose\.npz at 3 s: 3 s lies outside the motion's 0 … 2 s"):
        run_command("a walk", "--pose", "3=pose.npz", "--seconds", "2", model=GoesOn())
    with pytest.raises(UsageError, match="--seconds is needed"):
        run_command("a walk", "--pose", "3=pose.npz", model=GoesOn())


def test_a_motion_beyond_the_longest_is_joined_from_several(run_command, tmp_path):
    result = run_command("a walk", "--seconds", "25", "--fps", "30", "--out", "slow")
    assert "1 of 1 motions are joined from several of up to 10 s" in result.stderr
    run_command("a walk", "--seconds", "25", "--fps", "60", "--out", "fast")
    slow, fast = (read_npz(tmp_path / name / "0000-a-walk.npz") for name in ("slow", "fast"))
    assert (slow.num_frames, fast.num_frames) == (750, 1500)
    # Each piece begins anywhere; laid over the last one, 1 m/s goes on.
    np.testing.assert_allclose(np.diff(slow.joint_positions[:, 0, 2]), 1 / 30, atol=1e-4)
    np.testing.assert_allclose(fast.joint_positions[::2], slow.joint_positions, atol=1e-5)
    some = run_command("a walk", "--seconds", "25", "--times", "24.5,3", "--out", "some")
    assert some.exit_code == 0
    with np.load(tmp_path / "some" / "0000-a-walk.npz", allow_pickle=False) as arrays:
        np.testing.assert_allclose(arrays["joint_positions"], slow.joint_positions[[735, 90]], atol=1e-5)


def test_texts_in_a_row_are_one_motion(run_command, tmp_path):
    call = ("a walk", "a jump", "--seconds", "4", "--join", "--fps", "20", "-n", "2", "--format", "bvh")
    report = json.loads(run_command(*call, "--out", "made", "--json").stdout)
    assert [(m["file"], m["num_frames"]) for m in report["motions"]] == [
        ("made/0000-a-walk-a-jump.bvh", 160),
        ("made/0001-a-walk-a-jump.bvh", 160),
    ]
    told = [
        {"text": "a walk", "start_seconds": 0.0, "end_seconds": 4.0},
        {"text": "a jump", "start_seconds": 4.0, "end_seconds": 8.0},
    ]
    assert report["motions"][0]["captions"] == told
    manifest = json.loads((tmp_path / "made" / "generation.json").read_text())
    assert (manifest["joined"], manifest["overlap_seconds"]) == (True, 0.5)
    result = CliRunner().invoke(build_app(), ["ingest", str(tmp_path / "made"), "--store", "store"])
    assert result.exit_code == 0
    motions = list(Store.open(tmp_path / "store").read_many([0, 1]))
    assert motions[0].captions == (Caption("a walk", 0.0, 4.0), Caption("a jump", 4.0, 8.0))
    with pytest.raises(UsageError, match="begun with another joined"):
        run_command(*[part for part in call if part != "--join"], "--out", "made", "--resume")


def test_long_and_short_motions_of_one_call_are_numbered_alike(run_command, tmp_path):
    rows = ["text,seconds", *(f"walk {n},{12 if n % 3 == 1 else 2}" for n in range(7))]
    (tmp_path / "wanted.csv").write_text("\n".join(rows) + "\n")
    call = ("--prompts", "wanted.csv", "--fps", "5")
    run_command(*call, "--out", "whole")
    places = [read_npz(path).joint_positions[0, 0, 2] for path in sorted((tmp_path / "whole").glob("*.npz"))]
    assert [round(10 * float(place)) for place in places[::3]] == [0, 3, 6]
    run_command(*call, "--out", "parts")
    for number in range(3, 7):
        (tmp_path / "parts" / f"000{number}-walk-{number}.npz").unlink()
    run_command(*call, "--out", "parts", "--resume")
    for path in sorted((tmp_path / "whole").iterdir()):
        assert (tmp_path / "parts" / path.name).read_bytes() == path.read_bytes()


def test_file_names_are_safe_and_short():
    assert motion_name(3, (GenerationRequest(1.0, text="../../etc: 走る Walk"),)) == "0003-etc-walk"
    assert motion_name(3, (GenerationRequest(1.0, text="走る"),)) == "0003-motion"
    assert len(motion_name(0, (GenerationRequest(1.0, text="a person " * 30),))) <= 45


def test_pose_vectors_at_the_published_framerate_and_at_others(run_command, tmp_path):
    run_command("a walk", "--seconds", "3", "--format", "humanml3d", "--out", "published")
    run_command("a walk", "--seconds", "3", "--format", "humanml3d", "--fps", "60", "--out", "fast")
    for name, fps, rows in (("published", "20", 59), ("fast", "60", 179)):
        folder = tmp_path / name
        vectors = np.load(folder / "new_joint_vecs" / "0000-a-walk.npy", allow_pickle=False)
        assert vectors.shape == (rows, 263)
        # 1 m/s along Z+, per frame.
        np.testing.assert_allclose(vectors[:, 2], 1 / int(fps), atol=1e-3)
        np.testing.assert_allclose(positions(vectors, "smpl22"), np.load(folder / "new_joints" / "0000-a-walk.npy"))
        manifest = json.loads((folder / "motions.json").read_text())
        assert (manifest["fps"], manifest["published_fps"], manifest["vectors"]) == (fps, "20", "humanml3d")
        assert (folder / "texts" / "0000-a-walk.txt").read_text().startswith("a walk#")
        [row] = rows_of(folder / "motions.csv")
        assert (row["file"], row["fps"]) == ("new_joint_vecs/0000-a-walk.npy", fps)


def test_a_file_of_prompts(run_command, tmp_path):
    (tmp_path / "wanted.csv").write_text('text,action,seconds\n"walks, then stops",,2\n,jump,\n')
    report = json.loads(run_command("--prompts", "wanted.csv", "-n", "2", "--fps", "20", "--json").stdout)
    assert [(m["caption"], m["action"], m["num_frames"]) for m in report["motions"]] == [
        *[("walks, then stops", "", 40)] * 2,
        *[("", "jump", 60)] * 2,
    ]
    (tmp_path / "bad.csv").write_text("text,action\na walk,\n,fly\n")
    with pytest.raises(UsageError, match=r"bad\.csv, line 3: the model knows no action 'fly'"):
        run_command("--prompts", "bad.csv", "--out", "other")
    assert not (tmp_path / "other").exists()


def test_what_was_generated_is_ingested_with_its_captions(run_command, tmp_path):
    run_command("a walk", "--seconds", "1", "--fps", "50", "--format", "bvh", "--out", "made")
    result = CliRunner().invoke(build_app(), ["ingest", str(tmp_path / "made"), "--store", "store", "--json"])
    assert result.exit_code == 0
    assert not json.loads(result.stdout)["problems"]
    [motion] = Store.open(tmp_path / "store").read_many([0])
    assert (motion.fps, motion.captions) == (Fraction(50), (Caption("a walk"),))
