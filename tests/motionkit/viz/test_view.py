"""`view` and a notebook's view: the player's page of motions in memory and in files, small enough for a notebook."""

import dataclasses
import html
import json
import re
import webbrowser
from fractions import Fraction
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import motionkit as mk
from motionkit.fields.motion_field import to_motion
from motionkit.store.reader import Store
from motionkit.store.reports import summarise
from motionkit.viz.corpus_card import corpus_card
from motionkit.viz.view import MOST_NOTEBOOK_BYTES
from tests.helpers.analytic import analytic_motion
from tests.helpers.packed import unpack
from tests.helpers.tiny import write_store

HALF_STEP = 5.1e-5


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
    """What a page holds."""
    found = re.findall(r'<script id="data" type="application/json">(.*?)</script>', page, re.DOTALL)
    takes: list[dict[str, Any]] = json.loads(found[0])["takes"]
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
    summary = summarise(Store.open(tmp_path / "<b>store"))
    (source,) = summary.sources
    article = corpus_card(summary).strip()
    assert "<b>store" not in article and "&lt;b&gt;store" in article and "src=" not in article and "http" not in article
    items = [[text for text in each.itertext() if text.strip()] for each in ElementTree.fromstring(article).iter("li")]
    for counts in (source.framerates, source.durations, source.splits, source.formats):
        drawn = [[name or "not stated", f"{count:,}"] for name, count in counts.items()]
        assert drawn and [each for each in drawn if each not in items] == []
    assert sum(source.durations.values()) == source.num_sequences
    assert article.startswith("<article") and "<html" not in article
