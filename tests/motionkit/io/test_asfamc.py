from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.io.asfamc import read_asfamc
from motionkit.io.bvh import read_bvh
from motionkit.io.registry import ReadOptions
from tests.helpers.format_samples import write_asfamc

AT_120 = ReadOptions(fps=Fraction(120))


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
    assert motion.local_rotations is not None and motion.root_translation is not None
    again = kinematics.forward_kinematics(motion.local_rotations, motion.root_translation, motion.skeleton)
    assert np.allclose(again, motion.joint_positions, atol=1e-6)


def test_without_a_framerate_it_says_how_to_give_one(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="--fps") as caught:
        read_asfamc(write_asfamc(tmp_path))
    assert caught.value.reason == "no-framerate"


def test_frame_numbers_may_start_anywhere(tmp_path: Path) -> None:
    motion = read_asfamc(write_asfamc(tmp_path, first=120), AT_120)
    assert motion.num_frames == 3
    assert "AMC frame numbers start at 120" in motion.provenance.operations


def test_one_subject_has_one_thigh_in_both_of_its_formats(captures: Path) -> None:
    """Subject 05's takes come as ASF/AMC and as B. Hahne's BVH."""
    amc = read_asfamc(captures / "cmu" / "asfamc" / "05" / "05_01.amc", AT_120)
    bvh = read_bvh(captures / "cmu" / "bvh" / "05_06.bvh")
    for one, other in (("ltibia", "LeftLeg"), ("lfoot", "LeftFoot"), ("lradius", "LeftForeArm")):
        lengths = [
            float(np.linalg.norm(skeleton.offsets[skeleton.index(name)]))
            for skeleton, name in ((amc.skeleton, one), (bvh.skeleton, other))
        ]
        assert lengths[0] == pytest.approx(lengths[1], abs=1e-4)


def test_every_real_take_is_an_upright_metre_sized_body_and_its_rotations_are_true(captures: Path) -> None:
    for path in sorted(captures.glob("cmu/asfamc/*/*.amc"))[::6]:
        motion = read_asfamc(path, AT_120)
        height = motion.joint_positions[:, motion.skeleton.index("head"), 1]
        assert 1.2 < np.percentile(height, 90) < 2.4, path.name  # subject 01 climbs
        assert motion.local_rotations is not None and motion.root_translation is not None
        again = kinematics.forward_kinematics(motion.local_rotations, motion.root_translation, motion.skeleton)
        assert np.abs(again - motion.joint_positions).max() < 1e-5
