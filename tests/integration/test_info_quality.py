"""`motionkit info --quality` on a store of takes with known faults."""

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import pytest

from motionkit.core.motion import Motion, Provenance
from motionkit.fields.interpolation import interpolate
from motionkit.fields.motion_field import to_motion
from motionkit.store.writer import StoreWriter
from tests.helpers.analytic import analytic_motion


def take(name: str, source: str, fps: int) -> Motion:
    motion = to_motion(analytic_motion("walk", 4.0, 3), Fraction(fps))
    return replace(motion, sequence_id=name, provenance=Provenance(source=source, stated_fps=str(fps)))


@pytest.fixture
def store(tmp_path: Path) -> Path:
    path = tmp_path / "store"
    glitch = take("glitch", "ours", 60)
    positions = glitch.joint_positions.copy()
    positions[90, 20] += 0.8
    slow = interpolate(take("slow", "theirs", 24), "linear")
    with StoreWriter.create(path) as writer:
        writer.add(take("good", "ours", 60))
        writer.add(replace(glitch, joint_positions=positions))
        writer.add(
            replace(
                to_motion(slow, Fraction(120)),
                sequence_id="slow",
                provenance=Provenance(source="theirs", stated_fps="0.0083333"),
            )
        )
    return path


def test_it_names_sequences_frames_and_framerates(motionkit, store):
    told = motionkit("info", "--quality", "--store", store)
    assert told.code == 0, told.stderr
    lines = told.stdout.splitlines()
    assert "source ours: 2 sequences, 0.00 h" in lines
    assert any(line.split()[:2] == ["teleport", "1"] for line in lines)
    assert "           2 jumps  glitch, at 1.500 s (frame 90)" in lines
    assert "  120 (stated as 0.0083333) → 24 fps  slow" in lines


def test_json_holds_the_same(motionkit, store):
    report = json.loads(motionkit("info", "--quality", "--json", "--store", store).stdout)
    ours, theirs = report["sources"]
    assert ours["clean"]["num_sequences"] == 1
    assert ours["flags"]["teleport"]["num_sequences"] == 1
    assert theirs["flags"]["upsampled"]["num_sequences"] == 1
    [worst] = [each for each in report["worst"] if each["flag"] == "teleport"]
    assert worst["offenders"] == [{"sequence_id": "glitch", "value": 2.0, "seconds": 1.5, "frame": 90}]
    [slow] = report["upsampled"]
    assert slow == {"sequence_id": "slow", "stated_fps": "0.0083333", "fps": 120.0, "effective_fps": 24.0}
