"""The pairs of motions of a study, its blinded page, the key that tells the systems, and people's preferences."""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from eval.sample_folder import SampleFolder
from eval.sets.motions import RealMotion, at_framerate, is_unconditional
from eval.sets.sets import Missing, middle
from motionkit.core.errors import MotionkitError, UsageError, counted, shown
from motionkit.core.files import read_json, write_json, write_whole
from motionkit.core.progress import OnProgress, task
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import parse_fps
from motionkit.fields.contact.planted import planted
from motionkit.fields.motion_field import to_motion
from motionkit.generate.models import GenerationRequest, GenerativeModel
from motionkit.viz.player import Panel, data_of, player

REALISTIC, CONSISTENT = "realistic", "consistent"
QUESTIONS = {
    REALISTIC: "Which of the two motions is more realistic?",
    CONSISTENT: "Which of the two motions is more consistent with the given text?",
}
"""The two questions of NeRM's study (appendix E.6)."""
KEY_FORMAT, ANSWERS_FORMAT = "motionkit-study-key/1", "motionkit-study-answers/1"
RESTORE = "restore it from a copy, without it the sides are unknown"
SIDES = {"a": 0, "b": 1}
Positions = Float32[np.ndarray, "frames 22 3"]


@dataclass(frozen=True, eq=False)
class System:
    """One system's motions: id, caption ("" for none), seconds and highest framerate of each.

    `positions(i, fps)` are motion i's 22 joints in metres, y up, at a framerate. `fastest` None is any framerate.
    """

    name: str
    motion_ids: tuple[str, ...]
    captions: tuple[str, ...]
    seconds: tuple[float, ...]
    positions: Callable[[int, Fraction], Positions]
    fastest: tuple[Fraction, ...] | None = None

    def has(self, index: int, fps: Fraction) -> bool:
        """Whether motion `index` is available at a framerate."""
        return self.fastest is None or self.fastest[index] >= fps


def of_motions(motions: SampleFolder | RealMotion) -> System:
    """Samples, upsampled by SLERP or anti-aliased as in tables; or real motion, up to the framerate of its capture."""

    def positions(index: int, fps: Fraction) -> Positions:
        return at_framerate(motions.sequences[index], motions.fps[index], fps)

    lengths = zip(motions.sequences.num_frames, motions.fps, strict=True)
    seconds = tuple(float(int(frames) / fps) for frames, fps in lengths)
    name, fastest = ("real motion", motions.fps) if isinstance(motions, RealMotion) else (motions.name, None)
    return System(name, motions.sequence_ids, motions.captions, seconds, positions, fastest)


def of_model(model: GenerativeModel, beside: Sequence[System], seed: int, longest_seconds: float) -> System:
    """A model's planted motions for the captions and lengths of other systems, as `motionkit generate` writes them."""
    longest = min(longest_seconds, model.max_duration_seconds)
    prompts: dict[str, float] = {}
    for system in beside:
        for caption, length in zip(system.captions, system.seconds, strict=True):
            prompts.setdefault(caption, length)
    prompts.pop("", None)
    pairs = list(prompts.items())
    if not prompts or is_unconditional(model):
        pairs = [("", length) for length in beside[0].seconds]
    requests = [GenerationRequest(min(length, longest), caption) for caption, length in pairs]

    def positions(index: int, fps: Fraction) -> Positions:
        (field,) = model.generate([requests[index]], seed=seed, first=index)
        return to_motion(planted(field, "free"), fps).joint_positions

    ids = tuple(f"{model.name}#{number}" for number in range(len(requests)))
    captions, seconds = tuple(each.text for each in requests), tuple(each.duration_seconds or 0.0 for each in requests)
    return System(model.name, ids, captions, seconds, positions)


@dataclass(frozen=True)
class Trial:
    """One question about two motions: indices of two systems and of a motion of each; A shows the first."""

    question: str
    fps: Fraction
    caption: str
    systems: tuple[int, int]
    motions: tuple[int, int]


def draw_trials(
    systems: Sequence[System], rates: Sequence[Fraction], cases: int, seed: int, missing: Missing
) -> tuple[Trial, ...]:
    """Trials of the first system against each of the others, in random order with balanced sides.

    `cases` are those of each question, framerate and pair of systems. Two motions share a caption; if one of the
    systems has no captions, they are any two, without the question about the text. What is left out is added to
    `missing`. Raises `UsageError` for fewer than two systems or two of one name, `MotionkitError` without any pair.
    """
    names = [system.name for system in systems]
    if len(names) < 2 or len(set(names)) < len(names):
        named = ", ".join(names) or "none"
        raise UsageError(
            f"a study compares systems of different names, not {named}: --samples NAME=DIR, --run, --store"
        )
    rng, first = np.random.default_rng(seed), systems[0]
    trials: list[Trial] = []
    for other, second in enumerate(systems[1:], start=1):
        label = f"{first.name} and {second.name}"
        captioned = any(first.captions) and any(second.captions)
        if not captioned:
            missing.add(f"{label}: one of them has no captions: the question about the text is left out")
        pairs = _pairs(first, second, captioned, rng)
        if not pairs:
            missing.add(f"{label}: no caption is common to both, nothing is compared")
        questions, num_before = tuple(QUESTIONS) if captioned else (REALISTIC,), len(trials)
        for fps in rates:
            there = [(one, two) for one, two in pairs if first.has(one, fps) and second.has(two, fps)]
            if len(there) < (needed := cases * len(questions)):
                missing.add(f"{label}: {counted(len(there), 'pair')} of motions at {fps} fps, for {needed} cases")
            for question in questions if there else ():
                for swapped in rng.permutation(np.arange(cases) % 2).tolist():
                    one, two = there[(len(trials) - num_before) % len(there)]
                    caption = first.captions[one] if captioned else ""
                    sides = ((other, 0), (two, one)) if swapped else ((0, other), (one, two))
                    trials.append(Trial(question, fps, caption, *sides))
    if not trials:
        raise MotionkitError("; ".join(missing.lines))
    return tuple(trials[number] for number in rng.permutation(len(trials)).tolist())


def _pairs(first: System, second: System, captioned: bool, rng: np.random.Generator) -> list[tuple[int, int]]:
    """Comparable motions in random order, each caption once."""
    orders = [rng.permutation(len(system.captions)).tolist() for system in (first, second)]
    if not captioned:
        return list(zip(*orders, strict=False))
    one, two = (
        # Of several motions of a caption, the first in this order.
        {" ".join(system.captions[index].casefold().split()): index for index in reversed(order)}
        for system, order in zip((first, second), orders, strict=True)
    )
    common = sorted((one.keys() & two.keys()) - {""})
    return [(one[common[n]], two[common[n]]) for n in rng.permutation(len(common)).tolist()]


def write_study(
    page: Path,
    key: Path,
    systems: Sequence[System],
    trials: Sequence[Trial],
    seed: int,
    longest_seconds: float,
    on_progress: OnProgress,
) -> int:
    """Write the page and the key; motions are cut to their middle `longest_seconds`. Returns the page's bytes."""
    document = _key(systems, trials, seed)
    pages = []
    with task(on_progress, "motions", len(trials)) as work:
        for trial in trials:
            panels = []
            for letter, system, motion in zip("AB", trial.systems, trial.motions, strict=True):
                whole = systems[system].positions(motion, trial.fps)
                positions = middle(whole, max(2, int(longest_seconds * trial.fps)))
                # All stand on their lowest joint: a capture's floor height would reveal its system.
                floor = np.array([0.0, positions[..., 1].min(), 0.0], dtype=np.float32)
                panels.append(Panel(letter, positions - floor, SMPL22, trial.fps))
            pages.append({"question": trial.question, "caption": trial.caption, "player": data_of("", panels)})
            work.advance()
    data = {"format": ANSWERS_FORMAT, "study": document["study"], "questions": QUESTIONS, "trials": pages}
    written = _page(data).encode("utf-8", "backslashreplace")
    write_json(key, document)
    write_whole(page, written)
    return len(written)


def study_of(content: Mapping[str, Any]) -> str:
    """The study's id: 16 hexadecimal digits of the sha256 of everything else in its key."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


def _key(systems: Sequence[System], trials: Sequence[Trial], seed: int) -> dict[str, Any]:
    names, listed = [system.name for system in systems], []
    for trial in trials:
        sides = list(zip(trial.systems, trial.motions, strict=True))
        motions = {
            "systems": [names[system] for system, _ in sides],
            "motions": [systems[system].motion_ids[motion] for system, motion in sides],
        }
        listed.append({"question": trial.question, "fps": str(trial.fps), "caption": trial.caption, **motions})
    content = {"format": KEY_FORMAT, "seed": seed, "systems": names, "trials": listed}
    return {**content, "study": study_of(content)}


def _page(data: dict[str, Any]) -> str:
    folder = resources.files("eval.study") / "templates"
    names = ("study.css", "study.js", "study.html", "inside.css")
    style, script, page, inside = (folder.joinpath(name).read_text(encoding="utf-8") for name in names)
    shell = player("", "__DATA__").replace("</style>", f"{inside}</style>", 1)
    # A script must not contain anything like its closing tag.
    text = json.dumps({**data, "shell": shell}, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
    head, tail = page.replace("__STYLE__", style).replace("__SCRIPT__", script).split("__STUDY__")
    return head + text + tail


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
    """Read the key that `write_study` wrote; raises `DamagedFileError`, or `StudyError` for another or changed file."""
    key = read_json(path, RESTORE)
    if key.get("format") != KEY_FORMAT or key.pop("study", None) != (study := study_of(key)):
        raise StudyError(f"{path}: not a valid key of a study: {RESTORE}")
    return {**key, "study": study}


def read_answers(paths: Iterable[Path], key: Mapping[str, Any], missing: Missing) -> dict[str, dict[int, str]]:
    """Each participant's choices ("a" or "b") by trial, once; the problems of other files are added to `missing`."""
    answers: dict[str, dict[int, str]] = {}
    for path in paths:
        with missing.skipping(str(path), (MotionkitError, OSError, LookupError, TypeError, ValueError)):
            document = read_json(path, "ask for the file again")
            if document.get("format") != ANSWERS_FORMAT or document.get("study") != key["study"]:
                raise StudyError(f"not answers of study {key['study']}, but of another study or of none")
            given = [(each["trial"], each["choice"]) for each in document["answers"] if each is not None]
            for trial, choice in given:
                if trial not in range(len(key["trials"])) or choice not in SIDES:
                    raise StudyError(f"damaged answers: {shown(str(choice))} to question {shown(str(trial))}")
            participant = shown(str(document["participant"]))
            if participant in answers:
                raise StudyError(f"the answers of participant {participant} are in another file already")
            answers[participant] = dict(given)
    return answers


def preferences(key: Mapping[str, Any], answers: Iterable[Mapping[int, str]]) -> list[Preference]:
    """For each question and pair of systems, the preference for the study's first one, at each framerate.

    With three or more framerates, also for all above the lowest together. Answers are treated as independent.
    """
    from scipy.stats import binomtest

    first, wins = key["systems"][0], dict[tuple[str, str], dict[Fraction, list[bool]]]()
    for choices in answers:
        for number, choice in choices.items():
            trial = key["trials"][number]
            (second,) = (name for name in trial["systems"] if name != first)
            by_fps = wins.setdefault((trial["question"], second), {})
            by_fps.setdefault(parse_fps(trial["fps"]), []).append(trial["systems"][SIDES[choice]] == first)
    every = []
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
            every.append(Preference(question, first, second, fps, len(won), sum(won), *shares))
    return every
