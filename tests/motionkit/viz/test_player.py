"""The player's page: bodies as text and back, the script, hostile names; `view` and what notebooks show."""

import dataclasses
import html
import re
import webbrowser
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import motionkit as mk
from motionkit.core.kinematics import quaternion_rotate
from motionkit.core.skeletons.mapping import rest_positions
from motionkit.edit.export import render
from motionkit.edit.motions import MotionSource
from motionkit.fields.motion_field import to_motion
from motionkit.store.reports import summarise
from motionkit.viz.player import Packed, Panel, drawing_of, pack, page_of
from motionkit.viz.view import MOST_NOTEBOOK_BYTES, spread
from tests.helpers.analytic import analytic_motion
from tests.helpers.packed import HALF_STEP, in_script, page_data, unpack
from tests.helpers.tiny import write_store


def test_bones_sides_and_ends_of_the_22_joints() -> None:
    drawing = drawing_of(mk.SMPL22, rest_positions(mk.SMPL22)[None])
    assert drawing.bones == mk.SMPL22.parents
    assert [mk.SMPL22.joint_names[joint] for joint in drawing.ends] == [
        *("left_foot", "right_foot", "left_wrist", "right_wrist")
    ]
    sides = {"left": -1, "right": 1}
    assert drawing.sides == tuple(sides.get(name.split("_")[0], 0) for name in mk.SMPL22.joint_names)
    assert mk.SMPL22.joint_names[drawing.head] == "head"


@pytest.mark.parametrize("turned", [-2.5, -0.4, 0.0, 1.2, 3.0])
@pytest.mark.parametrize("skeleton", [mk.SMPL22, mk.KIT21])
def test_the_front_is_where_the_body_was_turned_to(skeleton: mk.Skeleton, turned: float) -> None:
    turn = np.array([np.cos(turned / 2), 0, np.sin(turned / 2), 0], np.float32)
    positions = rest_positions(skeleton)
    drawing = drawing_of(skeleton, quaternion_rotate(np.broadcast_to(turn, (len(positions), 4)), positions)[None])
    # KIT's hips are at the other side of X: its bodies face Z- at rest.
    faces = turned if skeleton is mk.SMPL22 else turned + np.pi
    np.testing.assert_allclose(np.exp(1j * drawing.yaw), np.exp(1j * faces), atol=1e-2)


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


def test_the_script_unpacks_the_same() -> None:
    examples: list[Packed] = []

    @settings(max_examples=60)
    @given(bodies())
    def collect(positions: np.ndarray) -> None:
        examples.append(pack(positions))

    collect()
    answer = in_script(["packing.js"], "data.map((each) => Array.from(unpack(each)))", examples)
    assert isinstance(answer, list) and len(answer) == len(examples)
    for numbers, packed in zip(answer, examples, strict=True):
        np.testing.assert_allclose(np.float32(numbers), unpack(packed).ravel(), rtol=1e-6)


def test_a_frame_is_held_until_the_next() -> None:
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
    beyond = "data.map(({ take }) => [frameAt(take, endOf(take)), frameAt(take, secondsOf(take, 0) - 0.01)])"
    ends = in_script(["clock.js"], beyond, asked)
    assert ends == [[{"frame": 49, "part": 0, "state": 1}, {"frame": 0, "part": 0, "state": -1}]] * len(takes)


def standing(name: str, num_frames: int, fps: int, **more: Any) -> Panel:
    """A body that moves a centimetre a frame."""
    path = np.arange(num_frames, dtype=np.float32)[:, None, None] * np.float32([0.01, 0, 0])
    return Panel(name, rest_positions(mk.SMPL22)[None] + path, mk.SMPL22, Fraction(fps), **more)


HOSTILE = '</script><b>&"__DATA__ __SCRIPTS__ \\1'


def test_a_page_holds_its_motions_and_loads_nothing() -> None:
    seen = np.arange(40) % 3 > 0
    takes = [
        standing(HOSTILE, 40, 120, observed=seen, captions=(mk.Caption("a & <b>", 0.0, 0.5),)),
        standing("slow", 20, 30, uneven_seconds=np.geomspace(1, 3, 20)),
    ]
    text = page_of(HOSTILE, takes, note="<i>")
    data = page_data(text)
    assert data["title"] == data["takes"][0]["name"] == HOSTILE and data["note"] == "<i>"
    for take, shown in zip(takes, data["takes"], strict=True):
        np.testing.assert_allclose(unpack(shown["positions"]), take.joint_positions, atol=HALF_STEP)
        assert Fraction(*shown["fps"]) == take.fps and shown["numFrames"] == take.num_frames
    assert not re.findall(r"""(?:src|href)\s*=|https?://|@import|\burl\(|\bimport\(|\bfetch\(""", text)


def test_frames_of_a_take_keep_their_numbers_and_times() -> None:
    take = standing("walk", 100, 50, start_seconds=1.0, observed=np.arange(100) < 60)
    part = take.frames(25, 75).frames(5, 40)
    assert part.first_frame == 30 and part.num_frames == 35 and part.start_seconds == pytest.approx(1.6)
    assert part.observed is not None and part.observed.sum() == 30
    np.testing.assert_allclose(part.frame_seconds(), take.frame_seconds()[30:65])
    uneven = replace(take, uneven_seconds=np.geomspace(1, 9, 100)).frames(30, 65)
    np.testing.assert_array_equal(uneven.frame_seconds(), np.geomspace(1, 9, 100)[30:65])


def test_too_much_is_refused_with_a_stretch_that_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("motionkit.viz.player.MOST_PAGE_BYTES", 100_000)
    take = standing("long", 6000, 60)
    with pytest.raises(mk.MotionkitError, match=r"--from 0 --to \d+") as states:
        page_of("long", [take])
    seconds = int(re.findall(r"--to (\d+)", str(states.value))[0])
    (shown,) = page_data(page_of("long", [take.frames(0, 60 * seconds)]))["takes"]
    assert len(shown["positions"]["steps"]) > 50_000


@pytest.fixture(scope="module")
def motion() -> mk.Motion:
    """Two seconds of a walk at 30 fps."""
    return to_motion(analytic_motion("walk", 2.0), Fraction(30))


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Pages are written where one is."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def takes_of(page: str) -> list[dict[str, Any]]:
    takes: list[dict[str, Any]] = page_data(page)["takes"]
    return takes


def test_motions_and_files_side_by_side(motion: mk.Motion) -> None:
    motion.save("walk.npz")
    path = mk.view(motion[0.5:1.0], "walk.npz", Path("walk.npz"), path="pages/all.html")
    assert path == Path("pages/all.html")
    part, *whole = takes_of(path.read_text("utf-8"))
    np.testing.assert_allclose(unpack(part["positions"]), motion.joint_positions[15:30], atol=HALF_STEP)
    assert part["startSeconds"] == 0.5 and part["numFrames"] == 15
    assert [take["numFrames"] for take in whole] == [61, 61]


def test_it_is_called_by_what_it_shows_and_opened_if_asked(motion: mk.Motion, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    motion.save("walk.npz")
    assert mk.view("walk.npz") == Path("walk.view.html")
    assert mk.view(mk.read("walk.npz")).name == f"{Path.cwd().name}_walk.view.html"
    assert mk.view(motion) == mk.view(motion, motion.resample(10), path=".").with_name("motion.view.html")
    assert mk.view("walk.npz", motion).name == "walk-and-1-more.view.html"
    odd = dataclasses.replace(motion, sequence_id="a\0b\x1b[31m")
    assert mk.view(odd).name == r"a\x00b\x1b[31m.view.html" and not opened
    path = mk.view(motion, open=True)
    assert opened == [path.absolute().as_uri()]


def test_what_cannot_be_shown_is_reported(motion: mk.Motion) -> None:
    far = mk.Motion.from_joints(np.full((3, 22, 3), 1e7), 30)
    with pytest.raises(mk.MotionkitError, match="unit"):
        mk.view(far)
    with pytest.warns(UserWarning, match="unit"):
        assert len(takes_of(mk.view(far, motion).read_text("utf-8"))) == 1
    for motions in ((), (motion,) * 25):
        with pytest.raises(mk.UsageError, match="1 to 24"):
            mk.view(*motions)
    with pytest.raises(mk.UsageError, match="nowhere"):
        mk.view("nowhere.bvh")


def inside(shown: str) -> str:
    """The page in the frame of a notebook's view."""
    found = re.fullmatch(r'<iframe title=".*?" srcdoc="([^"]*)" sandbox="allow-scripts" style="[^"]*"></iframe>', shown)
    assert found is not None
    return html.unescape(found[1])


def test_a_notebook_shows_the_player_and_texts_of_strangers_stay_inside(motion: mk.Motion) -> None:
    wild = '"></iframe><script>alert(1)</script>&quot;'
    shown = dataclasses.replace(motion, sequence_id=wild, captions=(mk.Caption(wild),))._repr_html_()
    assert shown.count("<iframe") == 1
    page = inside(shown)
    assert page.startswith("<!doctype html>") and page.endswith("</html>\n")
    (take,) = takes_of(page)
    assert take["captions"][0][0] == wild
    np.testing.assert_allclose(unpack(take["positions"]), motion.joint_positions, atol=HALF_STEP)


def test_a_long_motion_is_shown_in_part(motion: mk.Motion) -> None:
    long = mk.Motion.from_joints(np.tile(motion.joint_positions, (400, 1, 1)), 60)
    shown = long._repr_html_()
    assert 0.8 * MOST_NOTEBOOK_BYTES < len(shown) < 1.1 * MOST_NOTEBOOK_BYTES
    page = inside(shown)
    (take,) = takes_of(page)
    assert 5_000 < take["numFrames"] < long.num_frames


def test_every_count_is_drawn_and_a_strangers_names_are_text(tmp_path: Path) -> None:
    write_store(tmp_path / "<b>store")
    summary = summarise(mk.Store.open(tmp_path / "<b>store"))
    (source,) = summary["sources"]
    article = render("corpus_card.html.j2", summary=summary).strip()
    assert "<b>store" not in article and "&lt;b&gt;store" in article and "src=" not in article and "http" not in article
    items = [[text for text in each.itertext() if text.strip()] for each in ElementTree.fromstring(article).iter("li")]
    for counts in (source[name] for name in ("framerates", "durations", "splits", "formats")):
        drawn = [[name or "not stated", f"{count:,}"] for name, count in counts.items()]
        assert drawn and [each for each in drawn if each not in items] == []
    assert sum(source["durations"].values()) == source["num_sequences"]
    assert article.startswith("<article") and "<html" not in article


def test_panels_of_a_store_are_unlike_each_other_and_those_of_files_the_first() -> None:
    kinds = [("30.0", "a", "walk")] * 5 + [("30.0", "a", "run"), ("120.0", "b", "walk"), ("30.0", "b", "sit")]
    still = mk.Motion.from_joints(np.zeros((3, 22, 3)), 30)
    sources = [replace(MotionSource.of(still), name=str(number), kind=kind) for number, kind in enumerate(kinds)]
    assert [source.name for source in spread(sources, 3)] == ["0", "5", "6"]
    assert spread(sources, 8) == sources == spread(sources, 20)
    files = [replace(source, kind=()) for source in sources]
    assert spread(files, 3) == files[:3]
