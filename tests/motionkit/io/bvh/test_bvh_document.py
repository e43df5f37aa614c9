"""BVH files written again: their own text and lines, new frames in their own channels, read alike by others."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pymotion.io.bvh import BVH

from motionkit.core.errors import FormatError
from motionkit.fields.interpolation import INTERPOLATORS
from motionkit.fields.motion_field import Observation
from motionkit.io.bvh.document import BvhDocument, read_bvh, read_document
from motionkit.io.bvh.writing import check_writable
from tests.helpers.completed_bvh import write_completed
from tests.helpers.format_samples import NUM_BVH_CHANNELS, bvh_hierarchy, bvh_text
from tests.helpers.whole_documents import lines_of, poses_of, table_of

CUBIC = INTERPOLATORS["rotation-cubic"]


def rows(num_frames: int = 12, seed: int = 0) -> list[list[float]]:
    """Angles that swing and wind up, in the file's six digits; the left foot and the root's x rest."""
    rng = np.random.default_rng(seed)
    seconds = np.arange(num_frames) / 30
    table = 25 * np.sin(rng.uniform(3, 6, NUM_BVH_CHANNELS) * seconds[:, None] + rng.uniform(0, 6, NUM_BVH_CHANNELS))
    table[:, 0], table[:, 1] = 12.3456, 95 + 2 * np.sin(9 * seconds)
    table[:, 3] += 170 + 160 * seconds
    foot = 6 + 3 * 11
    table[:, foot : foot + 3] = (1.25, -33.3, 90.0)
    return np.round(table, 6).tolist()


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def completed(document: BvhDocument, path: Path, **asked: object) -> BvhDocument:
    observed = document.seen & np.asarray(asked.pop("observed", True))
    fps = asked.pop("fps", document.timegrid.fps)
    write_completed(document, observed, CUBIC, fps, path, **asked)
    return read_document(path)


def test_given_frames_are_the_lines_that_they_were(tmp_path: Path) -> None:
    document = read_document(written(tmp_path / "in.bvh", bvh_text(rows())))
    made = completed(document, tmp_path / "out.bvh", fps=Fraction(120))
    assert lines_of(made)[::4] == lines_of(document) and len(lines_of(made)) == 4 * 11 + 1
    assert made.head.head == document.head.head and made.timegrid.fps == 120
    np.testing.assert_array_equal(table_of(made)[::4], table_of(document))
    # What rests stays as it is to the last digit; what winds up goes on.
    foot = 6 + 3 * 11
    assert set(table_of(made)[:, 0]) == {12.3456} and set(table_of(made)[:, foot + 2]) == {90.0}
    assert np.abs(np.diff(table_of(made), axis=0)).max() < 10
    assert table_of(made)[-1, 3] > 200


def test_new_frames_are_those_of_the_field(tmp_path: Path) -> None:
    path = written(tmp_path / "in.bvh", bvh_text(rows()))
    document = read_document(path)
    made = completed(document, tmp_path / "out.bvh", fps=Fraction(60000, 1001))
    field = CUBIC.encode(Observation(document.timegrid.seconds(), poses_of(document), document.skeleton))
    wanted = field.query(made.timegrid.seconds())
    np.testing.assert_allclose(poses_of(made).joint_positions, wanted.joint_positions, atol=2e-6)
    np.testing.assert_allclose(read_bvh(path).joint_positions, poses_of(document).joint_positions, atol=1e-6)


def test_another_reader_sees_the_same_motion(tmp_path: Path) -> None:
    document = read_document(written(tmp_path / "in.bvh", bvh_text(rows())))
    made = completed(document, tmp_path / "out.bvh", fps=Fraction(90), after_seconds=0.1)
    bvh = BVH()
    bvh.load(str(tmp_path / "out.bvh"))
    rotations, positions, _, offsets, _, _ = bvh.get_data()
    assert list(bvh.data["names"]) == list(made.skeleton.joint_names)
    assert bvh.data["frame_time"] == pytest.approx(1 / 90, abs=1e-12)
    assert len(rotations) == made.timegrid.num_frames
    mine = poses_of(made).local_rotations
    assert mine is not None
    assert np.abs(np.sum(rotations * mine, axis=-1)).min() > 1 - 1e-6
    np.testing.assert_allclose(
        positions[:, 0] * document.body.unit_metres, poses_of(made).joint_positions[:, 0], atol=1e-5
    )
    np.testing.assert_allclose(offsets[1:] * document.body.unit_metres, made.skeleton.offsets[1:], atol=1e-6)


def test_frames_with_nan_are_made_like_a_gap(tmp_path: Path) -> None:
    table = rows()
    lines = [" ".join(f"{value:g}" for value in row) for row in table]
    lines[5] = lines[5].replace(lines[5].split()[8], "NaN")
    text = f"{bvh_hierarchy()}MOTION\nFrames: 12\nFrame Time: 0.0333333\n" + "\n".join(lines) + "\n"
    document = read_document(written(tmp_path / "in.bvh", text))
    assert document.seen.tolist() == [frame != 5 for frame in range(12)]
    made = completed(document, tmp_path / "out.bvh")
    np.testing.assert_allclose(table_of(made)[5], table[5], atol=1.0)
    assert b"NaN" not in lines_of(made)[5] and lines_of(made)[4] == lines_of(document)[4]
    empty = text.replace("\n".join(lines), "\n".join(" ".join(["nan"] * NUM_BVH_CHANNELS) for _ in lines))
    with pytest.raises(FormatError, match="every frame"):
        read_document(written(tmp_path / "none.bvh", empty))


def test_a_t_pose_in_front_stays_in_front(tmp_path: Path) -> None:
    table = rows()
    t_pose = [0.0] * NUM_BVH_CHANNELS
    t_pose[:3] = table[0][:3]
    document = read_document(written(tmp_path / "in.bvh", bvh_text([t_pose, *table])))
    assert len(document.reference) == 1 and document.timegrid.num_frames == 12
    made = completed(document, tmp_path / "out.bvh", fps=Fraction(60))
    assert made.reference == document.reference and lines_of(made)[::2] == lines_of(document)
    assert b"Frames: 24" in (tmp_path / "out.bvh").read_bytes()


@pytest.mark.parametrize("rests_along_z", [True, False])
def test_a_body_along_z_is_written_along_z(tmp_path: Path, rests_along_z: bool) -> None:
    """Where the rest pose is along z too, and where the root's rotation takes it there."""

    def turned(text: str) -> str:
        found = []
        for line in text.splitlines():
            words = line.split()
            if words[:1] == ["OFFSET"]:
                x, y, z = words[1:]
                line = f"OFFSET {x} {-float(z):g} {y}"
            found.append(line)
        return "\n".join(found) + "\n"

    table = rows()
    for row in table:
        row[1], row[2] = -row[2], row[1]
        row[3:6] = [0.0, 0.0 if rests_along_z else 90.0, 0.0]
    text = bvh_text(table)
    document = read_document(written(tmp_path / "in.bvh", turned(text) if rests_along_z else text))
    assert (document.body.up, document.body.rests_along_up) == ("z", rests_along_z)
    made = completed(document, tmp_path / "out.bvh", fps=Fraction(60))
    assert made.body.up == "z" and lines_of(made)[::2] == lines_of(document)
    between = 0.5 * (table_of(made)[:-2:2] + table_of(made)[2::2])
    assert np.abs(table_of(made)[1::2] - between).max() < 1.0


def test_quadrupeds_and_props_are_written_too(tmp_path: Path) -> None:
    text = """HIERARCHY
ROOT box
{
OFFSET 0 0 0
CHANNELS 6 Zposition Yposition Xposition Yrotation Zrotation Xrotation
JOINT lid
{
OFFSET 0 1 0
CHANNELS 1 Xrotation
End Site
{
OFFSET 0 0 1
}
}
}
MOTION
Frames: 3
Frame Time: 0.04
0 0 0 0 0 0 0
1 0 0 30 0 0 10
2 0 0 60 0 0 20
"""
    made = completed(read_document(written(tmp_path / "in.bvh", text)), tmp_path / "out.bvh", fps=Fraction(50))
    np.testing.assert_allclose(table_of(made)[1], [0.5, 0, 0, 15, 0, 0, 5], atol=1e-5)
    twice = text.replace("1 Xrotation", "2 Xrotation Xrotation")
    for row in ("0 0 0 0 0 0 0", "1 0 0 30 0 0 10", "2 0 0 60 0 0 20"):
        twice = twice.replace(f"{row}\n", f"{row} 0\n")
    with pytest.raises(FormatError, match="lid"):
        check_writable(read_document(written(tmp_path / "twice.bvh", twice)))
