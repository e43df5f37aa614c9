from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from motionkit.io.asfamc import parse_amc, read_asfamc
from motionkit.io.registry import ReadOptions
from tests.helpers.bones import check_rotations
from tests.helpers.format_samples import ASF, amc_text, write_asfamc
from tests.helpers.refusal import refusal

AT_120 = ReadOptions(fps=Fraction(120))
TEXT = amc_text()

BAD_MOTIONS: dict[str, tuple[str, str, int | None, int | None]] = {
    # name: (content, reason, 1-based line, 0-based frame)
    "a BVH file": ("HIERARCHY\nROOT Hips\n{\n", "not-what-it-says", None, None),
    "no frames": (":FULLY-SPECIFIED\n:DEGREES\n", "not-what-it-says", None, None),
    "radians": (TEXT.replace(":DEGREES", ":RADIANS"), "radians", None, None),
    "cut between bones": (TEXT[: TEXT.rindex("ltibia")], "truncated", 14, 2),
    "a number too many": (TEXT.replace("ltibia 31", "ltibia 31 4"), "channel-count", 11, 1),
    "nan": (TEXT.replace("ltibia 31", "ltibia nan"), "nan", 11, 1),
    "a control character": (TEXT.replace("root 0 ", "root 0\x1b", 1), "not-a-number", 5, 0),
    "beyond reason": (TEXT.replace("ltibia 31", "ltibia 1e99"), "range", 11, 1),
    "bones in another order": (TEXT.replace("ltibia 31\n", "").replace("\n2\n", "\n2\nltibia 31\n"), "bones", 9, 1),
    "a bone 60,000 times": (TEXT.replace("lfemur 0 3.5e-015 2\n", "lfemur 0 0 0\n" * 60_000), "bones", None, None),
    "an unknown bone": (TEXT.replace("ltibia", "tail"), "bones", None, None),
    "a frame number missing": (TEXT.replace("\n2\n", "\n4\n"), "frame-number", 8, 1),
}
BAD_SKELETONS = [
    ("hello", "not-what-it-says"),
    (ASF[: ASF.index("dof rx\n  end\n:hier")], "asf"),
    (ASF.replace("    lfemur ltibia\n", ""), "asf"),
    (ASF.replace("lfemur ltibia", "lfemur ltibia\n    root ltibia"), "asf"),
    (ASF.replace("length 7.5", "length long"), "not-a-number"),
    (ASF.replace("direction 0 -1 0", "direction 0 -1", 1), "asf"),
    (ASF.replace("10 20 30 XYZ", "10 20 30 XXZ"), "asf"),
    (ASF.replace("dof rx\n", "dof tx\n"), "asf"),
]


def test_the_formula_of_the_format(tmp_path: Path) -> None:
    motion = read_asfamc(write_asfamc(tmp_path), AT_120)
    unit = 0.0254 / 0.45
    root = Rotation.from_euler("xyz", (0, 20, 0), degrees=True)
    axis = Rotation.from_euler("xyz", (0, 0, 20), degrees=True)
    femur = root * axis * Rotation.from_euler("xyz", (10, 3.5e-15, 2), degrees=True) * axis.inv()
    knee = np.array([0, 18, 0]) + femur.apply((0, -7, 0))
    assert motion.skeleton.joint_names == ("root", "lfemur", "ltibia")
    assert np.allclose(motion.joint_positions[2, 2], knee * unit, atol=1e-6)
    assert np.allclose(motion.joint_positions[2, 1], np.array([0, 18, 0]) * unit)
    check_rotations(motion, 1e-6)


def test_every_real_take_is_an_upright_metre_sized_body_and_its_rotations_are_true(captures: Path) -> None:
    for path in sorted(captures.glob("cmu/asfamc/*/*.amc"))[::6]:
        motion = read_asfamc(path, AT_120)
        height = motion.joint_positions[:, motion.skeleton.index("head"), 1]
        assert 1.2 < np.percentile(height, 90) < 2.4, path.name  # subject 01 climbs
        check_rotations(motion)


@pytest.mark.parametrize("name", BAD_MOTIONS)
def test_bad_motions_are_explained(tmp_path: Path, name: str) -> None:
    content, reason, line, frame = BAD_MOTIONS[name]
    path = write_asfamc(tmp_path)
    path.write_text(content)
    error = refusal(read_asfamc, path, AT_120)
    assert (error.path, error.reason, error.line, error.frame) == (path, reason, line, frame)


@pytest.mark.parametrize(("content", "reason"), BAD_SKELETONS)
def test_bad_skeletons_are_explained(tmp_path: Path, content: str, reason: str) -> None:
    path = write_asfamc(tmp_path)
    (tmp_path / "07.asf").write_text(content)
    error = refusal(read_asfamc, path, AT_120)
    assert (error.path.name, error.reason) == ("07.asf", reason)


def test_the_skeleton_is_found_or_asked_for(tmp_path: Path) -> None:
    path = write_asfamc(tmp_path, first=120)  # frame numbers may start anywhere
    (tmp_path / "08.asf").write_text(ASF)
    assert read_asfamc(path, AT_120).num_frames == 3  # 07.asf is named like the take
    assert refusal(read_asfamc, path).reason == "no-framerate"
    path = path.rename(tmp_path / "walk.amc")
    assert refusal(read_asfamc, path, AT_120).reason == "two-skeletons"
    for skeleton in tmp_path.glob("*.asf"):
        skeleton.unlink()
    assert refusal(read_asfamc, path, AT_120).reason == "no-skeleton"


@pytest.mark.parametrize("variant", [TEXT.replace("\n", "\r\n"), TEXT.replace(" ", "\t"), TEXT + "\n\n", " \n" + TEXT])
def test_fast_and_exact_parsers_agree(variant: str) -> None:
    values, bones = parse_amc(variant.encode(), Path("a.amc"))
    assert bones == (("root", 6), ("lfemur", 3), ("ltibia", 1))
    assert values[2].tolist() == [0, 18, 0, 0, 20, 0, 10, 3.5e-15, 2, 32]
