"""BVH files read piece by piece: checked as a whole is, written the same whatever the pieces, in any length."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from motionkit.core.errors import FormatError
from motionkit.fields.anchoring import Anchored
from motionkit.fields.interpolation import INTERPOLATORS, Settling
from motionkit.fields.motion_field import MotionEncoder
from motionkit.fields.transfer import Transferred
from motionkit.io.bvh.document import BvhDocument, read_bvh, read_document
from tests.helpers.completed_bvh import write_completed
from tests.helpers.damage import damaged
from tests.helpers.format_samples import NUM_BVH_CHANNELS, bvh_text
from tests.helpers.whole_documents import lines_of, poses_of, table_of
from tests.motionkit.io.bvh.test_bad_bvh import BAD

SPLINE = Settling(INTERPOLATORS["rotation-cubic"])
LEARNT = Transferred(Anchored(INTERPOLATORS["hold"]), Settling(INTERPOLATORS["slerp"]))


def swinging(num_frames: int) -> list[list[float]]:
    """Angles that swing and wind up, one channel that rests."""
    rng = np.random.default_rng(7)
    seconds = np.arange(num_frames)[:, None] / 30
    table = 25 * np.sin(rng.uniform(2, 4, NUM_BVH_CHANNELS) * seconds + rng.uniform(0, 6, NUM_BVH_CHANNELS))
    table[:, 0], table[:, 1] = 12.3456, 95 + 2 * np.sin(9 * seconds[:, 0])
    table[:, 3] += 170 + 160 * seconds[:, 0]
    return np.round(table, 6).tolist()


def in_small_blocks(patched: pytest.MonkeyPatch, frames: int, num_bytes: int) -> None:
    """Everything in blocks of so few frames and bytes that short clips have many."""
    patched.setattr("motionkit.io.bvh.frame_lines.FRAMES_AT_ONCE", frames)
    patched.setattr("motionkit.io.source.number_table.BLOCK_BYTES", num_bytes)
    patched.setattr("motionkit.io.source.source_file.PART_BYTES", num_bytes)
    patched.setattr("motionkit.io.bvh.text.PART_BYTES", num_bytes)


def completed(document: BvhDocument, encoder: MotionEncoder, observed: np.ndarray, path: Path, **reach: float) -> None:
    """The document's frames that are observed, completed at 59.94 fps."""
    write_completed(document, observed, encoder, Fraction(60000, 1001), path, **reach)


def with_gaps(path: Path) -> tuple[BvhDocument, np.ndarray]:
    """Four seconds with a lost frame, and the frames to keep: not the first ones, and not a second in the middle."""
    lines = bvh_text(swinging(120)).splitlines()
    lost = lines[-90].split()
    lines[-90] = " ".join(["nan", *lost[1:]])
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    kept = np.ones(120, bool)
    kept[:3] = kept[50:81] = False
    document = read_document(path)
    assert np.flatnonzero(~document.seen).tolist() == [30]
    return document, kept & document.seen


@pytest.mark.parametrize("encoder", [SPLINE, LEARNT], ids=["spline", "learnt"])
def test_blocks_of_any_length_make_the_same_motion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, encoder: MotionEncoder
) -> None:
    document, kept = with_gaps(tmp_path / "in.bvh")
    reach = {"before_seconds": 0.3, "after_seconds": 0.4}
    completed(document, encoder, kept, tmp_path / "whole.bvh", **reach)
    in_small_blocks(monkeypatch, 16, 700)
    again = read_document(tmp_path / "in.bvh")
    assert again.seen.tolist() == document.seen.tolist() and lines_of(again) == lines_of(document)
    completed(again, encoder, kept, tmp_path / "blocks.bvh", **reach)
    whole, blocks = read_document(tmp_path / "whole.bvh"), read_document(tmp_path / "blocks.bvh")
    np.testing.assert_allclose(poses_of(blocks).joint_positions, poses_of(whole).joint_positions, atol=1e-6)
    # Angles in degrees of rotations in float32.
    np.testing.assert_allclose(table_of(blocks), table_of(whole), atol=1e-4)
    assert set(table_of(blocks)[:, 0]) == {12.3456}


@pytest.mark.parametrize("num_bytes", [100, 1 << 16])
@pytest.mark.parametrize("name", [name for name in BAD if name not in ("nan", "no body of any size")])
def test_what_is_wrong_is_found_in_pieces_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, num_bytes: int
) -> None:
    content, reason, line, frame = BAD[name]
    in_small_blocks(monkeypatch, 2, num_bytes)
    (tmp_path / "bad.bvh").write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(FormatError) as caught:
        read_document(tmp_path / "bad.bvh")
    assert (caught.value.reason, caught.value.frame) == (reason, frame)
    assert line is None or caught.value.line == line


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_damaged_files_are_read_as_a_whole_is_or_explained(tmp_path: Path, data: st.DataObject) -> None:
    path = tmp_path / "a.bvh"
    path.write_bytes(data.draw(damaged(bvh_text(swinging(6)).encode())))
    with pytest.MonkeyPatch.context() as patched:
        in_small_blocks(patched, 2, data.draw(st.integers(16, 2000)))
        try:
            document = read_document(path)
            found = table_of(document)
        except FormatError as error:
            assert "\n" not in str(error)
            with pytest.raises(FormatError):
                read_bvh(path)
            return
    if document.seen.all() and not document.reference:
        try:
            motion = read_bvh(path)
        except FormatError as error:
            assert error.reason in ("unit", "channels")  # what is no human body is completed all the same
        else:
            assert motion.num_frames == len(found) and motion.fps == document.timegrid.fps


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r", " \n\n"])
def test_line_ends_of_all_kinds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str) -> None:
    rows = swinging(9)
    (tmp_path / "a.bvh").write_bytes((bvh_text(rows).rstrip("\n") + "\n\n").replace("\n", ending).encode())
    in_small_blocks(monkeypatch, 2, 64)
    document = read_document(tmp_path / "a.bvh")
    np.testing.assert_allclose(table_of(document), rows, rtol=1e-5)
    assert lines_of(document) == [line.encode() for line in bvh_text(rows).splitlines()[-9:]]
    assert document.provenance.source_sha256 == read_bvh(tmp_path / "a.bvh").provenance.source_sha256


def test_a_file_that_changes_meanwhile_is_not_mixed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.bvh"
    path.write_text(bvh_text(swinging(40)), encoding="utf-8")
    in_small_blocks(monkeypatch, 2, 700)
    document = read_document(path)
    path.write_text(bvh_text(swinging(41)), encoding="utf-8")
    with pytest.raises(FormatError, match="changed while it was read"):
        table_of(document)
