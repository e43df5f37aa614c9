"""Preferences of people: their answers, read with the key, as shares with intervals."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from eval.sets.sets import Missing
from eval.study.draw import QUESTIONS
from eval.study.page import ANSWERS_FORMAT, KEY_FORMAT
from motionkit.core.errors import MotionkitError, shown
from motionkit.core.files import read_json
from motionkit.core.timegrid import parse_fps

RESTORE = "restore it from a copy, without it the sides are unknown"
ASK_AGAIN = "ask for the file again"
OTHER = {"a": 0, "b": 1}


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


@dataclass(frozen=True)
class KeyTrial:
    """A trial of a key: the names of the systems shown as A and B, one of which is the study's first."""

    question: str
    fps: Fraction
    systems: tuple[str, str]


@dataclass(frozen=True)
class Key:
    """A study's id, its first system, and its trials."""

    study: str
    first: str
    trials: tuple[KeyTrial, ...]


def read_key(path: Path) -> Key:
    """Read what `write_study` wrote.

    Raises `DamagedFileError` for a damaged file, and `StudyError` for one of another kind, or with a part that is
    missing or invalid.
    """
    document = read_json(path, RESTORE)
    if document.get("format") != KEY_FORMAT:
        raise StudyError(f"{path}: not the key of a study (format {shown(str(document.get('format')))})")
    try:
        systems = document["systems"]
        key = Key(document["study"], systems[0], tuple(map(_trial, document["trials"])))
        for number, trial in enumerate(key.trials):
            one, two = trial.systems
            is_known = trial.question in QUESTIONS and {one, two} <= set(systems)
            if not is_known or one == two or key.first not in (one, two):
                raise ValueError(f"trial {number}: expected a question of the study about its first system and another")
        return key
    except (LookupError, TypeError, ValueError) as error:
        raise StudyError(f"{path}: not a valid key ({shown(repr(error))}): {RESTORE}") from None


def _trial(trial: Mapping[str, Any]) -> KeyTrial:
    return KeyTrial(trial["question"], parse_fps(trial["fps"]), tuple(trial["systems"]))


def read_answers(paths: Iterable[Path], key: Key, missing: Missing) -> dict[str, dict[int, str]]:
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


def _answers(path: Path, key: Key) -> tuple[str, dict[int, str]]:
    document = read_json(path, ASK_AGAIN)
    if document.get("format") != ANSWERS_FORMAT:
        raise StudyError(f"{path}: not the answers of a study: the page's last button downloads these")
    if document.get("study") != key.study:
        other = shown(str(document.get("study")))
        raise StudyError(f"{path}: answers of another study, {other}; the key is of {key.study}")
    try:
        answers = [each for each in document["answers"] if each is not None]
        choices = {each["trial"]: each["choice"] for each in answers}
        if len(choices) < len(answers):
            raise ValueError("a question is answered twice")
        for trial, choice in choices.items():
            if type(trial) is not int or not 0 <= trial < len(key.trials) or choice not in OTHER:
                raise ValueError(f"{shown(str(choice))} to question {shown(str(trial))} of {len(key.trials)}")
        return shown(str(document["participant"])), choices
    except (KeyError, TypeError, ValueError) as error:
        raise StudyError(f"{path}: damaged answers ({error}): {ASK_AGAIN}") from None


def preferences(key: Key, answers: Iterable[Mapping[int, str]]) -> list[Preference]:
    """For each question and pair of systems, the preference for the study's first one, at each framerate.

    With three or more framerates, also for all above the lowest together. Answers are treated as independent.
    """
    wins: dict[tuple[str, str], dict[Fraction, list[bool]]] = {}
    for choices in answers:
        for number, choice in choices.items():
            trial = key.trials[number]
            chosen = trial.systems[OTHER[choice]]
            (second,) = [name for name in trial.systems if name != key.first]
            by_fps = wins.setdefault((trial.question, second), {})
            by_fps.setdefault(trial.fps, []).append(chosen == key.first)
    return [
        _preference(question, key.first, second, fps, won)
        for (question, second) in sorted(wins, key=lambda each: (list(QUESTIONS).index(each[0]), each[1]))
        for fps, won in _columns(wins[question, second])
    ]


def _columns(by_fps: Mapping[Fraction, list[bool]]) -> Iterator[tuple[str, list[bool]]]:
    rates = sorted(by_fps)
    for fps in rates:
        yield f"{float(fps):g}", by_fps[fps]
    if len(rates) > 2:
        yield f"{float(rates[1]):g} to {float(rates[-1]):g}", [won for fps in rates[1:] for won in by_fps[fps]]


def _preference(question: str, first: str, second: str, fps: str, won: list[bool]) -> Preference:
    test = binomtest(sum(won), len(won))
    interval = test.proportion_ci(method="wilson")
    share, bounds = sum(won) / len(won), (float(interval.low), float(interval.high))
    return Preference(question, first, second, fps, len(won), sum(won), share, *bounds, float(test.pvalue))
