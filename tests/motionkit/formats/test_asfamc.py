from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from motionkit import kinematics
from motionkit.errors import FormatError
from motionkit.formats.asfamc import read_asfamc
from motionkit.formats.items import ReadOptions
from tests.motionkit.formats.samples import write_asfamc

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
