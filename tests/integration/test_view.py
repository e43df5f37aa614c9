"""`motionkit view`, file to page: every kind of motion, stretches, limits, what is told when nothing is shown."""

import json
import shlex
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import motionkit as mk
from motionkit.features import humanml3d
from motionkit.features.humanml3d import process
from motionkit.fields.motion_field import to_motion
from motionkit.io.bvh import read_bvh, write_bvh
from motionkit.io.humanml3d import Entry
from motionkit.io.npz import write_npz
from tests.helpers.analytic import analytic_motion
from tests.helpers.every_format import write_pose_folder
from tests.helpers.outcome import Outcome
from tests.helpers.packed import HALF_STEP, in_script, page_data, unpack

Run = Callable[..., Outcome]


@pytest.fixture(scope="module")
def motion() -> mk.Motion:
    """Two seconds of a walk at 30 fps, with rotations."""
    walked = to_motion(analytic_motion("walk", 2.0), Fraction(30))
    captions = (mk.Caption("a person walks", 0.0, 1.0), mk.Caption("on"))
    return replace(walked.frames(0, 60), sequence_id="set/walk", captions=captions, action="walk")


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Pages are written where one is."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def takes_of(outcome: Outcome) -> list[dict[str, Any]]:
    """What the page holds that a call has written."""
    assert outcome.code == 0, outcome.stderr
    takes: list[dict[str, Any]] = page_data(Path(outcome.stdout.strip()).read_text("utf-8"))["takes"]
    return takes


def test_a_bvh_file_at_its_own_framerate(motionkit: Run, motion: mk.Motion) -> None:
    write_bvh(motion, Path("walk.bvh"))
    outcome = motionkit("view", "walk.bvh")
    assert outcome.stdout == "walk.view.html\n" and outcome.stderr == ""
    (take,) = takes_of(outcome)
    np.testing.assert_allclose(unpack(take["positions"]), read_bvh(Path("walk.bvh")).joint_positions, atol=HALF_STEP)
    assert take["name"] == "walk.bvh" and take["fps"] == [30, 1] and take["numFrames"] == 60
    again = motionkit("view", "walk.bvh")
    assert again.code == 2 and "--overwrite" in again.stderr and again.stdout == ""
    assert motionkit("view", "walk.bvh", "--overwrite").code == 0


def test_many_kinds_side_by_side_each_on_its_own_frames(motionkit: Run, motion: mk.Motion) -> None:
    write_npz(motion, Path("walk.npz"))
    np.save("joints.npy", motion.joint_positions)
    vectors = humanml3d.vectors(process(motion.joint_positions, "smpl22"), "smpl22")
    np.save("vectors.npy", vectors)
    told = motionkit("view", "joints.npy", "--fps", "60000/1001", "--out", "one.html")
    assert takes_of(told)[0]["fps"] == [60000, 1001]
    with mk.StoreWriter.create(Path("store")) as writer:
        writer.add(motion)
    outcome = motionkit("view", "walk.npz", "vectors.npy", "set/walk", "--out", "pages/all.html", "--json")
    report = json.loads(outcome.stdout)
    assert report["page"] == "pages/all.html" and report["failed"] == []
    assert report["bytes"] == Path("pages/all.html").stat().st_size
    assert [(each["name"], each["fps"], each["num_frames"]) for each in report["motions"]] == [
        ("walk.npz", "30", 60),
        ("vectors.npy", "20", 59),
        ("set/walk", "30", 60),
    ]
    walk, of_vectors, stored = takes_of(motionkit("view", "walk.npz", "vectors.npy", "set/walk", "--out", "b.html"))
    for take in (walk, stored):
        np.testing.assert_allclose(unpack(take["positions"]), motion.joint_positions, atol=HALF_STEP)
        assert take["captions"] == [["a person walks", 0.0, 1.0], ["on", 0.0, None]] and "walk" in take["labels"]
    np.testing.assert_allclose(unpack(of_vectors["positions"]), humanml3d.positions(vectors, "smpl22"), atol=1e-4)


def test_folders_one_bad_file_costs_nothing_of_the_others(motionkit: Run, motion: mk.Motion) -> None:
    vectors = humanml3d.vectors(process(motion.joint_positions, "smpl22"), "smpl22")
    entry = Entry("000001", humanml3d.positions(vectors, "smpl22"), vectors)
    write_pose_folder(Path("takes/set"), [entry])
    write_bvh(motion, Path("takes/a.bvh"))
    write_bvh(motion, Path("takes/b.bvh"))
    Path("takes/c.bvh").write_text(Path("takes/a.bvh").read_text("utf-8")[:-400], encoding="utf-8")
    # A table above says what a single file below is.
    Path("clips.csv").write_text("file,caption\ntakes/b.bvh,somebody walks\n", encoding="utf-8")
    outcome = motionkit("view", "takes", "--json")
    report = json.loads(outcome.stdout)
    assert outcome.code == 1 and "the file ends" in outcome.stderr
    assert [Path(each["clip"]).name for each in report["failed"]] == ["c.bvh"]
    assert sorted(each["name"] for each in report["motions"]) == ["000001.npy", "a.bvh", "b.bvh"]
    (take,) = takes_of(motionkit("view", "takes/b.bvh"))
    assert take["captions"] == [["somebody walks", 0.0, None]]
    # What the data set says of its motions is true of one of its folders too.
    for name in ("new_joints", "new_joint_vecs"):
        (take,) = takes_of(motionkit("view", f"takes/set/{name}", "--out", f"{name}.html"))
        assert take["fps"] == [20, 1] and take["name"] == "000001.npy"
    # Names that folders tell apart are told with them.
    Path("other").mkdir()
    Path("takes/a.bvh").rename("other/b.bvh")
    names = [take["name"] for take in takes_of(motionkit("view", "takes/b.bvh", "other/b.bvh"))]
    assert names == ["takes/b.bvh", "other/b.bvh"]


@pytest.mark.parametrize(
    ("arguments", "code", "told"),
    [
        ([], 2, "name motions"),
        (["none.bvh"], 2, "there is no file or folder none.bvh"),
        (["walk.npz", "--from", "2", "--to", "1"], 2, "ends before it begins"),
        (["walk.npz", "--unit-metres", "0"], 2, "positive number, not 0"),
        (["joints.npy"], 1, "framerate"),
        (["."], 1, "framerate"),
        (["notes.md"], 1, "of no known format"),
    ],
)
def test_what_cannot_be_shown_is_reported_in_a_line(motionkit, motion, arguments, code, told):
    if "." not in arguments:
        write_npz(motion, Path("walk.npz"))
    np.save("joints.npy", motion.joint_positions)
    Path("notes.md").write_text("# no motion\n", encoding="utf-8")
    outcome = motionkit("view", *arguments)
    assert outcome.code == code and outcome.stdout == "" and told in outcome.stderr.splitlines()[-1]
    assert not list(Path().glob("*.html"))


def test_films_and_strips(motionkit: Run, motion: mk.Motion, here: Path) -> None:
    write_npz(motion.frames(0, 6), here / "walk.npz")
    for options, name in ((("--format", "png"), "walk.png"), (("--out", "slow.gif", "--speed", 0.5), "slow.gif")):
        outcome = motionkit("view", "walk.npz", *options)
        assert (outcome.code, outcome.stdout.strip()) == (0, name), outcome.stderr
        assert (here / name).stat().st_size > 1000
    again = motionkit("view", "walk.npz", "--format", "png")
    assert again.code == 2 and "--overwrite replaces it" in again.stderr
    page = motionkit("view", "walk.npz", "--speed", 0.5)
    assert page.code == 2 and "goes with --format mp4 or gif" in page.stderr
    named = motionkit("view", "walk.npz", "--format", "gif", "--out", "film")
    assert named.code == 2 and "call it film.gif" in named.stderr


ODD = 'it\'s "<b>", walk'


@pytest.fixture
def cards(motionkit: Run, motion: mk.Motion) -> list[dict[str, Any]]:
    """A page of two motions of a folder `takes` in `store`; the name of one needs quotes everywhere."""
    for name in (ODD, "jump"):
        Path("takes").mkdir(exist_ok=True)
        write_npz(replace(motion, sequence_id="", captions=(mk.Caption(name),)), Path("takes") / f"{name}.npz")
    assert motionkit("ingest", "takes", "--store", "store").code == 0
    outcome = motionkit("view", "store", "--page", "corpus.html")
    assert outcome.code == 0 and outcome.stdout.startswith("corpus.html: 2 sequences"), outcome.stderr
    shown: list[dict[str, Any]] = page_data(Path("corpus.html").read_text("utf-8"))["cards"]
    return shown


def test_cards_hold_native_frames_and_are_drawn(cards: list[dict[str, Any]], motion: mk.Motion, motionkit: Run) -> None:
    for options, named in ((["--page", "again.html"], "--fps, --up"), ([], "stored sequences have theirs")):
        refused = motionkit("view", "store", *options, "--fps", 30, "--up", "z")
        assert refused.code == 2 and named in refused.stderr
    for card in cards:
        assert card["nativeFps"] == [30, 1] and card["fps"] == [10, 1] and card["numFrames"] == 20
        np.testing.assert_allclose(unpack(card["positions"]), motion.joint_positions[::3], atol=HALF_STEP)
    text = Path("corpus.html").read_text("utf-8")
    assert "<b>" not in text and "https://" not in text and " src=" not in text
    browser = shutil.which("chromium")
    if browser is None:
        pytest.skip("needs chromium, to run the page")
    options = ("--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=2000", "--dump-dom")
    address = Path("corpus.html").absolute().as_uri()
    ran = subprocess.run([browser, *options, address], capture_output=True, text=True, check=True)
    assert ran.stdout.count('class="card"') == 2 and "2 of 2 sequences" in ran.stdout and "&lt;b&gt;" in ran.stdout


def test_what_is_marked_is_read_by_ingest_and_split(motionkit: Run, cards: list[dict[str, Any]]) -> None:
    for text, number in (("JUMP person", 0), ("walk jump", 1), ("walk", 2)):
        fields = {"text": text, "fps": "30/1", "longest": "3"}
        assert sum(in_script(["marks.js"], "data[0].map((card) => isShown(card, data[1]))", [cards, fields])) == number
    marked = [card for card in cards if ODD in card["name"]] * 2
    ((source, table),) = in_script(["marks.js"], "tablesOf(data, 'split', 'val')", marked)
    Path("marked.csv").write_text(table, "utf-8")
    assert source == "takes" and table.count("\n") == 2
    outcome = motionkit("ingest", "takes", "--store", "store", "--captions", "marked.csv", "--overwrite")
    assert outcome.code == 0, outcome.stderr
    assert dict(mk.Store.open("store").sequences[["sequence_id", "split"]].to_numpy())[marked[0]["name"]] == "val"
    program, *words = shlex.split(in_script(["marks.js"], "splitCommand('store', 'test', data)", marked[:1]))
    assert program == "motionkit" and motionkit(*words).code == 0
    splits = dict(mk.Store.open("store").sequences[["sequence_id", "split"]].to_numpy())
    assert [splits[card["name"]] for card in cards] == ["test" if card in marked else "" for card in cards]
