"""`motionkit generate --resume`, `--overwrite`: stopped, killed, damaged and full folders, and links in them."""

import json
import os
import resource

import pytest

from eval.sample_folder import read_sample_folder
from motionkit.core.checksums import write_json
from motionkit.core.errors import BusyError, DamagedFileError, MotionkitError, UsageError
from motionkit.core.progress import MotionkitWarning
from tests.helpers.drift_model import DriftModel, GoesOn, contents, names, rows_of
from tests.helpers.killing import killed_before


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


@pytest.mark.parametrize("option", ["--resume", "--overwrite"])
def test_two_calls_do_not_write_one_folder_at_once(option, run_command, tmp_path):
    call = ("a walk", "a jump", "--seconds", "1", "--fps", "5", "--out", "made", option)
    refused = []

    class CallsAgain(DriftModel):
        def generate(self, requests, **options):
            with pytest.raises(BusyError, match=rf"process {os.getpid()} on") as caught:
                run_command(*call)
            refused.append(caught.value)
            return super().generate(requests, **options)

    run_command(*call, model=CallsAgain())
    assert refused
    assert len(rows_of(tmp_path / "made" / "motions.csv")) == 2
    assert names(tmp_path / "made") == ["0000-a-walk.npz", "0001-a-jump.npz", "generation.json", "motions.csv"]


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
    assert any("0001-a-jump.npz is missing" in str(each.message) for each in recwarn)
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
    with pytest.raises(UsageError, match="--resume continues them, --overwrite replaces them"):
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


def of_an_older_version(folder):
    """Take out of generation.json what older versions did not write."""
    manifest = json.loads((folder / "generation.json").read_text())
    newer = ("planted", "joins", "constraints", "checksum")
    write_json(folder / "generation.json", {name: value for name, value in manifest.items() if name not in newer})


def test_a_folder_from_before_planting_is_gone_on_with_unplanted(run_command, tmp_path):
    call = ("a walk", "a jump", "--seconds", "1", "--fps", "5", "--out", "made")
    run_command(*call, "--no-plant")
    of_an_older_version(tmp_path / "made")
    whole = contents(tmp_path / "made")
    (tmp_path / "made" / "0001-a-jump.npz").unlink()
    with pytest.raises(UsageError, match="which planted nothing: --no-plant goes on with it"):
        run_command(*call, "--resume")
    with pytest.warns(MotionkitWarning, match="is missing"):
        run_command(*call, "--resume", "--no-plant")
    assert contents(tmp_path / "made") == whole


def test_a_folder_whose_motions_were_joined_otherwise_says_what_to_do(run_command, tmp_path):
    call = ("a walk", "--seconds", "15", "--fps", "5", "--no-plant", "--out", "made")
    run_command(*call)
    of_an_older_version(tmp_path / "made")
    assert run_command(*call, "--resume").stdout == ""  # this model's are cross-faded, as they were
    with pytest.raises(UsageError, match="joined motions otherwise: --overwrite makes all again"):
        run_command(*call, "--resume", model=GoesOn())
