"""`motionkit generate --resume`, `--overwrite`: stopped, killed and full folders."""

import json

import pytest

from motionkit.core.errors import BusyError, MotionkitError, UsageError
from tests.helpers.drift_model import DriftModel, contents, names, rows_of
from tests.helpers.killing import killed_before


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
    with pytest.raises(UsageError, match=r"begun with another seed \(0, now 1\)"):
        run_command(*call, "--out", "parts", "--resume", "--seed", "1")


@pytest.mark.parametrize("option", ["--resume", "--overwrite"])
def test_two_calls_do_not_write_one_folder_at_once(option, run_command, tmp_path):
    call = ("a walk", "a jump", "--seconds", "1", "--fps", "5", "--out", "made", option)
    refused = []

    class CallsAgain(DriftModel):
        def generate(self, requests, **options):
            with pytest.raises(BusyError, match="another process is generating into made") as caught:
                run_command(*call)
            refused.append(caught.value)
            return super().generate(requests, **options)

    run_command(*call, model=CallsAgain())
    assert refused
    assert len(rows_of(tmp_path / "made" / "motions.csv")) == 2
    assert names(tmp_path / "made") == ["0000-a-walk.npz", "0001-a-jump.npz", "generation.json", "motions.csv"]


@pytest.mark.parametrize("option", ["--resume", "--overwrite", "--seed=0"])
def test_a_call_that_was_killed_while_it_began_is_begun_again(option, run_command, tmp_path):
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / ".generation.json.0123abcd.tmp.json").write_text("{")
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


def test_a_damaged_request_is_refused(run_command, tmp_path):
    call = ("a walk", "--seconds", "1", "--fps", "5", "--out", "made")
    run_command(*call)
    manifest = tmp_path / "made" / "generation.json"
    whole = manifest.read_text()
    for text in (whole[:-40], whole.replace('"0000-a-walk.npz"', '"../foreign.npz"'), '{"format": "another"}'):
        manifest.write_text(text)
        (tmp_path / "foreign.npz").write_text("mine")
        with pytest.raises(MotionkitError, match=r"generation\.json"):
            run_command(*call, "--overwrite")
        assert (tmp_path / "foreign.npz").read_text() == "mine"


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
