"""`motionkit generate`: what it refuses, what it writes, what it says."""

import json
from fractions import Fraction

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import motionkit as mk
from motionkit.cli.app import build_app
from motionkit.cli.generate import generate
from motionkit.generate import models
from motionkit.generate.models import GenerationRequest
from motionkit.generate.output import motion_name
from motionkit.io.npz import read_npz
from tests.helpers.drift_model import DriftModel, GoesOn, contents, rows_of
from tests.helpers.killing import killed_before


@pytest.fixture
def run_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    app = typer.Typer()
    app.command()(generate)

    def run(*arguments, model=None):
        monkeypatch.setattr(models, "model_of", lambda run: "drift")
        monkeypatch.setattr(models, "load_model", lambda name, run: model or DriftModel())
        return CliRunner().invoke(app, ["--run", "drift", *arguments], catch_exceptions=False)

    return run


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
        assert tuple(arrays["joint_names"]) == mk.SMPL22.joint_names
    motion = read_npz(tmp_path / "made" / names[2])
    assert (motion.fps, motion.captions) == (Fraction(144), (mk.Caption("A jump!"),))


def test_arbitrary_instants(run_command, tmp_path):
    result = run_command("--unconditional", "--times", "0.5,1.25,0", "--seconds", "2", "--out", "made", "--seed", "4")
    assert result.stdout.strip() == "made/0000-unconditional.npz"
    with np.load(tmp_path / "made" / "0000-unconditional.npz", allow_pickle=False) as arrays:
        np.testing.assert_allclose(arrays["time_seconds"], [0.5, 1.25, 0.0])
        np.testing.assert_allclose(arrays["joint_positions"][:, 0, 2], [4.5, 5.25, 4.0])
        assert "fps" not in arrays
    with pytest.raises(mk.FormatError, match="0000-unconditional"):
        read_npz(tmp_path / "made" / "0000-unconditional.npz")


def test_framerates_above_the_training_data_warn(run_command, recwarn):
    run_command("a walk", "--fps", "120", "--seconds", "1")
    assert not recwarn.list
    run_command("a walk", "--fps", "240", "--seconds", "1", "--out", "fast")
    (warning,) = recwarn
    assert "240 fps" in str(warning.message)


POINTS = "seconds,x,z\n0,0,5\n2,0,7\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("a walk", "--unconditional"), "--unconditional"),
        (("--prompts", "absent.txt"), "absent.txt"),
        (("a walk", "--resume", "--overwrite"), "--resume"),
        (("--action", "fly"), "'fly'"),
        (("a walk", "--times", "0.5"), "--seconds"),
        (("a walk", "--times", "0.5,1.5", "--seconds", "1"), "1.5 s"),
        (("a walk", "--times", "0.5", "--seconds", "1", "--fps", "30"), "--fps"),
        (("a walk", "--join"), "lasts"),
        (("a walk", "a jump", "--seconds", "0.5", "--join"), "0.5 s"),
        (("a walk", "--times", "0.5", "--seconds", "1", "--format", "bvh"), "bvh"),
        (("a walk", "--path", "points.csv"), r"points\.csv"),
    ],
)
def test_what_makes_no_sense_is_refused(run_command, tmp_path, arguments, message):
    (tmp_path / "points.csv").write_text(POINTS)
    with pytest.raises(mk.UsageError, match=message):
        run_command(*arguments)
    assert not (tmp_path / "generated").exists()


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
    with pytest.raises(mk.UsageError, match="constraints"):
        run_command("a walk", "--path", "points.csv", "--resume", model=GoesOn())
    with pytest.raises(mk.UsageError, match=r"points\.csv"):
        run_command("a walk", "--path", "points.csv", "--seconds", "1", "--out", "other", model=GoesOn())


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
    motions = list(mk.Store.open(tmp_path / "store").read_many([0, 1]))
    assert motions[0].captions == (mk.Caption("a walk", 0.0, 4.0), mk.Caption("a jump", 4.0, 8.0))
    with pytest.raises(mk.UsageError, match="joined"):
        run_command(*[part for part in call if part != "--join"], "--out", "made", "--resume")


def test_file_names_are_safe_and_short():
    assert motion_name(3, (GenerationRequest(1.0, text="../../etc: 走る Walk"),)) == "0003-etc-walk"
    assert motion_name(3, (GenerationRequest(1.0, text="走る"),)) == "0003-motion"
    assert len(motion_name(0, (GenerationRequest(1.0, text="a person " * 30),))) <= 45


def test_a_file_of_prompts(run_command, tmp_path):
    (tmp_path / "wanted.csv").write_text('text,action,seconds\n"walks, then stops",,2\n,jump,\n')
    report = json.loads(run_command("--prompts", "wanted.csv", "-n", "2", "--fps", "20", "--json").stdout)
    assert [(m["caption"], m["action"], m["num_frames"]) for m in report["motions"]] == [
        *[("walks, then stops", "", 40)] * 2,
        *[("", "jump", 60)] * 2,
    ]
    (tmp_path / "bad.csv").write_text("text,action\na walk,\n,fly\n")
    with pytest.raises(mk.UsageError, match=r"bad\.csv, line 3"):
        run_command("--prompts", "bad.csv", "--out", "other")
    assert not (tmp_path / "other").exists()


def test_a_stopped_call_goes_on_where_it_was(run_command, tmp_path):
    call = ("--unconditional", "-n", "70", "--seconds", "1", "--fps", "5")
    run_command(*call, "--out", "whole")
    stopped = run_command(*call, "--out", "parts", "--resume", model=DriftModel(fails_at=64))
    assert stopped.exit_code != 0
    assert len(rows_of(tmp_path / "parts" / "motions.csv")) == 64
    report = json.loads(run_command(*call, "--out", "parts", "--resume", "--json").stdout)
    assert (report["already_there"], len(report["motions"])) == (64, 6)
    for name in ("motions.csv", "0063-unconditional.npz", "0069-unconditional.npz"):
        assert (tmp_path / "parts" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert json.loads(run_command(*call, "--out", "parts", "--resume", "--json").stdout)["motions"] == []
    with pytest.raises(mk.UsageError, match="seed"):
        run_command(*call, "--out", "parts", "--resume", "--seed", "1")


def test_killed_before_any_file_operation_a_call_goes_on_to_the_same_files(run_command, tmp_path):
    call = ("a walk", "a jump", "--seconds", "1", "--fps", "5", "--resume", "--out")
    run_command(*call, "whole")
    expected = contents(tmp_path / "whole")
    killed = 0
    for step in range(200):
        out = tmp_path / str(step)
        if not killed_before(step, out, lambda out=out: run_command(*call, str(out))):
            break
        killed += 1
        run_command(*call, str(out))
        assert contents(out) == expected, step
    assert killed > 15


def test_a_damaged_request_is_refused(run_command, tmp_path):
    call = ("a walk", "--seconds", "1", "--fps", "5", "--out", "made")
    run_command(*call)
    manifest = tmp_path / "made" / "generation.json"
    whole = manifest.read_text()
    for text in (whole[:-40], whole.replace('"0000-a-walk.npz"', '"../foreign.npz"'), '{"format": "another"}'):
        manifest.write_text(text)
        (tmp_path / "foreign.npz").write_text("mine")
        with pytest.raises(mk.MotionkitError, match=r"generation\.json"):
            run_command(*call, "--overwrite")
        assert (tmp_path / "foreign.npz").read_text() == "mine"


def test_nothing_is_overwritten_unasked(run_command, tmp_path):
    run_command("a walk", "--seconds", "1", "--out", "made")
    with pytest.raises(mk.UsageError, match="--resume"):
        run_command("a walk", "--seconds", "1", "--out", "made")
    (tmp_path / "made" / "mine.txt").write_text("mine")
    run_command("a jump", "--seconds", "1", "--out", "made", "--overwrite", "--format", "bvh")
    run_command("a hop", "--seconds", "1", "--out", "made", "--overwrite")
    left = sorted(path.relative_to(tmp_path / "made").as_posix() for path in (tmp_path / "made").rglob("*.*"))
    assert left == ["0000-a-hop.npz", "generation.json", "mine.txt", "motions.csv"]
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine.txt").write_text("mine")
    for option in ("--resume", "--overwrite"):
        with pytest.raises(mk.UsageError, match="other"):
            run_command("a walk", "--seconds", "1", "--out", "other", option)
