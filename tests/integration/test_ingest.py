"""`motionkit ingest` on good and bad files: one clear line for each fault, and a store of exactly the good ones."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

from motionkit.core import files
from motionkit.core.motion import Motion
from motionkit.store import Store, StoreWriter
from motionkit.store import ingest as module
from tests.helpers.small_bvh import bvh_text


def ids(store: Path) -> list[str]:
    return list(Store.open(store).sequences["sequence_id"])


def files_of(store: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(store)): path.read_bytes()
        for path in sorted(store.rglob("*"))
        if path.is_file() and not path.name.startswith(".")
    }


def test_the_first_ingest_makes_a_store_and_the_next_adds_to_it(motionkit, takes, tmp_path):
    store = tmp_path / "store"
    first = motionkit("ingest", takes, "--store", store, "--workers", 1)
    assert first.code == 0
    assert first.error_lines == []
    assert first.stdout.startswith("stored 3 sequences (0.00 h, 15 frames) in ")
    assert ids(store) == ["takes/alpha", "takes/beta", "takes/gamma"]
    assert Store.open(store).read("takes/beta").fps == 30
    (takes / "delta.bvh").write_text(bvh_text(7))
    second = motionkit("ingest", takes, "--store", store, "--workers", 1)
    assert (second.code, second.error_lines) == (0, [])
    assert second.stdout.startswith("stored 1 sequences (0.00 h, 7 frames) in ")
    assert "already there: 3" in second.stdout
    assert ids(store)[3:] == ["takes/delta"]
    assert motionkit("validate", "--store", store).code == 0


def test_two_goes_store_what_one_does(motionkit, takes, tmp_path):
    whole = shutil.copytree(takes, tmp_path / "all" / "takes")
    (takes / "alpha.bvh").unlink()
    motionkit("ingest", takes, "--store", tmp_path / "two")
    motionkit("ingest", whole, "--store", tmp_path / "two")
    motionkit("ingest", whole, "--store", tmp_path / "one")
    one, two = (Store.open(tmp_path / name) for name in ("one", "two"))
    places = ["sequence_index", "part", "part_row"]
    rows = [
        store.sequences.reset_index(drop=True).drop(columns=places, errors="ignore").set_index("sequence_id")
        for store in (one, two)
    ]
    assert rows[0].astype(str).equals(rows[1].loc[rows[0].index].astype(str))
    for name in rows[0].index:
        assert np.array_equal(one.read(name).joint_positions, two.read(name).joint_positions)


def test_nothing_new_leaves_the_store_untouched(motionkit, takes, tmp_path):
    motionkit("ingest", takes, "--store", tmp_path / "store", "--workers", 1)
    before = files_of(tmp_path / "store")
    again = motionkit("ingest", takes, "--store", tmp_path / "store", "--workers", 1)
    assert again.code == 0
    assert files_of(tmp_path / "store") == before


def test_an_ingest_of_one_worker_loads_little(takes, tmp_path):
    script = (
        "import sys; from motionkit.store.ingest import ingest; from pathlib import Path; "
        f"assert ingest([Path({str(takes)!r})], Path({str(tmp_path / 'store')!r}), num_workers=1).num_stored == 3; "
        "print(*sorted({'scipy', 'duckdb', 'torch', 'multiprocessing', 'motionkit.io.amass'} & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (result.stderr, result.stdout) == ("", "\n")


def test_an_overwrite(motionkit, takes, tmp_path):
    store = tmp_path / "store"
    motionkit("ingest", takes, "--store", store, "--workers", 1)
    motionkit("ingest", takes / "beta.bvh", "--store", store, "--overwrite", "--fps", "24000/1001", "--workers", 1)
    assert ids(store) == ["takes/beta"]
    row = Store.open(store).sequences.iloc[0]
    assert (row["fps_numerator"], row["fps_denominator"], row["stated_fps"]) == (
        24000,
        1001,
        "Frame Time: 0.0333333",
    )


def test_units_and_captions(motionkit, takes, tmp_path):
    table = takes / "notes.csv"
    table.write_text("file,caption,split,action\nalpha.bvh,a person slides,test,slide\n")
    outcome = motionkit(
        "ingest", takes / "alpha.bvh", "--store", tmp_path / "store", "--captions", table, "--unit-metres", 0.02
    )
    assert outcome.code == 0
    motion = Store.open(tmp_path / "store").read(0)
    assert [caption.text for caption in motion.captions] == ["a person slides"]
    assert (motion.split, motion.action) == ("test", "slide")
    assert motion.joint_positions[0, 0, 1] == pytest.approx(1.8)


BAD_FILES = {
    "truncated": (
        bvh_text(8)[:-400],
        "truncated",
        r"line \d+, frame 5: the file ends after .* expected 8 whole frames",
    ),
    "channels": (bvh_text(num_channels=20), "channel-count", r"line \d+, frame 0: 20 numbers, expected 21"),
    "nan": (bvh_text().replace("\n4.0000 90.0000", "\n4.0000 nan"), "nan", r"line \d+, frame 2: "),
    "zero-time": (bvh_text(frame_time="0"), "frame-time", r"line \d+: 'Frame Time: 0' "),
    "no-time": (bvh_text().replace("Frame Time: 0.0333333\n", ""), "frame-time", r"line \d+: .*'Frame Time: seconds'"),
    "photo": ("\x89PNG\r\n\x1a\n", "not-what-it-says", "expected a BVH file"),
    "nothing": ("", "empty", "empty"),
}


@pytest.mark.parametrize(("name", "workers"), [*((name, 1) for name in BAD_FILES), ("nan", 2)])
def test_a_bad_file_is_reported_in_one_line_and_skipped(motionkit, takes, tmp_path, name, workers):
    text, reason, says = BAD_FILES[name]
    (takes / f"bad-{name}.bvh").write_text(text, encoding="latin-1")
    outcome = motionkit("ingest", takes, "--store", tmp_path / "store", "--workers", workers)
    assert outcome.code == 0
    (line,) = outcome.error_lines
    assert line.startswith(f"{takes}/bad-{name}.bvh")
    assert re.search(says, line)
    assert f"failed: 1 (1 {reason})" in outcome.stdout
    assert ids(tmp_path / "store") == ["takes/alpha", "takes/beta", "takes/gamma"]
    assert motionkit("validate", "--store", tmp_path / "store").code == 0


@pytest.mark.parametrize("name", BAD_FILES)
def test_under_stop_the_store_stays_as_it_was(motionkit, takes, tmp_path, name):
    store = tmp_path / "store"
    motionkit("ingest", takes / "alpha.bvh", "--store", store)
    before = files_of(store)
    (takes / f"bad-{name}.bvh").write_text(BAD_FILES[name][0], encoding="latin-1")
    outcome = motionkit("ingest", takes, "--store", store, "--on-error", "stop", "--workers", 1)
    assert outcome.code == 1
    assert len(outcome.error_lines) == 2
    assert outcome.error_lines[0].startswith(f"{takes}/bad-{name}.bvh")
    assert outcome.error_lines[1].startswith("motionkit: stopped at the first problem")
    assert files_of(store) == before


def test_all_of_it_at_once_counted_by_reason(motionkit, takes, tmp_path):
    for name, (text, _, _) in BAD_FILES.items():
        (takes / f"bad-{name}.bvh").write_text(text, encoding="latin-1")
    (takes / "clips.csv").write_text("file,caption\nalpha.bvh,a person slides\nghost.bvh,a ghost slides\n")
    (tmp_path / "empty").mkdir()
    outcome = motionkit("ingest", takes, tmp_path / "empty", "--store", tmp_path / "store", "--json", "--workers", 1)
    summary = json.loads(outcome.stdout)
    assert outcome.code == 0
    assert summary["stored"] == 3
    assert summary["failed"] == {
        "frame-time": 2,
        "truncated": 1,
        "channel-count": 1,
        "nan": 1,
        "not-what-it-says": 1,
        "empty": 1,
        "caption-without-motion": 1,
        "empty-folder": 1,
    }
    assert summary["warnings"] == {"no-caption": 9, "unmapped-skeleton": 1}
    assert [warning["reason"] for warning in summary["warned"]] == ["no-caption"] * 9 + ["unmapped-skeleton"]
    assert len(outcome.error_lines) == len(summary["problems"]) == 9
    assert any("ghost.bvh" in line and "line 3" in line for line in outcome.error_lines)
    assert any(line.startswith(f"{tmp_path}/empty: ") for line in outcome.error_lines)
    assert ids(tmp_path / "store") == ["takes/alpha", "takes/beta", "takes/gamma"]


def test_an_empty_folder_alone(motionkit, tmp_path):
    (tmp_path / "empty").mkdir()
    outcome = motionkit("ingest", tmp_path / "empty", "--store", tmp_path / "store")
    assert outcome.code == 1
    assert "no motions in this folder" in outcome.error_lines[0]
    assert "nothing could be stored" in outcome.error_lines[1]
    assert not (tmp_path / "store").exists()


def test_duplicate_ids(motionkit, takes, tmp_path):
    """The same id in one ingest, and in the store from another file."""
    shutil.copy(takes / "alpha.bvh", takes / "alpha.BVH")
    store = tmp_path / "store"
    first = motionkit("ingest", takes, "--store", store, "--workers", 1)
    assert first.code == 0
    assert "'takes/alpha' is already taken by" in first.error_lines[0]
    assert "failed: 1 (1 duplicate-id)" in first.stdout
    other = tmp_path / "other" / "takes"
    other.mkdir(parents=True)
    (other / "beta.bvh").write_text(bvh_text(9))
    second = motionkit("ingest", other, "--store", store, "--workers", 1)
    assert second.code == 1
    assert "already holds a sequence with the id 'takes/beta'" in second.error_lines[0]
    assert Store.open(store).read("takes/beta").num_frames == 5


def test_two_skeletons_in_one_folder(motionkit, takes, tmp_path):
    """Each BVH file brings its own skeleton, so both are kept and told apart."""
    (takes / "child.bvh").write_text(bvh_text().replace("OFFSET 0 -45 0", "OFFSET 0 -22 0"))
    outcome = motionkit("ingest", takes, "--store", tmp_path / "store", "--workers", 1)
    assert (outcome.code, outcome.error_lines) == (0, [])
    store = Store.open(tmp_path / "store")
    assert len(store.skeletons) == 2
    assert store.read("takes/child").skeleton != store.read("takes/alpha").skeleton


def test_a_file_name_that_is_no_text(motionkit, takes, tmp_path):
    """A name in bytes that are not UTF-8 costs that file alone, and can be printed."""
    odd = os.fsencode(takes) + b"/caf\xe9.bvh"
    Path(os.fsdecode(odd)).write_text(bvh_text(4))
    outcome = motionkit("ingest", takes, "--store", tmp_path / "store", "--json")
    assert outcome.code == 0
    assert json.loads(outcome.stdout)["failed"] == {"not-unicode": 1}
    assert len(outcome.error_lines) == 1
    assert ids(tmp_path / "store") == ["takes/alpha", "takes/beta", "takes/gamma"]


def test_a_reader_that_fails_in_a_way_that_nobody_foresaw(motionkit, takes, tmp_path, monkeypatch):
    def read(item, options) -> Motion:
        if item.path.stem == "beta":
            raise ZeroDivisionError("division by zero")
        return original(item, options)

    original = module.read
    monkeypatch.setattr(module, "read", read)
    outcome = motionkit("ingest", takes, "--store", tmp_path / "store", "--workers", 1)
    assert outcome.error_lines == [f"{takes}/beta.bvh: the bvh reader failed: ZeroDivisionError: division by zero"]
    assert ids(tmp_path / "store") == ["takes/alpha", "takes/gamma"]


@pytest.mark.parametrize(
    "arguments",
    [("nowhere",), (".", "--fps", "0"), (".", "--fps", "fast"), (".", "--unit-metres", "-1"), (".", "--format", "mp3")],
)
def test_usage_faults(motionkit, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    outcome = motionkit("ingest", *arguments)
    assert outcome.code == 2
    assert len(outcome.error_lines) == 1
    assert list(tmp_path.iterdir()) == []


def test_the_store_does_not_depend_on_the_number_of_workers(motionkit, takes, tmp_path):
    for i in range(20):
        (takes / f"take-{i}.bvh").write_text(bvh_text(200 + 40 * i))
    for workers in (1, 3):
        outcome = motionkit("ingest", takes, "--store", tmp_path / f"by-{workers}", "--workers", workers)
        assert outcome.code == 0
    assert files_of(tmp_path / "by-1") == files_of(tmp_path / "by-3")


def test_a_disk_that_cannot_be_written(motionkit, takes, tmp_path, monkeypatch):
    store = tmp_path / "store"
    motionkit("ingest", takes / "alpha.bvh", "--store", store)
    before = files_of(store)

    def full(source: Path, target: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files, "replace", full)
    outcome = motionkit("ingest", takes, "--store", store)
    assert outcome.code == 1
    assert re.search(
        r"(?m)^motionkit: the store .* cannot be written \(.*No space left.*\); it is as it was$", outcome.stderr
    )
    assert files_of(store) == before


DEADLY_INGEST = textwrap.dedent(
    """
    import os, sys
    from motionkit.cli.app import run as main
    from motionkit.store import ingest as module

    read = module.read
    def deadly(item, options):
        return os._exit(9) if item.path.stem == "beta" else read(item, options)
    module.read = deadly  # also in the workers, which import this file
    if __name__ == "__main__":
        sys.argv = ["motionkit", *sys.argv[1:]]
        main()
    """
)


def test_a_file_that_its_reader_dies_of(takes, tmp_path):
    """The file is named, the others are stored."""
    program = tmp_path / "program.py"
    program.write_text(DEADLY_INGEST)
    command = [sys.executable, program, "ingest", takes, "--store", tmp_path / "store", "--workers", "2"]
    outcome = subprocess.run(command, capture_output=True, text=True, check=True)
    (line,) = [line for line in outcome.stderr.splitlines() if not line.startswith("warning: ")]
    assert line == (
        f"{takes}/beta.bvh: the process that read it ended without a word (killed, or out of memory?): --workers 1 "
        "shows where"
    )
    assert ids(tmp_path / "store") == ["takes/alpha", "takes/gamma"]


SLOW_INGEST = textwrap.dedent(
    """
    import sys, time
    from motionkit.cli.app import run as main
    from motionkit.store import writer

    add = writer.StoreWriter.add_row
    def slow(self, row, skeleton):
        add(self, row, skeleton)
        print("stored", row["sequence_index"], flush=True)
        if row["sequence_index"] > 270:
            time.sleep(60)
    if __name__ == "__main__":
        writer.StoreWriter.add_row = slow
        sys.argv = ["motionkit", *sys.argv[1:]]
        main()
    """
)


@pytest.mark.parametrize("workers", [1, 2])
def test_killing_an_ingest_leaves_the_previous_store(motionkit, takes, tmp_path, workers):
    """SIGKILL in mid-ingest; the workers end too, and the next ingest starts from the previous store."""
    store = tmp_path / "store"
    motionkit("ingest", takes, "--store", store, "--workers", 1)
    before = files_of(store)
    many = tmp_path / "many"
    many.mkdir()
    for i in range(290):
        (many / f"take-{i:03d}.bvh").write_text(bvh_text(3))
    program = tmp_path / "program.py"
    program.write_text(SLOW_INGEST)
    command = [sys.executable, str(program), "ingest", str(many), "--store", str(store), "--workers", str(workers)]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    for _ in range(260):
        assert child.stdout.readline().startswith("stored")
    workers_of_child = children_of(child.pid)
    child.send_signal(signal.SIGKILL)
    child.wait()
    child.stdout.close()
    assert {name: content for name, content in files_of(store).items() if name in before} == before
    assert ids(store) == ["takes/alpha", "takes/beta", "takes/gamma"]
    assert motionkit("validate", "--store", store).code == 0
    deadline = time.monotonic() + 30
    while any(Path(f"/proc/{pid}").exists() for pid in workers_of_child) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(Path(f"/proc/{pid}").exists() for pid in workers_of_child), "workers outlive a killed ingest"
    assert motionkit("ingest", many, "--store", store, "--workers", 1).code == 0
    assert len(ids(store)) == 293
    assert motionkit("validate", "--store", store).code == 0


def children_of(pid: int) -> list[int]:
    task = Path(f"/proc/{pid}/task/{pid}/children")
    return [int(child) for child in task.read_text().split()] if task.exists() else []


def test_a_store_that_is_busy(motionkit, takes, tmp_path):
    with StoreWriter.create(tmp_path / "store"):
        outcome = motionkit("ingest", takes, "--store", tmp_path / "store")
    assert outcome.code == 1
    (line,) = outcome.error_lines
    assert "another process is writing to the store" in line


def test_the_real_captures(motionkit, captures, tmp_path):
    """Five tools' BVH files at four framerates keep their framerates."""
    outcome = motionkit("ingest", captures / "mixed-bvh", "--store", tmp_path / "store")
    assert outcome.code == 0
    frame = Store.open(tmp_path / "store").sequences
    assert {f"{n}/{d}" for n, d in zip(frame["fps_numerator"], frame["fps_denominator"], strict=True)} == {
        "30/1",
        "100/1",
        "120000/1001",
        "120/1",
    }
    assert motionkit("validate", "--store", tmp_path / "store").code == 0
