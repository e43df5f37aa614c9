"""One motion completed in Python, in all that stands for frames and seconds; and the encoders that are found."""

import os
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.edit.complete import CompletionRequest, completed_motion, kept_frames, parse_extend, parse_keep
from motionkit.edit.encoders import choose_encoder, runs_with
from motionkit.edit.motions import LoadedMotion
from motionkit.fields.interpolation import INTERPOLATORS
from motionkit.fields.motion_field import to_motion
from motionkit.training.run import Loader, RunFolder
from tests.helpers.analytic import analytic_motion
from tests.helpers.plugin_lists import install_only


@pytest.fixture(scope="module")
def motion() -> mk.Motion:
    """Two seconds of a walk at 30 fps, with rotations."""
    return to_motion(analytic_motion("walk", 2.0), Fraction(30)).frames(0, 60)


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder without runs, so that the default is an interpolator."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("fps", [120, "120"])
def test_more_frames_between_those_that_are_given(motion: mk.Motion, fps: int | str) -> None:
    made = mk.complete(motion, fps=fps)
    assert made.fps == 120 and made.num_frames == 237
    np.testing.assert_array_equal(made.joint_positions[::4], motion.joint_positions)
    assert made.local_rotations is not None and made.skeleton == motion.skeleton


def test_frames_to_keep_in_any_form(motion: mk.Motion) -> None:
    mask = np.ones(60, bool)
    mask[10:40] = False
    forms = (mask, [(0, 10), (40, None)], [(0, 10), (40, 60)], "0:10,40:", ((0, 10), (40, 60)))
    made = [mk.complete(motion, keep=keep, model="slerp").joint_positions for keep in forms]
    for each in made:
        np.testing.assert_array_equal(each, made[0])
    np.testing.assert_array_equal(made[0][mask], motion.joint_positions[mask])
    assert np.abs(made[0] - motion.joint_positions)[~mask].max() > 0.01


def test_seconds_beyond_the_ends_in_any_form(motion: mk.Motion) -> None:
    for extend, before, after in ((0.5, 0, 15), ((0.1, 0.5), 3, 15), ("0.1,0.5", 3, 15), (1, 0, 30)):
        made = mk.complete(motion, extend=extend, model="slerp")
        assert made.num_frames == before + 60 + after
        assert made.timegrid.start_seconds == pytest.approx(-before / 30)
        np.testing.assert_array_equal(made.joint_positions[before : before + 60], motion.joint_positions)


def test_a_file_is_the_motion_that_it_holds(motion: mk.Motion) -> None:
    motion.save("walk.bvh")
    of_file, of_motion = mk.complete("walk.bvh", fps=90), mk.complete(mk.read("walk.bvh"), fps=90)
    np.testing.assert_allclose(of_file.joint_positions, of_motion.joint_positions, atol=1e-5)
    assert of_file.sequence_id == of_motion.sequence_id == f"{Path.cwd().name}/walk"
    for name in ("one", "two"):
        motion.save(f"takes/{name}.npz")
    for path in ("nowhere.bvh", "takes"):
        with pytest.raises(mk.UsageError, match=path):
            mk.complete(path, fps=90)


def test_uneven_times_have_their_own_gaps(motion: mk.Motion) -> None:
    seconds = np.arange(60) / 30 + 0.2 * (np.arange(60) > 9)
    loaded, slerp = LoadedMotion(motion, np.ones(60, bool), seconds), choose_encoder("slerp", None, Path("runs"))
    made = completed_motion(loaded, CompletionRequest(fps=Fraction(60)), slerp)
    assert made.details["longest_gap_seconds"] == pytest.approx(0.2 + 1 / 30)
    with pytest.raises(mk.MotionkitError):
        completed_motion(loaded, CompletionRequest(after_seconds=1.0), slerp)


def test_ranges_of_frames_and_reaches() -> None:
    assert parse_keep("40:, :10 ,25") == ((40, None), (0, 10), (25, 26))
    assert np.flatnonzero(kept_frames(parse_keep(":2,4,6:"), 8)).tolist() == [0, 1, 4, 6, 7]
    assert kept_frames(None, 3).all()
    assert parse_extend("0.5,1") == (0.5, 1.0) and parse_extend("2") == (0.0, 2.0)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({}, "fps"),
        ({"fps": 20}, r"motion\.resample\(20\)"),
        ({"keep": np.ones(59, bool)}, "59"),
        ({"keep": []}, "frame"),
        *(({"keep": text}, text[:20]) for text in ("a:b", "-3:5", "9" * 5000, "10:10", "5:70")),
        *(({"extend": text}, text) for text in ("a", "0,", "1,2,3", "100", "nan")),
        ({"fps": 60, "model": "pahires"}, "'pahires'"),
    ],
)
def test_what_cannot_be_had_is_reported(motion: mk.Motion, given: dict, says: str) -> None:
    with pytest.raises(mk.MotionkitError, match=says):
        mk.complete(motion, **given)


def test_going_on_at_constant_velocity_for_long_is_reported(motion: mk.Motion) -> None:
    with pytest.warns(UserWarning, match="2 s"):
        mk.complete(motion, extend=2, model="linear")


def test_clips_are_completed_by_the_preferred_encoder_that_is_trained(tmp_path, monkeypatch):
    own = Loader("Own", ("halves",), lambda run: INTERPOLATORS["linear"], preferred=True)
    install_only(monkeypatch, ENCODERS={"own": own})
    before = choose_encoder(None, None, tmp_path)
    assert not before.is_trained and "halves" in before.explanation
    folder = RunFolder(tmp_path / "run").stage("halves")
    folder.path.mkdir(parents=True)
    folder.finish({"loss": 1.0})
    chosen = choose_encoder(None, None, tmp_path)
    assert chosen.is_trained and chosen.encoder is INTERPOLATORS["linear"]
    assert choose_encoder(None, "run", tmp_path).name == "own"


def test_runs_are_those_whose_stage_is_complete(tmp_path: Path) -> None:
    assert runs_with("pahires", tmp_path / "nowhere") == ()
    for name in ("half", "older", "newer"):
        RunFolder(tmp_path / name).stage("pahires").path.mkdir(parents=True)
    for name in ("newer", "older"):
        RunFolder(tmp_path / name).stage("pahires").finish({})
    for seconds, name in ((1_000, "older"), (2_000, "newer")):
        os.utime(RunFolder(tmp_path / name).stage("pahires").summary_path, (seconds, seconds))
    assert [run.name for run in runs_with("pahires", tmp_path)] == ["older", "newer"]
    assert runs_with("liif", tmp_path) == ()
