"""`motionkit generate`: what it refuses, what it writes, what it says."""

import json
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from motionkit.errors import FormatError, UsageError
from motionkit.formats.arrays.npz import read_npz
from motionkit.formats.bvh.motion import read_bvh
from motionkit.generation import GenerationRequest
from motionkit.motion import Caption
from motionkit.motionfield import Poses, check_times
from motionkit.skeleton import SMPL22
from nerm.commands.generate import generate
from nerm.generated_files import file_name


@dataclass(frozen=True, eq=False)
class Drift:
    """The standing skeleton, drifting along z at 1 m/s from `offset`."""

    offset: float
    end_seconds: float
    skeleton = SMPL22
    start_seconds = 0.0

    def query(self, times_seconds):
        check_times(self, times_seconds)
        rest = np.zeros((22, 3), dtype=np.float32)
        for joint, parent in enumerate(SMPL22.parents[1:], start=1):
            rest[joint] = rest[parent] + SMPL22.offsets[joint]
        positions = np.repeat(rest[None], len(times_seconds), axis=0)
        positions[..., 2] += (self.offset + times_seconds[:, None]).astype(np.float32)
        return Poses(positions)


class DriftModel:
    name, skeleton, max_training_fps, max_duration_seconds = "Drift", SMPL22, Fraction(120), 10.0

    def generate(self, requests, *, seed, sampling=None):
        return [
            Drift(seed + index / 10, 3.0 if request.duration_seconds is None else request.duration_seconds)
            for index, request in enumerate(requests)
        ]


@pytest.fixture
def run_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("motionkit.generation.load_model", lambda name, run: DriftModel())
    app = typer.Typer()
    app.command()(generate)

    def run(*arguments):
        return CliRunner().invoke(app, list(arguments), catch_exceptions=False)

    return run


def test_texts_become_a_batch_of_files(run_command, tmp_path):
    arguments = ("a person walks", "A jump!", "--fps", "144", "--seconds", "6", "-n", "2", "--out", "made", "--json")
    result = run_command(*arguments)
    report = json.loads(result.stdout)
    assert [motion["num_frames"] for motion in report["motions"]] == [864] * 4
    names = sorted(path.name for path in (tmp_path / "made").iterdir())
    assert names == ["0000-a-person-walks.npz", "0001-a-person-walks.npz", "0002-a-jump.npz", "0003-a-jump.npz"]
    with np.load(tmp_path / "made" / names[2], allow_pickle=False) as arrays:
        assert arrays["joint_positions"].shape == (864, 22, 3)
        assert arrays["joint_positions"].dtype == np.float32
        np.testing.assert_allclose(arrays["time_seconds"], np.arange(864) / 144)
        assert (float(arrays["fps"]), str(arrays["captions"][0])) == (144.0, "A jump!")
        assert tuple(arrays["joint_names"]) == SMPL22.joint_names
    motion = read_npz(tmp_path / "made" / names[2])
    assert (motion.fps, motion.captions) == (Fraction(144), (Caption("A jump!"),))


def test_a_fractional_framerate_stays_exact(run_command, tmp_path):
    run_command("a walk", "--fps", "24000/1001", "--seconds", "2", "--out", "made")
    with np.load(tmp_path / "made" / "0000-a-walk.npz", allow_pickle=False) as arrays:
        assert (int(arrays["fps_numerator"]), int(arrays["fps_denominator"])) == (24000, 1001)
        assert len(arrays["time_seconds"]) == 48
        np.testing.assert_allclose(np.diff(arrays["time_seconds"]), 1001 / 24000)


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


def test_framerates_above_the_training_data_warn(run_command):
    result = run_command("a walk", "--fps", "240", "--seconds", "1")
    assert "240 fps is above the 120 fps" in result.stderr
    assert "above" not in run_command("a walk", "--fps", "120", "--seconds", "1").stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "exactly one of the three"),
        (("a walk", "--unconditional"), "exactly one of the three"),
        ((" ",), "empty"),
        (("a walk", "--fps", "fast"), "--fps fast"),
        (("a walk", "--fps", "24000/0"), "--fps 24000/0"),
        (("a walk", "--times", "0.5"), "needs --seconds"),
        (("a walk", "--times", "x", "--seconds", "1"), "separated by commas"),
        (("a walk", "--times", "0.5,1.5", "--seconds", "1"), "1.5 s lies outside"),
        (("a walk", "--times", "0.5", "--seconds", "1", "--fps", "30"), "exclude each other"),
        (("a walk", "--format", "fbx"), "npz or bvh"),
        (("a walk", "--times", "0.5", "--seconds", "1", "--format", "bvh"), "one framerate"),
    ],
)
def test_what_makes_no_sense_is_refused(run_command, arguments, message):
    with pytest.raises(UsageError, match=message):
        run_command(*arguments)


def test_file_names_are_safe_and_short():
    assert file_name(3, GenerationRequest(1.0, text="../../etc: 走る Walk")) == "0003-etc-walk"
    assert file_name(3, GenerationRequest(1.0, text="走る")) == "0003-motion"
    assert len(file_name(0, GenerationRequest(1.0, text="a person " * 30))) <= 45
