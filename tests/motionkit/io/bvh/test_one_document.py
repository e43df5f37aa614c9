"""One BVH file is the same motion for ingest, complete and view: its skeleton, its frames, its clock."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.motion import Motion
from motionkit.edit.complete import CompletionRequest, complete_file
from motionkit.edit.encoders import choose_encoder
from motionkit.edit.motions import LoadedMotion, OutputPaths, find_motions
from motionkit.io.framerate_rules import parse_rules
from motionkit.io.registry import ReadOptions
from motionkit.store import Store
from motionkit.store.ingest import ingest
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


def loaded_from(path: Path) -> LoadedMotion:
    (source,), problems = find_motions([str(path)], OPTIONS, path.parent / "none")
    assert not problems
    return source.load()


@pytest.mark.parametrize("kind", KINDS)
def test_ingest_complete_and_view_see_one_motion(tmp_path: Path, kind: str) -> None:
    (tmp_path / "in").mkdir()
    path = KINDS[kind](tmp_path / "in")
    stored, loaded = ingested(path, tmp_path), loaded_from(path)
    motion = loaded.motion
    assert loaded.valid.all() and loaded.uneven_seconds is None
    assert stored.timegrid == motion.timegrid
    assert stored.skeleton.fingerprint == motion.skeleton.fingerprint
    np.testing.assert_array_equal(loaded.poses.joint_positions, motion.joint_positions)
    # A store rounds rotations in the last digit and makes positions of them again.
    np.testing.assert_allclose(stored.joint_positions, motion.joint_positions, atol=1e-6)
    assert (stored.local_rotations is None) == (motion.local_rotations is None)
    if stored.local_rotations is not None:
        np.testing.assert_allclose(stored.local_rotations, motion.local_rotations, atol=1e-6)
    for name in ("provenance", "action", "style", "split", "captions"):
        assert getattr(stored, name) == getattr(motion, name)


def test_the_clock_and_the_frames_are_those_of_rules_and_tables(tmp_path: Path) -> None:
    assert loaded_from(KINDS["a rule for its clock"](tmp_path)).motion.fps == 24
    assert loaded_from(KINDS["100style"](tmp_path)).motion.num_frames == 30
    elsewhere = loaded_from(KINDS["bones that rest elsewhere"](tmp_path)).motion
    assert "(LeftLeg, LeftFoot" in str(elsewhere.provenance.operations)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_completed_and_read_again(tmp_path: Path, kind: str) -> None:
    """Given frames stay where they are, new ones lie between them."""
    path, out = KINDS[kind](tmp_path), tmp_path / "out.bvh"
    (source,), _ = find_motions([str(path)], OPTIONS, tmp_path / "none")
    before = source.load()
    request = CompletionRequest(fps=2 * before.motion.fps)
    slerp = choose_encoder("slerp", None, tmp_path)
    complete_file(source, request, slerp, (), OutputPaths("completed", [str(path)], 1, out=out))
    old, new = before.motion.joint_positions, loaded_from(out).motion.joint_positions
    assert len(new) == 2 * len(old) - 1
    np.testing.assert_allclose(new[::2], old, atol=1e-5)
    # Slerp between its neighbours turns each bone by no more than they are apart.
    apart = np.linalg.norm(np.diff(old, axis=0), axis=-1).max()
    assert np.linalg.norm(new[1::2] - old[:-1], axis=-1).max() <= 1.01 * apart + 1e-5
