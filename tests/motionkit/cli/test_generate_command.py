"""`motionkit generate`: what it refuses, what it writes, what it says."""

import csv
import json
import resource
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from eval.sample_folder import read_sample_folder
from motionkit.cli.app import build_app
from motionkit.cli.generate import generate
from motionkit.core.errors import DamagedFileError, FormatError, MotionkitError, UsageError
from motionkit.core.motion import Caption
from motionkit.core.skeleton import SMPL22
from motionkit.features.humanml3d import positions
from motionkit.fields.motion_field import Poses, check_times
from motionkit.formats.arrays.npz import read_npz
from motionkit.formats.bvh.document import read_bvh
from motionkit.generate import models
from motionkit.generate.models import GenerationRequest
from motionkit.generate.samples import motion_name
from motionkit.store import Store
from tests.helpers.killing import killed_before


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

    def __init__(self, fails_at=None):
        self.fails_at = fails_at

    def check(self, request, sampling=None):
        if request.action == "fly":
            raise UsageError("the model knows no action 'fly'")

    def generate(self, requests, *, seed, sampling=None, first=0):
        if self.fails_at is not None and first >= self.fails_at:
            raise KeyboardInterrupt
        return [
            Drift(seed % 89 + index / 10, 3.0 if request.duration_seconds is None else request.duration_seconds)
            for index, request in enumerate(requests, start=first)
        ]


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def rows_of(table):
    return list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))


@pytest.fixture
def run_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    app = typer.Typer()
    app.command()(generate)

    def run(*arguments, model=None):
        monkeypatch.setattr(models, "load_model", lambda name, run: model or DriftModel())
        return CliRunner().invoke(app, list(arguments), catch_exceptions=False)

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
        (("a walk", "--join"), "needs to know how long each part lasts"),
        (("a walk", "--seconds", "30", "--overlap", "6"), "overlap by more than 0 s and up to 5 s, not by 6 s"),
        (("a walk", "--seconds", "4000"), "a motion lasts up to 3600 s"),
        (("a walk", "a jump", "--seconds", "0.5", "--join"), "part 1 of 2 of a joined motion lasts 0.5 s"),
        (("a walk", "a jump", "--seconds", "4", "--join", "--times", "8.5"), "outside the motion's 0 … 8 s"),
        (("a walk", "--format", "fbx"), "one of bvh, joints-npy, npz, csv, gltf, humanml3d"),
        (("a walk", "--times", "0.5", "--seconds", "1", "--format", "bvh"), "one framerate"),
    ],
)
def test_what_makes_no_sense_is_refused(run_command, tmp_path, arguments, message):
    with pytest.raises(UsageError, match=message):
        run_command(*arguments)
    assert not (tmp_path / "generated").exists()


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
    table = tmp_path / "parts" / "motions.csv"
    table.write_text("".join(table.read_text().splitlines(keepends=True)[:4]))  # stopped after three motions
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


def test_gltf_is_an_animation(run_command, tmp_path):
    run_command("--unconditional", "--seconds", "1", "--format", "gltf", "--fps", "30", "--out", "made")
    header = (tmp_path / "made" / "0000-unconditional.glb").read_bytes()[:4]
    assert header == b"glTF"


def test_a_file_of_prompts(run_command, tmp_path):
    (tmp_path / "wanted.csv").write_text('text,action,seconds\n"walks, then stops",,2\n,jump,\n')
    report = json.loads(run_command("--prompts", "wanted.csv", "-n", "2", "--fps", "20", "--json").stdout)
    assert [(m["caption"], m["action"], m["num_frames"]) for m in report["motions"]] == [
        *[("walks, then stops", "", 40)] * 2,
        *[("", "jump", 60)] * 2,
    ]
    (tmp_path / "bad.jsonl").write_text('{"text": "a walk"}\n\n{"action": "fly"}\n')
    with pytest.raises(UsageError, match=r"bad\.jsonl, line 3: the model knows no action 'fly'"):
        run_command("--prompts", "bad.jsonl", "--out", "other")
    assert not (tmp_path / "other").exists()


def test_a_stopped_call_goes_on_where_it_was(run_command, tmp_path):
    call = ("--unconditional", "-n", "70", "--seconds", "1", "--fps", "5")
    run_command(*call, "--out", "whole")
    stopped = run_command(*call, "--out", "parts", "--resume", model=DriftModel(fails_at=64))
    assert stopped.exit_code != 0
    table = tmp_path / "parts" / "motions.csv"
    assert len(rows_of(table)) == 64
    table.write_bytes(table.read_bytes()[:-7])  # a line cut short counts as not done
    report = json.loads(run_command(*call, "--out", "parts", "--resume", "--json").stdout)
    assert (report["already_there"], len(report["motions"])) == (63, 7)
    for name in ("motions.csv", "0063-unconditional.npz", "0069-unconditional.npz"):
        assert (tmp_path / "parts" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert json.loads(run_command(*call, "--out", "parts", "--resume", "--json").stdout)["motions"] == []
    with pytest.raises(UsageError, match=r"begun with another seed \(0, now 1\)"):
        run_command(*call, "--out", "parts", "--resume", "--seed", "1")


@pytest.mark.parametrize("name", [".generation.json.tmp.json", ".generation.json.4711.tmp"])
@pytest.mark.parametrize("option", ["--resume", "--overwrite", "--seed=0"])
def test_a_call_that_was_killed_while_it_began_is_begun_again(name, option, run_command, tmp_path):
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / name).write_text("{")
    run_command("a walk", "--seconds", "1", "--out", "made", option)
    assert names(tmp_path / "made") == ["0000-a-walk.npz", "generation.json", "motions.csv"]


@pytest.mark.parametrize("file_format", ["npz", "humanml3d"])
def test_killed_before_any_file_operation_a_call_goes_on_to_the_same_files(file_format, run_command, tmp_path):
    call = ("a walk", "a jump", "--seconds", "1", "--fps", "5", "--format", file_format, "--resume", "--out")
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


@pytest.mark.parametrize("file_format", ["npz", "humanml3d"])
def test_killed_before_any_file_operation_an_overwrite_leaves_nothing_of_the_former_call(
    file_format, run_command, tmp_path
):
    call = ("a hop", "--seconds", "1", "--fps", "5", "--format", "bvh", "--overwrite", "--out")
    run_command(*call, "whole")
    expected = contents(tmp_path / "whole")
    killed = 0
    for step in range(200):
        out = tmp_path / str(step)
        # The former call was killed before it noted its last motion.
        run_command("a walk", "a jump", "--seconds", "1", "--fps", "5", "--format", file_format, "--out", str(out))
        table = out / "motions.csv"
        table.write_text("".join(table.read_text().splitlines(keepends=True)[:2]))
        if not killed_before(step, out, lambda out=out: run_command(*call, str(out))):
            break
        killed += 1
        run_command(*call, str(out))
        assert contents(out) == expected, step
    assert killed > 10


def test_a_motion_that_is_not_what_was_written_is_not_gone_on_with(run_command, tmp_path, recwarn):
    call = ("a walk", "a jump", "a hop", "--seconds", "1", "--fps", "5", "--out", "made", "--resume")
    run_command(*call)
    jump = tmp_path / "made" / "0001-a-jump.npz"
    whole = jump.read_bytes()
    jump.write_bytes(whole[:700] + bytes([whole[700] ^ 1]) + whole[701:])
    with pytest.raises(DamagedFileError, match=r"0001-a-jump\.npz is damaged .*delete it, and --resume makes it again"):
        run_command(*call)
    jump.unlink()
    run_command(*call)
    assert any("0001-a-jump.npz is gone" in str(each.message) for each in recwarn)
    assert jump.read_bytes() == whole
    table = tmp_path / "made" / "motions.csv"
    table.write_text(table.read_text().replace("a hop", "a top"))
    with pytest.raises(DamagedFileError, match=r"motions\.csv is damaged \(row 3 "):
        run_command(*call)


def test_every_flipped_byte_of_the_table_and_the_manifest_is_noticed_or_changes_nothing(run_command, tmp_path):
    folder = tmp_path / "made"
    run_command("a walk", "--seconds", "1", "--fps", "5", "--out", "made", "--format", "bvh")
    for name in ("motions.csv", "generation.json", "0000-a-walk.bvh"):
        whole = (folder / name).read_bytes()
        expected, unnoticed = read_sample_folder("made", folder), 0
        for place in range(0, len(whole), max(1, len(whole) // 400)):
            (folder / name).write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
            try:
                found = read_sample_folder("made", folder)
            except MotionkitError:
                continue
            assert (found.captions, found.fps, found.num_motions) == (expected.captions, expected.fps, 1), place
            unnoticed += 1
        # White space, and the end of the last line.
        assert unnoticed < 0.3 * len(whole)
        (folder / name).write_bytes(whole)


def test_samples_name_a_damaged_motion_and_read_the_others(run_command, tmp_path):
    run_command("a walk", "a jump", "--seconds", "2", "--fps", "20", "--format", "humanml3d", "--out", "made")
    vectors = tmp_path / "made" / "new_joint_vecs" / "0001-a-jump.npy"
    whole = vectors.read_bytes()
    vectors.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    found = read_sample_folder("made", tmp_path / "made")
    assert found.captions == ("a walk",)
    [left_out] = found.left_out
    assert (left_out.path, left_out.reason) == (vectors, "damaged")


def test_folders_of_before_there_were_checksums_are_gone_on_with(run_command, tmp_path):
    call = ("a walk", "a jump", "--seconds", "1", "--fps", "5", "--out", "made", "--resume")
    run_command(*call)
    folder = tmp_path / "made"
    manifest = json.loads((folder / "generation.json").read_text())
    del manifest["checksum"], manifest["table_checksums"]
    (folder / "generation.json").write_text(json.dumps(manifest))
    rows = ["file,captions,action,fps,seconds,num_frames", '0000-a-walk.npz,"[""a walk""]",,5,1.0,5', ""]
    (folder / "motions.csv").write_text("\n".join(rows))
    report = json.loads(run_command(*call, "--json").stdout)
    assert (report["already_there"], len(report["motions"])) == (1, 1)
    assert list(rows_of(folder / "motions.csv")[1]) == rows[0].split(",")
    assert not read_sample_folder("made", folder).left_out


def test_links_in_a_generated_folder_are_not_followed(run_command, tmp_path):
    call = ("a walk", "--seconds", "1", "--fps", "5", "--format", "humanml3d", "--out", "made")
    run_command(*call)
    foreign, folder = tmp_path / "foreign", tmp_path / "made"
    (folder / "texts").rename(foreign)
    (folder / "texts").symlink_to(foreign)
    for option in ("--resume", "--overwrite"):
        with pytest.raises(UsageError, match="texts is a link"):
            run_command(*call, option)
    assert names(foreign) == ["0000-a-walk.txt"]
    (folder / "texts").unlink()
    (folder / "motions.csv").unlink()
    (folder / "motions.csv").symlink_to(foreign / "0000-a-walk.txt")
    (folder / "new_joints" / "0000-a-walk.npy").unlink()
    (folder / "new_joints" / "0000-a-walk.npy").symlink_to(foreign / "0000-a-walk.txt")
    before = (foreign / "0000-a-walk.txt").read_text()
    for option in ("--resume", "--overwrite"):
        with pytest.raises(UsageError, match="is a link"):
            run_command(*call, option)
    assert (foreign / "0000-a-walk.txt").read_text() == before


def test_a_full_disk_names_the_file(run_command, tmp_path):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    for file_format, name in (("npz", "0000-a-walk.npz"), ("bvh", "0000-a-walk.bvh"), ("humanml3d", ".npy")):
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, before[1]))
        try:
            with pytest.raises(OSError, match=name):
                run_command("a walk", "--seconds", "4", "--format", file_format, "--out", file_format)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_nothing_is_overwritten_unasked(run_command, tmp_path):
    run_command("a walk", "--seconds", "1", "--out", "made")
    with pytest.raises(UsageError, match="--resume goes on with them, --overwrite replaces them"):
        run_command("a walk", "--seconds", "1", "--out", "made")
    (tmp_path / "made" / "mine.txt").write_text("mine")
    run_command("a jump", "--seconds", "1", "--out", "made", "--overwrite", "--format", "humanml3d")
    run_command("a hop", "--seconds", "1", "--out", "made", "--overwrite")
    left = sorted(path.relative_to(tmp_path / "made").as_posix() for path in (tmp_path / "made").rglob("*.*"))
    assert left == ["0000-a-hop.npz", "generation.json", "mine.txt", "motions.csv"]
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine.txt").write_text("mine")
    for option in ("--resume", "--overwrite"):
        with pytest.raises(UsageError, match="other is not empty"):
            run_command("a walk", "--seconds", "1", "--out", "other", option)


@pytest.mark.parametrize("option", ["--resume", "--overwrite"])
def test_nothing_outside_the_folder_is_written_or_deleted(run_command, tmp_path, option):
    run_command("a walk", "--seconds", "1", "--out", "made", "--format", "humanml3d")
    outside = tmp_path / "outside"
    (tmp_path / "made" / "new_joints").rename(outside)
    (tmp_path / "made" / "new_joints").symlink_to(outside)
    before = {path.name: path.read_bytes() for path in outside.iterdir()}
    assert before
    with pytest.raises(UsageError, match="new_joints is a link: nothing is written or deleted through it"):
        run_command("a walk", "--seconds", "1", "--out", "made", "--format", "humanml3d", option)
    (tmp_path / "made" / "new_joints").unlink()
    (tmp_path / "made" / "motions.csv").rename(outside / "table")
    (tmp_path / "made" / "motions.csv").symlink_to(outside / "table")
    (outside / "table").write_text("file\nnever cut")
    with pytest.raises(UsageError, match=r"motions\.csv is a link"):
        run_command("a walk", "--seconds", "1", "--out", "made", "--format", "humanml3d", option)
    assert (outside / "table").read_text() == "file\nnever cut"
    assert before == {path.name: path.read_bytes() for path in outside.iterdir() if path.name != "table"}


@pytest.mark.parametrize("rows", [b"caption\nx\n", b"file\na\0b\n", b"file\n\xff\n", b'file\n""\n'])
def test_a_table_that_is_none(run_command, tmp_path, rows):
    run_command("a walk", "--seconds", "1", "--out", "made")
    (tmp_path / "made" / "motions.csv").write_bytes(rows)
    with pytest.raises(DamagedFileError, match=r"motions\.csv is damaged"):
        run_command("a walk", "--seconds", "1", "--out", "made", "--resume")
    run_command("a jump", "--seconds", "1", "--out", "made", "--overwrite")
    assert names(tmp_path / "made") == ["0000-a-jump.npz", "generation.json", "motions.csv"]


def test_what_was_generated_is_ingested_with_its_captions(run_command, tmp_path):
    run_command("a walk", "--seconds", "1", "--fps", "50", "--format", "bvh", "--out", "made")
    result = CliRunner().invoke(build_app(), ["ingest", str(tmp_path / "made"), "--store", "store", "--json"])
    assert result.exit_code == 0
    assert not json.loads(result.stdout)["problems"]
    [motion] = Store.open(tmp_path / "store").read_many([0])
    assert (motion.fps, motion.captions) == (Fraction(50), (Caption("a walk"),))
