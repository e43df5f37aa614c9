"""A study from folders to shares: what is drawn, what the page gives away, what answers come to."""

import json
import re
from collections import Counter
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from eval.commands.study import STUDY
from eval.sets.sets import Missing
from eval.study.trials import (
    ANSWERS_FORMAT,
    CONSISTENT,
    KEY_FORMAT,
    REALISTIC,
    StudyError,
    System,
    draw_trials,
    preferences,
    read_key,
    study_of,
)
from motionkit.core.files import write_json
from tests.helpers.analytic import analytic_motion


def system(name: str, captions: tuple[str, ...], fastest: tuple[Fraction, ...] | None = None) -> System:
    ids = tuple(f"{name}/{number}" for number in range(len(captions)))

    def positions(index: int, fps: Fraction) -> np.ndarray:
        return np.zeros((int(fps), 22, 3), dtype=np.float32)

    return System(name, ids, captions, (1.0,) * len(captions), positions, fastest)


TRIAL = {"question": REALISTIC, "fps": "20", "systems": ["theirs", "ours"]}
KEY = {"format": KEY_FORMAT, "study": "s", "systems": ["ours", "theirs", "others"], "trials": [TRIAL]}
CAPTIONS = tuple(f"a person does thing {number}" for number in range(40))
RATES = (Fraction(20), Fraction(120))


def test_pairs_answer_one_caption_and_sides_are_even() -> None:
    ours, theirs = system("ours", CAPTIONS), system("theirs", tuple(each.upper() for each in reversed(CAPTIONS[:36])))
    missing = Missing()
    drawn = draw_trials([ours, theirs], RATES, 8, 3, missing)
    assert not missing.lines and drawn == draw_trials([ours, theirs], RATES, 8, 3, missing)
    assert drawn != draw_trials([ours, theirs], RATES, 8, 4, missing)
    systems = (ours, theirs)
    for trial in drawn:
        one, two = (systems[place].captions[motion] for place, motion in zip(trial.systems, trial.motions, strict=True))
        assert one.casefold() == two.casefold() == trial.caption
    # 32 captions for 32 questions: none twice, and ours is A in half of each kind.
    assert len({trial.caption for trial in drawn}) == 32
    kinds = Counter((trial.question, trial.fps, trial.systems) for trial in drawn)
    assert len(kinds) == 8 and set(kinds.values()) == {4}


def test_slow_captures_and_missing_captions_leave_questions_out() -> None:
    real = system("real motion", CAPTIONS, (Fraction(30),) * 40)
    mute = system("mute", ("",) * 5)
    missing = Missing()
    drawn = draw_trials([system("ours", CAPTIONS), real, mute], RATES, 2, 0, missing)
    of_real = [trial for trial in drawn if 1 in trial.systems]
    assert {(trial.question, trial.fps) for trial in of_real} == {(REALISTIC, Fraction(20)), (CONSISTENT, Fraction(20))}
    assert {trial.question for trial in drawn if 2 in trial.systems} == {REALISTIC}
    assert any("0 pairs of motions at 120 fps" in line for line in missing.lines)
    assert any("no captions" in line for line in missing.lines)


def test_shares_have_wilsons_interval_and_the_binomial_test() -> None:
    """10 of 16: Wilson's interval and the two-sided p by their formulas, computed by hand."""
    high = [{"question": REALISTIC, "fps": fps, "systems": ["ours", "theirs"]} for fps in ("60", "120")]
    key = KEY | {"trials": [*[TRIAL] * 16, *high]}
    answers = {number: "b" if number < 10 else "a" for number in range(16)}
    found = preferences(key, [answers, {16: "a", 17: "b"}])
    assert [(each.fps, each.num_first, each.num_answers) for each in found] == [
        ("20", 10, 16),
        ("60", 1, 1),
        ("120", 0, 1),
        ("60 to 120", 1, 2),
    ]
    assert (found[0].share, found[0].low, found[0].high) == pytest.approx((0.625, 0.3864, 0.8152), abs=1e-4)
    assert found[0].p_value == pytest.approx(0.4545, abs=1e-4)


def folders(tmp_path: Path) -> list[str]:
    options = []
    for name, fps in (("ours", 60), ("theirs", 20)):
        (tmp_path / name).mkdir()
        for action in ("walk", "bow"):
            joints = analytic_motion(action, 2.0).query(np.arange(fps) / fps).joint_positions
            np.savez(tmp_path / name / f"{action}.npz", joint_positions=joints, fps=fps, captions=[f"to {action}"])
        options += ["--samples", f"{name}={tmp_path / name}"]
    return options


def test_from_folders_to_a_table(tmp_path: Path) -> None:
    run = CliRunner().invoke
    page, key = tmp_path / "s.html", tmp_path / "s.key.json"
    wanted = ["make", *folders(tmp_path), "--cases", "1", "--fps", "20,60", "--out", str(page)]
    assert run(STUDY, wanted, catch_exceptions=False).exit_code == 0
    text = page.read_text(encoding="utf-8")
    assert "ours" not in re.sub(r"[Cc]olours", "", text) and "theirs" not in text and "walk.npz" not in text
    shown = json.loads(re.findall(r'<script id="study" type="application/json">(.*?)</script>', text, re.DOTALL)[0])
    trials = json.loads(key.read_text())["trials"]
    assert [each["question"] for each in shown["trials"]] == [each["question"] for each in trials]
    assert {take["name"] for each in shown["trials"] for take in each["player"]["takes"]} == {"A", "B"}
    # Somebody who always prefers ours, somebody whose file is of another study, and a file that was cut off.
    answers = {"format": ANSWERS_FORMAT, "study": shown["study"], "participant": "p"}
    given = [{"trial": n, "choice": "ab"[each["systems"].index("ours")]} for n, each in enumerate(trials)]
    paths = [tmp_path / f"{name}.json" for name in ("good", "foreign", "cut", "odd")]
    paths[0].write_text(json.dumps({**answers, "answers": given}))
    paths[1].write_text(json.dumps({**answers, "study": "other", "answers": given}))
    paths[2].write_text(paths[0].read_text()[:-9])
    paths[3].write_text(json.dumps({**answers, "answers": [{"trial": 99, "choice": "a"}]}))
    ran = run(STUDY, ["score", *map(str, paths), "--key", str(key), "--json"])
    found = json.loads(ran.stdout)
    assert ran.exit_code == 1 and found["people"] == 1
    assert [each["share"] for each in found["preferences"]] == [1.0] * 4
    for path, reason in zip(paths[1:], ("of another study", "is damaged", "damaged answers"), strict=True):
        assert [line for line in ran.stderr.splitlines() if path.name in line and reason in line], ran.stderr


@pytest.mark.parametrize(
    "change", [{"systems": ["ours"]}, {"trials": None}, {"format": "other"}, {"study": "s"}], ids=repr
)
def test_a_changed_key_is_one_error_that_names_the_file(tmp_path: Path, change: dict[str, object]) -> None:
    path, content = tmp_path / "key.json", {name: value for name, value in KEY.items() if name != "study"}
    whole = {**content, "study": study_of(content)}
    write_json(path, whole)
    assert read_key(path) == whole
    write_json(path, whole | change)
    with pytest.raises(StudyError, match="not a valid key"):
        read_key(path)
