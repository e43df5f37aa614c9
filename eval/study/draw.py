"""Which motions are shown beside each other: drawn from a seed, the sides even, the order shuffled."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from eval.sets.found import Found
from eval.study.systems import System
from motionkit.core.errors import MotionkitError
from motionkit.core.framerate import format_fps

REALISTIC, CONSISTENT = "realistic", "consistent"
QUESTIONS = {
    REALISTIC: "Which of the two motions is more realistic?",
    CONSISTENT: "Which of the two motions is more consistent with the given text?",
}
"""The two questions of NeRM's study (appendix E.6)."""


@dataclass(frozen=True)
class Design:
    """How many cases each question has at each framerate for each pair of systems."""

    fps: tuple[Fraction, ...] = (Fraction(20), Fraction(120))
    cases: int = 8
    seed: int = 0


@dataclass(frozen=True)
class Trial:
    """One question about two motions: places of two systems in their list, a motion of each; A shows the first."""

    question: str
    fps: Fraction
    caption: str
    systems: tuple[int, int]
    motions: tuple[int, int]


def draw_trials(systems: Sequence[System], design: Design) -> Found[tuple[Trial, ...]]:
    """The first system beside each of the others, as often on either side, in random order, and what could not be.

    Two motions answer one caption; where one of the systems has no captions, they are any two, and the question about
    the text is left out. Raises `MotionkitError` where no two motions can be shown.
    """
    rng = np.random.default_rng(design.seed)
    trials: list[Trial] = []
    missing: list[str] = []
    for other in range(1, len(systems)):
        drawn = _of_pair(systems, other, design, rng)
        trials += drawn.value
        missing += drawn.missing
    if not trials:
        raise MotionkitError("; ".join(missing))
    order = rng.permutation(len(trials)).tolist()
    return Found(tuple(trials[number] for number in order), tuple(missing))


def _of_pair(systems: Sequence[System], other: int, design: Design, rng: np.random.Generator) -> Found[list[Trial]]:
    first, second = systems[0], systems[other]
    pair = f"{first.name} and {second.name}"
    captioned = any(first.captions) and any(second.captions)
    matched = list(_matched(first, second, captioned, rng))
    missing = [] if captioned else [f"{pair}: one of them has no captions: the question about the text is left out"]
    if not matched:
        return Found([], (f"{pair}: no caption is common to both, nothing is compared",))
    trials: list[Trial] = []
    used = 0
    for fps in design.fps:
        there = [each for each in matched if first.has(each[0], fps) and second.has(each[1], fps)]
        questions = tuple(QUESTIONS) if captioned else (REALISTIC,)
        if len(there) < design.cases * len(questions):
            few = f"{len(there)} pairs of motions at {format_fps(fps)} fps for {design.cases * len(questions)} cases"
            missing.append(f"{pair}: {few}" + (", some are shown twice" if there else ", none is shown"))
        for question in questions if there else ():
            sides = rng.permutation(np.arange(design.cases) % 2).tolist()
            for swapped in sides:
                one, two = there[used % len(there)]
                trial = Trial(question, fps, first.captions[one] if captioned else "", (0, other), (one, two))
                trials.append(_swapped(trial) if swapped else trial)
                used += 1
    return Found(trials, tuple(missing))


def _swapped(trial: Trial) -> Trial:
    return Trial(trial.question, trial.fps, trial.caption, trial.systems[::-1], trial.motions[::-1])


def _matched(first: System, second: System, captioned: bool, rng: np.random.Generator) -> Iterator[tuple[int, int]]:
    """Motions that may be shown beside each other, in random order, each caption once."""
    if not captioned:
        yield from zip(
            rng.permutation(len(first.captions)).tolist(), rng.permutation(len(second.captions)).tolist(), strict=False
        )
        return
    of_first, of_second = _by_caption(first, rng), _by_caption(second, rng)
    common = [caption for caption in of_first if caption in of_second]
    for number in rng.permutation(len(common)).tolist():
        yield of_first[common[number]], of_second[common[number]]


def _by_caption(system: System, rng: np.random.Generator) -> dict[str, int]:
    """One motion of each caption."""
    found: dict[str, int] = {}
    for index in rng.permutation(len(system.captions)).tolist():
        if system.captions[index]:
            found.setdefault(" ".join(system.captions[index].casefold().split()), index)
    return dict(sorted(found.items()))
