"""Preferences of people: their answers, read with the key, as shares with intervals."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from eval.sets.sets import Missing
from eval.study.trials import ANSWERS_FORMAT, KEY_FORMAT, QUESTIONS
from motionkit.core.errors import MotionkitError, shown
from motionkit.core.files import read_json
from motionkit.core.timegrid import parse_fps

RESTORE = "restore it from a copy, without it the sides are unknown"
SIDES = {"a": 0, "b": 1}


class StudyError(MotionkitError):
    """A key or answers that cannot be used."""


@dataclass(frozen=True)
class Preference:
    """How often `first` was preferred to `second`: a share with its 95 % Wilson interval and a binomial test of 1/2."""

    question: str
    first: str
    second: str
    fps: str
    num_answers: int
    num_first: int
    share: float
    low: float
    high: float
    p_value: float


def read_key(path: Path) -> dict[str, Any]:
    """Read the key that `write_study` wrote; raises `DamagedFileError`, or `StudyError` for another file."""
    key = read_json(path, RESTORE)
    try:
        if key["format"] != KEY_FORMAT or not isinstance(key["study"], str):
            raise ValueError(f"format {key['format']}")
        first, *others = key["systems"]
        for number, trial in enumerate(key["trials"]):
            pair = {*trial["systems"]}
            parse_fps(trial["fps"])
            if trial["question"] not in QUESTIONS or first not in pair or len(pair & {first, *others}) != 2:
                raise ValueError(f"trial {number} is no question about {first} and another system")
        return key
    except (LookupError, TypeError, ValueError) as error:
        raise StudyError(f"{path}: not a valid key of a study ({shown(repr(error))}): {RESTORE}") from None


def read_answers(paths: Iterable[Path], key: Mapping[str, Any], missing: Missing) -> dict[str, dict[int, str]]:
    """Each participant's choices ("a" or "b") by trial; the problems of other files are added to `missing`.

    A participant counts once.
    """
    answers: dict[str, dict[int, str]] = {}
    for path in paths:
        try:
            participant, choices = _answers(path, key)
        except (MotionkitError, OSError) as error:
            missing.add(str(error))
            continue
        if participant in answers:
            missing.add(f"{path}: the answers of participant {participant} are in another file already")
        else:
            answers[participant] = choices
    return answers


def _answers(path: Path, key: Mapping[str, Any]) -> tuple[str, dict[int, str]]:
    document = read_json(path, "ask for the file again")
    if document.get("format") != ANSWERS_FORMAT or document.get("study") != key["study"]:
        other = shown(str(document.get("study")))
        raise StudyError(f"{path}: not answers of study {key['study']}, but of another study or of none ({other})")
    try:
        answers = [(each["trial"], each["choice"]) for each in document["answers"] if each is not None]
        choices = dict(answers)
        if len(choices) < len(answers):
            raise ValueError("a question is answered twice")
        for trial, choice in answers:
            if type(trial) is not int or not 0 <= trial < len(key["trials"]) or choice not in SIDES:
                raise ValueError(f"{shown(str(choice))} to question {shown(str(trial))} of {len(key['trials'])}")
        return shown(str(document["participant"])), choices
    except (KeyError, TypeError, ValueError) as error:
        raise StudyError(f"{path}: damaged answers ({error}): ask for the file again") from None


def preferences(key: Mapping[str, Any], answers: Iterable[Mapping[int, str]]) -> list[Preference]:
    """For each question and pair of systems, the preference for the study's first one, at each framerate.

    With three or more framerates, also for all above the lowest together. Answers are treated as independent.
    """
    first, wins = key["systems"][0], dict[tuple[str, str], dict[Fraction, list[bool]]]()
    for choices in answers:
        for number, choice in choices.items():
            trial = key["trials"][number]
            (second,) = (name for name in trial["systems"] if name != first)
            by_fps = wins.setdefault((trial["question"], second), {})
            by_fps.setdefault(parse_fps(trial["fps"]), []).append(trial["systems"][SIDES[choice]] == first)
    found = []
    for question, second in sorted(wins, key=lambda each: (list(QUESTIONS).index(each[0]), each[1])):
        by_fps = dict(sorted(wins[question, second].items()))
        columns = {f"{float(fps):g}": won for fps, won in by_fps.items()}
        if len(by_fps) > 2:
            above = list(by_fps)[1:]
            columns[f"{float(above[0]):g} to {float(above[-1]):g}"] = [won for fps in above for won in by_fps[fps]]
        for fps, won in columns.items():
            test = binomtest(sum(won), len(won))
            interval = test.proportion_ci(method="wilson")
            shares = sum(won) / len(won), float(interval.low), float(interval.high), float(test.pvalue)
            found.append(Preference(question, first, second, fps, len(won), sum(won), *shares))
    return found
