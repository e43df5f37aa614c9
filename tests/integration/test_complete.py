"""`motionkit complete`, file to file: every kind of clip, what is made of it, and what is said when nothing can be."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.motion import Caption, Motion
from motionkit.fields.motion_field import to_motion
from motionkit.io.bvh import read_bvh, read_document, write_bvh
from motionkit.io.joints_npy import read_joints_npy
from motionkit.io.npz import read_npz, write_npz
from motionkit.store import StoreWriter
from tests.helpers.analytic import analytic_motion
from tests.helpers.format_samples import NUM_BVH_CHANNELS, bvh_text
from tests.helpers.outcome import Outcome

Run = Callable[..., Outcome]


@pytest.fixture(scope="module")
def motion() -> Motion:
    """Two seconds of a walk at 30 fps, with rotations."""
    performance = analytic_motion("walk", 2.0)
    walked = to_motion(performance, Fraction(30)).frames(0, 60)
    return replace(walked, sequence_id="walk", captions=(Caption("a person walks"),))


@pytest.fixture
def walk(tmp_path: Path, motion: Motion) -> Path:
    write_bvh(motion, tmp_path / "walk.bvh")
    return tmp_path / "walk.bvh"


def test_bvh_at_four_times_the_framerate(motionkit: Run, walk: Path) -> None:
    outcome = motionkit("complete", walk, "--fps", "120", "--runs", walk.parent / "none")
    assert outcome.code == 0
    made = walk.with_name("walk.completed.bvh")
    assert outcome.stdout.split() == [str(made)]
    assert "rotation-cubic" in outcome.stderr and "train --stage pahires" in outcome.stderr
    before, after = read_document(walk), read_document(made)
    assert after.lines[::4] == before.lines and after.motion.fps == 120
    assert len(after.lines) == 4 * (len(before.lines) - 1) + 1
    again = motionkit("complete", walk, "--fps", "120")
    assert again.code == 1 and "--overwrite" in again.stderr and again.stdout == ""
    assert motionkit("complete", walk, "--fps", "90", "--overwrite").code == 0
    assert read_bvh(made).fps == 90


def test_gaps_and_ends_with_json(motionkit: Run, walk: Path, motion: Motion) -> None:
    last = motion.num_frames
    out = walk.parent / "new" / "made.bvh"
    outcome = motionkit(
        *("complete", walk, "--keep", f"0:10,40:{last}", "--extend", "0.2,0.2", "--fps", "60000/1001", "--json"),
        *("--out", out, "--model", "squad"),
    )
    assert outcome.code == 0
    report = json.loads(outcome.stdout)
    (clip,) = report["clips"]
    assert report["encoder"] == clip["encoder"] == "squad" and report["failed"] == []
    assert clip["completed_fps"] == "60000/1001" and clip["longest_gap_seconds"] == pytest.approx(31 / 30)
    made = read_bvh(out)
    assert made.num_frames == clip["num_completed_frames"] == clip["num_given_frames"] + clip["num_made_frames"]
    assert made.num_frames == int(0.2 * 59.94) + int(59.94 * ((last - 1) / 30 + 0.2)) + 1


def test_ids_of_a_store(motionkit: Run, tmp_path: Path, motion: Motion, monkeypatch: pytest.MonkeyPatch) -> None:
    with StoreWriter.create(tmp_path / "store") as writer:
        writer.add(replace(motion, sequence_id="set/walk"))
    monkeypatch.chdir(tmp_path)
    assert motionkit("complete", "set/walk", "--extend", "0.1").code == 0
    assert read_npz(tmp_path / "set_walk.completed.npz").num_frames == motion.num_frames + 3
    assert motionkit("complete", "set/walk", "--extend", "0.1", "--format", "bvh", "--out", "here").code == 0
    assert read_bvh(tmp_path / "here" / "set_walk.bvh").num_frames == motion.num_frames + 3
    outcome = motionkit("complete", "set/run", "--fps", "60")
    assert outcome.code == 2 and "no file or folder set/run" in outcome.stderr


def test_a_bad_file_costs_nothing_of_the_others(motionkit: Run, tmp_path: Path, motion: Motion) -> None:
    folder = tmp_path / "takes"
    (folder / "deep").mkdir(parents=True)
    write_bvh(motion, folder / "a.bvh")
    write_bvh(motion.frames(0, 1), folder / "b.bvh")
    (folder / "c.bvh").write_text((folder / "a.bvh").read_text(encoding="utf-8")[:-400], encoding="utf-8")
    write_npz(motion, folder / "deep" / "d.npz")
    outcome = motionkit("complete", folder, "--fps", "60", "--out", tmp_path / "out", "--json")
    assert outcome.code == 1
    report = json.loads(outcome.stdout)
    assert [Path(clip["file"]).relative_to(tmp_path / "out").as_posix() for clip in report["clips"]] == [
        "a.bvh",
        "deep/d.npz",
    ]
    assert [Path(each["clip"]).name for each in report["failed"]] == ["b.bvh", "c.bvh"]
    assert "a single frame" in outcome.stderr and "the file ends" in outcome.stderr
    assert sorted(path.name for path in (tmp_path / "out").rglob("*.*")) == ["a.bvh", "d.npz"]
    # A second call on the folder does not take what the first one made for clips.
    assert motionkit("complete", folder / "a.bvh", "--fps", "60").code == 0
    report = json.loads(motionkit("complete", folder, "--fps", "90", "--overwrite", "--json").stdout)
    assert len(report["clips"]) == 2


LEARNT = """
from motionkit.core.skeleton import SMPL22
from motionkit.fields.interpolation import INTERPOLATORS

class Learnt:
    name, longest_gap_seconds, reach_seconds = "Learnt", 0.2, 0.1
    def encode(self, observation, **reach):
        assert observation.skeleton.joint_names == SMPL22.joint_names
        return INTERPOLATORS["hold"].encode(observation, **reach)

def load(run):
    (run / "learnt" / "summary.json").read_text()
    return Learnt()

ENCODERS = {"learnt": load}
"""


def test_trained_encoders_complete_own_skeletons(motionkit, tmp_path, install):
    """By the encoder of an installed package, which is for 22 joints and holds poses."""
    install("learnt", LEARNT)
    (tmp_path / "runs" / "nano" / "learnt").mkdir(parents=True)
    (tmp_path / "runs" / "nano" / "learnt" / "summary.json").write_text("{}", encoding="utf-8")
    walk = tmp_path / "own.bvh"
    walk.write_text(bvh_text([[10.0 * row, 95.0, *[5.0 * row] * (NUM_BVH_CHANNELS - 2)] for row in range(20)]), "utf-8")
    places = ("--runs", tmp_path / "runs", "--overwrite", "--json")
    options = (*places, "--keep", "0:8,16:", "--extend", "0.2", "--model", "learnt")
    outcome = motionkit("complete", walk, *options)
    assert outcome.code == 0 and "Learnt, trained in" in outcome.stderr
    (clip,) = json.loads(outcome.stdout)["clips"]
    assert clip["encoder"] == "learnt"
    gap, reach = clip["warnings"]
    assert "0.30 s is longer than the 0.20 s" in gap and "0.2 s beyond" in reach
    before, after = read_document(walk), read_document(Path(clip["file"]))
    assert after.lines[:8] == before.lines[:8] and after.lines[16:20] == before.lines[16:]
    dog = tmp_path / "dog.bvh"
    dog.write_text(re.sub(r"\b(Left|Right|Hips|Spine|Neck|Head)", r"dog\1", walk.read_text("utf-8")), "utf-8")
    (clip,) = json.loads(motionkit("complete", dog, *options).stdout)["clips"]
    assert clip["encoder"] == "rotation-cubic" and "learnt does not support its skeleton" in clip["warnings"][0]
    outcome = motionkit("complete", walk, "--fps", "60", "--model", "learnt", "--runs", tmp_path)
    assert outcome.code == 2 and "train --stage learnt" in outcome.stderr


def test_what_was_completed_is_no_capture(motionkit: Run, takes: Path, tmp_path: Path) -> None:
    assert motionkit("complete", takes / "alpha.bvh", "--fps", "60", "--model", "slerp").code == 0
    outcome = motionkit("ingest", takes, "--store", tmp_path / "store")
    assert "stored 3 sequences" in outcome.stdout
    assert "alpha.completed.bvh" in next(line for line in outcome.stdout.splitlines() if line.startswith("ignored: 1"))


def test_arrays_need_a_framerate_by_the_option_of_the_command(motionkit: Run, tmp_path: Path, motion: Motion) -> None:
    path = tmp_path / "joints.npy"
    np.save(path, motion.joint_positions)
    for command, option in (("complete --fps 120", "--source-fps"), ("plant", "--source-fps"), ("view", "--fps")):
        name, *options = command.split()
        outcome = motionkit(name, path, *options)
        assert outcome.code == 1 and f"use {option}" in outcome.stderr
    outcome = motionkit("complete", path, "--fps", "120", "--source-fps", "30")
    result = read_joints_npy(Path(outcome.stdout.strip()))
    assert result.fps == 120  # by the motions.json of a folder of its own
    np.testing.assert_array_equal(result.joint_positions[::4], motion.joint_positions)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ([], 2, "nothing to complete"),
        (["--fps", "1e9"], 2, "10000"),
        (["--keep", "0:900"], 1, "60 frames, 0:60"),
        (["--fps", "60", "--model", "sprline"], 2, "'sprline'"),
        (["--fps", "60", "--model", "nerm", "--runs", "none"], 2, "give the run"),
    ],
)
def test_requests_that_make_no_sense(motionkit: Run, walk: Path, arguments: list[str], code: int, message: str) -> None:
    outcome = motionkit("complete", walk, *arguments)
    assert outcome.code == code and outcome.stdout == ""
    assert message in outcome.stderr.splitlines()[-1]
    assert sorted(path.name for path in walk.parent.iterdir()) == ["walk.bvh"]
