"""Positions as text: back to half a step, in Python and in the page's own script; the page's clock."""

import json
import shutil
import subprocess
from importlib import resources

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motionkit.viz.player import Packed, pack, packed_bytes
from tests.helpers.packed import unpack


@st.composite
def bodies(draw: st.DrawFn) -> np.ndarray:
    """Positions of a few joints, some of them far from the first and from the origin."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape = (draw(st.integers(1, 6)), draw(st.integers(1, 8)), 3)
    reach, away = draw(st.sampled_from([0.5, 3.0, 400.0])), draw(st.sampled_from([0.0, 400.0]))
    return (rng.uniform(-reach, reach, shape) + away).astype(np.float32)


@given(bodies())
def test_positions_come_back_to_half_a_step(positions: np.ndarray) -> None:
    packed = pack(positions)
    reach = np.abs(positions - positions[:, :1]).max()
    assert packed["stepMetres"] == pytest.approx(max(1e-4, reach / 32767))
    # What float32 adds at 400 m is 15 µm.
    error = np.abs(unpack(packed) - positions).max()
    assert error <= packed["stepMetres"] / 2 + 2 * np.spacing(np.float32(np.abs(positions).max()))


def test_a_minute_at_120_fps_is_two_megabytes() -> None:
    size = len(json.dumps(pack(np.zeros((7200, 31, 3), np.float32))))
    assert size == pytest.approx(packed_bytes(7200, 31), rel=1e-3) and 1e6 < size < 2e6


@pytest.fixture(scope="module")
def node() -> str:
    found = shutil.which("node")
    if found is None:
        pytest.skip("needs node, to run the page's script")
    return found


def in_script(node: str, scripts: list[str], expression: str, data: object) -> object:
    """What an expression of `data` is to the page's own scripts."""
    parts = resources.files("motionkit.viz") / "player_page"
    code = "\n".join(parts.joinpath(name).read_text(encoding="utf-8") for name in scripts)
    code += f'\nconst data = JSON.parse(require("fs").readFileSync(0));\nconsole.log(JSON.stringify({expression}));'
    ran = subprocess.run([node, "-e", code], input=json.dumps(data), capture_output=True, text=True, check=True)
    return json.loads(ran.stdout)


def test_the_script_unpacks_the_same(node: str) -> None:
    examples: list[Packed] = []

    @settings(max_examples=60)
    @given(bodies())
    def collect(positions: np.ndarray) -> None:
        examples.append(pack(positions))

    collect()
    answer = in_script(node, ["packing.js"], "data.map((each) => Array.from(unpack(each)))", examples)
    assert isinstance(answer, list) and len(answer) == len(examples)
    for numbers, packed in zip(answer, examples, strict=True):
        np.testing.assert_allclose(np.float32(numbers), unpack(packed).ravel(), rtol=1e-6)


def test_a_frame_is_held_until_the_next(node: str) -> None:
    """At every framerate the frame at an instant is the last that has begun; steps land on frames exactly."""
    takes = [
        {"fps": fps, "startSeconds": start, "numFrames": 50, "unevenSeconds": None}
        for fps in ([30, 1], [120, 1], [24000, 1001], [25, 2])
        for start in (0, -0.2, 7.3)
    ]
    uneven = np.cumsum(np.random.default_rng(0).uniform(0.001, 0.2, 50))
    takes.append({"fps": [10, 1], "startSeconds": uneven[0], "numFrames": 50, "unevenSeconds": uneven.tolist()})
    asked = [{"take": take, "at": [0, 0.4, 0.99]} for take in takes]
    answer = in_script(
        node,
        ["clock.js"],
        """data.map(({ take, at }) => Array.from({ length: 50 }, (_, frame) => at.map((part) => {
            const next = frame < 49 ? secondsOf(take, frame + 1) : endOf(take), here = secondsOf(take, frame);
            const held = frameAt(take, here + part * (next - here));
            return [held.frame, held.part, held.state];
        })))""",
        asked,
    )
    answers = np.array(answer)
    np.testing.assert_array_equal(answers[..., 0], np.broadcast_to(np.arange(50)[:, None], answers.shape[:3]))
    np.testing.assert_allclose(answers[:, :49, :, 1], np.broadcast_to([0, 0.4, 0.99], (len(takes), 49, 3)), atol=2e-3)
    assert not answers[:, 49, :, 1].any() and not answers[..., 2].any()
    ends = in_script(
        node,
        ["clock.js"],
        "data.map(({ take }) => [frameAt(take, endOf(take)), frameAt(take, secondsOf(take, 0) - 0.01)])",
        asked,
    )
    assert ends == [[{"frame": 49, "part": 0, "state": 1}, {"frame": 0, "part": 0, "state": -1}]] * len(takes)
