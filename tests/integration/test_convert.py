"""`motionkit convert`: one file into another, by format, framerate, rig and up axis."""

import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.core import kinematics
from motionkit.io.amass import write_amass
from motionkit.io.smpl_body import mean_shape_skeleton
from tests.helpers.analytic import capture
from tests.helpers.outcome import Outcome

Run = Callable[..., Outcome]
SECONDS = 2.0


@pytest.fixture(scope="module")
def walk() -> mk.Motion:
    """Two seconds of a walk at 30 fps, with rotations."""
    return replace(capture(Fraction(30), "walk", seconds=SECONDS), sequence_id="walk")


@pytest.fixture(autouse=True)
def files(tmp_path: Path, walk: mk.Motion, monkeypatch: pytest.MonkeyPatch) -> None:
    """The walk in several formats, a lying one (z up) without rotations, and a character of other lengths."""
    monkeypatch.chdir(tmp_path)
    for suffix in ("bvh", "npz", "csv"):
        walk.save(f"walk.{suffix}")
    write_amass(walk, Path("amass.npz"))
    z_up = walk.joint_positions[..., [0, 2, 1]] * np.array([1, -1, 1], np.float32)
    mk.Motion.from_joints(z_up, 30).save("z-up.npz")
    body = mean_shape_skeleton().scaled(0.9)
    turns, root = np.tile(np.float32([1, 0, 0, 0]), (2, 22, 1)), np.tile(np.float32([0, 0.8, 0]), (2, 1))
    positions = kinematics.forward_kinematics(turns, root, body)
    character = mk.Motion(positions, body, mk.TimeGrid(Fraction(30), 2), turns, root)
    for suffix in ("bvh", "glb"):
        character.save(f"hero.{suffix}")


def heights(motion: mk.Motion) -> np.ndarray:
    return np.ptp(motion.joint_positions[..., 1], axis=1)


@pytest.mark.parametrize("source", ["walk.bvh", "walk.csv", "amass.npz"])
@pytest.mark.parametrize("out", ["out.npz", "out.bvh", "out.csv", "out.npy"])
@pytest.mark.parametrize("fps", [None, "30000/1001"])
def test_any_format_to_any_other_at_any_framerate(motionkit, walk, source, out, fps):
    outcome = motionkit("convert", source, out, *(["--fps", fps] if fps else []))
    assert (outcome.code, outcome.stdout.strip()) == (0, out), outcome.stderr
    made, before = mk.read(out), mk.read(source)
    expected = before if fps is None else before.resample(fps)
    assert made.timegrid == expected.timegrid
    order = [made.skeleton.index(name) for name in ("pelvis", "head", "left_foot")]
    same = [expected.skeleton.index(made.skeleton.joint_names[joint]) for joint in order]
    np.testing.assert_allclose(made.joint_positions[:, order], expected.joint_positions[:, same], atol=3e-4)


def test_a_bvh_file_that_stays_one_keeps_its_lines_or_its_channels(motionkit: Run) -> None:
    before = Path("walk.bvh").read_bytes()
    assert motionkit("convert", "walk.bvh", "same.bvh").code == 0
    assert Path("same.bvh").read_bytes() == before
    assert motionkit("convert", "walk.bvh", "fast.bvh", "--fps", "120").code == 0
    assert Path("fast.bvh").read_bytes().partition(b"MOTION")[0] == before.partition(b"MOTION")[0]


@pytest.mark.parametrize("rig", ["hero.bvh", "hero.glb"])
@pytest.mark.parametrize("out", ["out.bvh", "out.glb", "out.npz"])
def test_onto_a_rig(motionkit: Run, walk: mk.Motion, rig: str, out: str) -> None:
    outcome = motionkit("convert", "walk.bvh", out, "--onto", rig, "--fps", "60", "--json")
    assert outcome.code == 0, outcome.stderr
    (written,) = json.loads(outcome.stdout)["clips"]
    assert written["file"] == out and written["converted_fps"] == "60" and written["num_joints"] == 22
    made = mk.convert("walk.bvh", fps=60, rig=rig)
    knee, ankle = (made.joint_positions[:, made.skeleton.index(name)] for name in ("left_knee", "left_ankle"))
    shin = np.linalg.norm(ankle - knee, axis=-1)
    np.testing.assert_allclose(shin, np.linalg.norm(0.9 * mean_shape_skeleton().offsets[7]), atol=1e-4)
    if out != "out.glb":
        read = mk.read(out)
        assert read.fps == 60
        np.testing.assert_allclose(heights(read), heights(made), atol=1e-3)
    if out == rig.replace("hero", "out"):  # the character's own file
        assert b"left_hip" in Path(out).read_bytes()


def test_a_folder_and_a_stored_sequence(motionkit: Run, walk: mk.Motion) -> None:
    for name in ("a", "deep/b"):
        walk.save(f"takes/{name}.bvh")
    Path("takes/c.bvh").write_text("HIERARCHY\n")
    outcome = motionkit("convert", "takes", "made", "--format", "npz")
    assert outcome.code == 1 and "c.bvh" in outcome.stderr
    assert outcome.stdout.split() == ["made/a.npz", "made/deep/b.npz"]
    with mk.StoreWriter.create(Path("store")) as writer:
        writer.add(walk)
    assert motionkit("convert", "walk", "stored.bvh").code == 0
    assert mk.read("stored.bvh").num_frames == walk.num_frames


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("walk.bvh",), 2, "OUT"),
        (("none.bvh", "out.npz"), 2, "no file or folder none.bvh"),
        (("walk.bvh", "out.fbx"), 2, "'.fbx'"),
        (("walk.bvh", "out.npz", "--format", "bvh"), 2, "two formats"),
        (("walk.bvh", "out.npz", "--fps", "fast"), 2, "--fps fast"),
        (("walk.bvh", "walk.npz"), 1, "walk.npz exists: --overwrite"),
        (("walk.bvh", "out.npz", "--onto", "walk.npz"), 2, "a character is a .bvh or a .glb file"),
        (("lost.npz", "out.bvh"), 1, "2 of its"),
        (("uneven.npz", "out.bvh"), 1, "uneven in time"),
    ],
)
def test_what_cannot_be_converted_is_explained(motionkit, walk, arguments, code, message):
    lost = walk.joint_positions.copy()
    lost[3:5] = np.nan
    np.savez("lost.npz", joint_positions=lost, fps=30)
    kept = np.delete(np.arange(walk.num_frames), [7, 8, 31])
    np.savez("uneven.npz", joint_positions=walk.joint_positions[kept], time_seconds=kept / 30)
    outcome = motionkit("convert", *arguments)
    assert outcome.code == code and message in outcome.stderr and not Path("out.npz").exists()
