"""Which framerate is used, and what the log says of the other one, in every format alike."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.errors import FormatError
from motionkit.io.bvh import read_bvh
from motionkit.io.npz import read_npz
from motionkit.io.registry import ReadOptions
from motionkit.io.source_file import fps_in_use, replaced_fps
from tests.helpers.format_samples import bvh_text


def unusable() -> Fraction:
    raise FormatError("no usable clock", path="a.bvh", reason="frame-time")


def test_what_is_given_goes_before_what_is_stated_and_the_log_says_so() -> None:
    assert fps_in_use(None, lambda: Fraction(30)) == (30, [])
    assert fps_in_use(Fraction(30), lambda: Fraction(30)) == (30, [])
    assert fps_in_use(Fraction(24), lambda: Fraction(30)) == (24, ["framerate set to 24; the file says 30"])
    assert fps_in_use(Fraction(24), unusable) == (24, ["framerate set to 24; the file says none"])
    assert fps_in_use(Fraction(24), unusable, words="9 a day")[1] == ["framerate set to 24; the file says 9 a day"]
    with pytest.raises(FormatError, match="no usable clock"):
        fps_in_use(None, unusable)
    by = replaced_fps(Fraction(24), Fraction(30), by=" by decree", who="the data set")
    assert by == ["framerate set to 24 by decree; the data set says 30"]


@pytest.mark.parametrize("stated", ["0", "-1", "nan", "inf", "1e-9", "1e9", "never"])
def test_an_unusable_framerate_is_none_where_one_is_given(tmp_path: Path, stated: str) -> None:
    options = ReadOptions(fps=Fraction(25))
    walk = tmp_path / "walk.bvh"
    walk.write_text(bvh_text(frame_time=stated))
    array = tmp_path / "walk.npz"
    # 1e-9 s between frames are as many frames a second as nobody has, and so are 1e9 frames a second.
    np.savez(array, joint_positions=np.zeros((2, 22, 3), np.float32), fps=np.array(stated))
    for motion in (read_bvh(walk, options), read_npz(array, options)):
        assert motion.fps == 25
        assert motion.provenance.operations[0] == "framerate set to 25; the file says none"
    for read, path in ((read_bvh, walk), (read_npz, array)):
        with pytest.raises(FormatError) as caught:
            read(path)
        assert caught.value.reason == "frame-time"
