"""The page: one file without anything to load, whatever names hold; too much of it is refused with a way out."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motionkit.core.errors import MotionkitError
from motionkit.core.motion import Caption
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import rest_positions
from motionkit.viz.player import Panel, write_page
from tests.helpers.packed import unpack


def standing(name: str, num_frames: int, fps: int, **more: Any) -> Panel:
    """A body that moves a centimetre a frame."""
    path = np.arange(num_frames, dtype=np.float32)[:, None, None] * np.float32([0.01, 0, 0])
    return Panel(name, rest_positions(SMPL22)[None] + path, SMPL22, Fraction(fps), **more)


def page_data(path: Path) -> Any:
    """What a page holds."""
    found = re.findall(r'<script id="data" type="application/json">(.*?)</script>', path.read_text("utf-8"), re.DOTALL)
    return json.loads(found[0])


HOSTILE = '</script><b>&"__DATA__ __SCRIPTS__ \\1'


def test_a_page_holds_its_motions_and_loads_nothing(tmp_path: Path) -> None:
    seen = np.arange(40) % 3 > 0
    takes = [
        standing(HOSTILE, 40, 120, observed=seen, captions=(Caption("a & <b>", 0.0, 0.5),)),
        standing("slow", 20, 30, uneven_seconds=np.geomspace(1, 3, 20)),
    ]
    size = write_page(tmp_path / "page.html", HOSTILE, takes, note="<i>")
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]
    text = (tmp_path / "page.html").read_text("utf-8")
    assert len(text.encode()) == size
    data = page_data(tmp_path / "page.html")
    assert data["title"] == data["takes"][0]["name"] == HOSTILE and data["note"] == "<i>"
    for take, shown in zip(takes, data["takes"], strict=True):
        np.testing.assert_allclose(unpack(shown["positions"]), take.joint_positions, atol=5.1e-5)
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


def test_too_much_is_refused_with_a_stretch_that_fits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("motionkit.viz.player.MOST_PAGE_BYTES", 100_000)
    take = standing("long", 6000, 60)
    with pytest.raises(MotionkitError, match=r"100 s of the longest.*--from 0 --to \d+") as states:
        write_page(tmp_path / "page.html", "long", [take])
    seconds = int(re.findall(r"--to (\d+)", str(states.value))[0])
    write_page(tmp_path / "page.html", "long", [take.frames(0, 60 * seconds)])
    (shown,) = page_data(tmp_path / "page.html")["takes"]
    assert len(shown["positions"]["steps"]) > 50_000


def test_a_body_that_is_nowhere_is_reported_by_name(tmp_path: Path) -> None:
    far = standing("far.bvh", 2, 30)
    far = replace(far, joint_positions=far.joint_positions * np.float32(1e6))
    with pytest.raises(MotionkitError, match=r"far\.bvh: a joint is not within .* unit"):
        write_page(tmp_path / "page.html", "far", [far])
    assert not list(tmp_path.iterdir())


# What a person does, one thing after the other, and what the page says then.
ACTS = """
<script>
const press = (key, more) =>
  document.body.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true, ...more }));
const canvas = document.querySelector(".stage canvas"), line = document.getElementById("timeline");
const point = (target, type, id, x, y) =>
  target.dispatchEvent(new PointerEvent(type, { pointerId: id, clientX: x, clientY: y, buttons: 1, bubbles: true }));
const states = {}, say = (name) => { show(); states[name] = [find("frame").value, seconds, { ...view }]; };
say("opened");
press("ArrowRight"); say("on"); press("ArrowLeft", { shiftKey: true }); say("ten back"); press("End"); say("end");
mark(1); press("Home"); press("ArrowRight"); say("slow on");
press("c"); press("t"); press("i"); press("f"); say("switched");
const box = line.getBoundingClientRect();
point(line, "pointerdown", 1, box.left + box.width / 2, box.top + 5); say("scrubbed");
point(canvas, "pointerdown", 1, 50, 50); point(canvas, "pointermove", 1, 80, 50); say("turned");
point(canvas, "pointerdown", 2, 180, 50); point(canvas, "pointermove", 2, 280, 50); say("pinched");
point(canvas, "pointerup", 1, 80, 50); point(canvas, "pointerup", 2, 280, 50);
press("r"); say("reset");
const words = () => [...document.querySelectorAll(".state")].map((each) => each.textContent);
seek(0.55); press("l"); show(); states.looped = words(); press("l"); say("not looped");
seek(states.scrubbed[1]); show();
document.body.append(Object.assign(document.createElement("pre"), { textContent: JSON.stringify(states) }));
</script>
"""


def test_a_browser_shows_the_frame_of_the_address_and_follows_messages(tmp_path: Path) -> None:
    """Motions at 120 and 30 fps at 0.5 s: the frames 60 and 15 of their own; then keys, mouse and two fingers."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("needs Chromium, to open the page")
    page = tmp_path / "page.html"
    write_page(
        page, "two", [standing("fast", 120, 120), standing("slow", 40, 30, first_frame=7), standing("short", 3, 30)]
    )
    page.write_text(page.read_text("utf-8").replace("</body>", f"{ACTS}</body>"), encoding="utf-8")
    flags = ("--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}")
    command = [browser, *flags, "--virtual-time-budget=1000", "--dump-dom", f"{page.as_uri()}#t=0.5"]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    if ran.returncode:
        pytest.skip(f"this browser does not start here: {ran.stderr[-200:]}")
    states = json.loads(re.findall(r"<pre>(.*?)</pre>", ran.stdout, re.DOTALL)[0])
    # The short one, of a tenth of a second, is in the middle of its sixth time.
    assert [words.partition(" +")[0] for words in states.pop("looped")] == ["frame 66", "frame 23", "frame 1"]
    frames = {name: int(each[0]) for name, each in states.items()}
    assert [frames[name] for name in ("opened", "on", "ten back", "end", "slow on")] == [60, 61, 51, 119, 8]
    assert states["scrubbed"][1] == pytest.approx(2 / 3, abs=1e-3) and frames["scrubbed"] == 7 + 20
    assert states["turned"][2]["yaw"] == pytest.approx(states["opened"][2]["yaw"] - 0.3)
    assert states["pinched"][2]["zoom"] == pytest.approx(2.0) and states["pinched"][2]["right"] > 0
    assert states["reset"][2] == states["opened"][2]
    assert re.findall(r'<span class="state[^"]*">([^<]*)</span>', ran.stdout) == [
        *("frame 80", "frame 27", "is over · frame 2"),
    ]
