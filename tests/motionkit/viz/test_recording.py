"""Recordings for Rerun, read back by its own reader: every native frame at its second, joints by name."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.skeleton import SMPL22
from motionkit.viz.player.takes import Take
from motionkit.viz.recording import write_recording


def test_every_native_frame_is_at_its_second(tmp_path: Path) -> None:
    reader = pytest.importorskip("rerun.chunk", reason="the extra rerun is not installed").RrdReader
    places = np.random.default_rng(0).normal(size=(7, 22, 3)).astype(np.float32)
    lost = places.copy()
    lost[3] = np.nan
    takes = [
        Take("a/b c.bvh", lost, SMPL22, Fraction(120), 1.5),
        Take("run.bvh", places, SMPL22, Fraction(30000, 1001)),
    ]
    write_recording(tmp_path / "made.rrd", takes)
    found = [chunk.to_record_batch().to_pydict() for chunk in reader(tmp_path / "made.rrd").stream().to_chunks()]
    poses = [each for each in found if "Points3D:positions" in each]
    for take in takes:
        whole = np.isfinite(take.joint_positions).all(axis=(1, 2))
        (own,) = (each for each in poses if len(each["time"]) == whole.sum())
        np.testing.assert_array_equal(np.array(own["Points3D:positions"], np.float32), take.joint_positions[whole])
        seconds = [each.total_seconds() for each in own["time"]]
        np.testing.assert_allclose(seconds, take.frame_seconds()[whole], atol=1e-6)
    (context, _) = (each["AnnotationContext:context"] for each in found if "AnnotationContext:context" in each)
    assert all(f"'{name}'" in str(context) for name in SMPL22.joint_names)
