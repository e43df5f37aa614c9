"""One BVH file is the same motion for ingest, complete and view: its skeleton, its frames, its clock."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.motion import Motion
from motionkit.edit.complete.clips import Clip, find_clips
from motionkit.edit.complete.encoders import choose_encoder
from motionkit.edit.complete.job import Job, OutputPath
from motionkit.edit.complete.request import CompletionRequest
from motionkit.io.framerate_rules import parse_rules
from motionkit.io.registry import ReadOptions
from motionkit.store import Store
from motionkit.store.ingest import ingest
from motionkit.viz.view.job import find_sources
from tests.helpers.format_samples import lafan1_text
from tests.motionkit.io.bvh.test_bvh_pieces import TAKES, carried

OPTIONS = ReadOptions(fps_rules=parse_rules('[[rule]]\nfiles = "**/slow.bvh"\nfps = 24\n', "mine.toml"))
MOVING = TAKES["bones that change"]
# Position channels hold the neck where they say, and its OFFSET is another.
ELSEWHERE = MOVING.replace("OFFSET 0 27 0", "OFFSET 0 25 0")


def take(name: str, text: str) -> Callable[[Path], Path]:
    """A source of one file."""

    def write(folder: Path) -> Path:
        (folder / name).write_bytes(text.encode())
        return folder / name

    return write


def of_100style(folder: Path) -> Path:
    (folder / "Frame_Cuts.csv").write_text("STYLE_NAME,FW_START,FW_STOP\nOld,10,40\n")
    return take("Old_FW.bvh", TAKES["plain"])(folder)


KINDS: dict[str, Callable[[Path], Path]] = {
    **{name: take("take.bvh", text) for name, text in TAKES.items() if name != "one frame"},
    "bones that rest elsewhere": take("take.bvh", ELSEWHERE),
    "a carrier of bones that change": take("take.bvh", carried(ELSEWHERE)),
    "lafan1": take("walk1_subject5.bvh", lafan1_text(20)),
    "100style": of_100style,
    "a rule for its clock": take("slow.bvh", TAKES["plain"]),
}


def ingested(path: Path, folder: Path) -> Motion:
    report = ingest([path], folder / "store", options=OPTIONS, num_workers=1)
    assert not report.problems
    return Store.open(folder / "store").read(0)


def clip_of(path: Path) -> Clip:
    (source,), problems = find_clips([str(path)], OPTIONS, path.parent / "none")
    assert not problems
    return source.read()


def viewed(path: Path) -> Motion:
    (source,), problems = find_sources([str(path)], OPTIONS, path.parent / "none")
    assert not problems
    read = source.read()
    assert read.seen.all() and read.uneven_seconds is None
    return read.motion


@pytest.mark.parametrize("kind", KINDS)
def test_ingest_complete_and_view_see_one_motion(tmp_path: Path, kind: str) -> None:
    (tmp_path / "in").mkdir()
    path = KINDS[kind](tmp_path / "in")
    stored, clip, shown = ingested(path, tmp_path), clip_of(path), viewed(path)
    assert stored.timegrid == clip.timegrid == shown.timegrid
    assert stored.skeleton.fingerprint == clip.skeleton.fingerprint == shown.skeleton.fingerprint
    poses = clip.poses(np.arange(shown.num_frames))
    np.testing.assert_array_equal(shown.joint_positions, poses.joint_positions)
    # A store rounds rotations in the last digit and makes positions of them again.
    np.testing.assert_allclose(stored.joint_positions, shown.joint_positions, atol=1e-6)
    assert (stored.local_rotations is None) == (shown.local_rotations is None)
    if stored.local_rotations is not None:
        np.testing.assert_allclose(stored.local_rotations, shown.local_rotations, atol=1e-6)
    for name in ("provenance", "action", "style", "split", "captions"):
        assert getattr(stored, name) == getattr(shown, name) == getattr(clip.label(shown), name)


def test_the_clock_and_the_frames_are_those_of_rules_and_tables(tmp_path: Path) -> None:
    assert clip_of(KINDS["a rule for its clock"](tmp_path)).timegrid.fps == 24
    assert clip_of(KINDS["100style"](tmp_path)).timegrid.num_frames == 30
    assert "(LeftLeg, LeftFoot" in str(viewed(KINDS["bones that rest elsewhere"](tmp_path)).provenance.operations)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_completed_and_read_again(tmp_path: Path, kind: str) -> None:
    """Given frames stay where they are, new ones lie between them."""
    path = KINDS[kind](tmp_path)
    (source,), _ = find_clips([str(path)], OPTIONS, tmp_path / "none")
    before = source.read()
    out, request = tmp_path / "out.bvh", CompletionRequest(fps=2 * before.timegrid.fps)
    job = Job(request, choose_encoder("slerp", None, tmp_path))
    job.complete(source, OutputPath(out, 1, ()), lambda frames: None)
    after = clip_of(out)
    frames, made = np.arange(before.timegrid.num_frames), np.arange(after.timegrid.num_frames)
    assert len(made) == 2 * len(frames) - 1
    old, new = before.poses(frames).joint_positions, after.poses(made).joint_positions
    np.testing.assert_allclose(new[::2], old, atol=1e-5)
    # Slerp between its neighbours turns each bone by no more than they are apart.
    apart = np.linalg.norm(np.diff(old, axis=0), axis=-1).max()
    assert np.linalg.norm(new[1::2] - old[:-1], axis=-1).max() <= 1.01 * apart + 1e-5
